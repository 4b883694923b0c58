"""The trash on the page: deleted drives and jobs are shown, come back, and go for good only after a question."""

from typing import Any

from tests.app.processes import API
from tests.page.browsers import needs_page
from tests.page.results import Done, look_again, visit

pytestmark = needs_page


def new_drive(done: Done, name: str) -> str:
    """Make a drive of one file."""
    drive = done.server.client.post(f"{API}/drives", json={"name": name}).raise_for_status().json()["id"]
    done.server.client.put(f"{API}/drives/{drive}/files/poses.txt", content=b"1").raise_for_status()
    return str(drive)


def answer(page: Any, button: str) -> None:
    page.locator("dialog[open]").get_by_role("button", name=button).click()


def delete(page: Any, name: str) -> None:
    page.get_by_role("button", name=f"Delete {name}", exact=True).click()
    assert "restored from the trash for 3 days" in page.locator("dialog[open]").inner_text()
    answer(page, "Delete the drive")


def test_a_deleted_drive_is_restored_or_goes_for_good(page: Any, done: Done) -> None:
    kept, gone = new_drive(done, "kept for later"), new_drive(done, "not wanted")
    visit(page, done.server.address, "panel=drives")
    look_again(page)
    trash = page.locator("details.trash")
    delete(page, "kept for later")
    delete(page, "not wanted")
    trash.locator("summary").click()
    trash.get_by_role("button", name="Restore kept for later").click()
    page.get_by_role("button", name="Delete kept for later", exact=True).wait_for()
    assert done.server.client.get(f"{API}/drives/{kept}").json()["files"] == 1

    trash.get_by_role("button", name="Empty the trash").click()
    answer(page, "Keep")
    assert trash.get_by_text("not wanted").is_visible()
    trash.get_by_role("button", name="Empty the trash").click()
    answer(page, "Empty the trash")
    trash.wait_for(state="hidden")
    assert done.server.client.get(f"{API}/trash").json()["items"] == []
    assert done.server.client.post(f"{API}/trash/drives/{gone}/restore").status_code == 404
    assert done.server.client.delete(f"{API}/drives/{kept}?purge=true").status_code == 204
