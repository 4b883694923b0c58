from pathlib import Path
from tests.page.browsers import needs_page
from tests.page.uploads import Upload

pytestmark = needs_page


def test_shot(upload: Upload, street: Path) -> None:
    upload.page.set_viewport_size({"width": 1280, "height": 1800})
    upload.pick(street)
    upload.page.wait_for_selector("text=read as semantickitti")
    upload.page.evaluate("document.querySelectorAll('.upload-form details').forEach((each) => (each.open = true))")
    for scheme in ("light", "dark"):
        upload.page.emulate_media(color_scheme=scheme)
        upload.page.wait_for_timeout(300)
        upload.page.screenshot(path=f"/tmp/shot_{scheme}.png")
        upload.page.evaluate("document.querySelector('.upload-form').parentElement.scrollTo(0, 1500)")
        upload.page.wait_for_timeout(300)
        upload.page.screenshot(path=f"/tmp/shot_{scheme}_2.png")
        upload.page.evaluate("document.querySelector('.upload-form').parentElement.scrollTo(0, 0)")
