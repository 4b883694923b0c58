"""The page for everyone: axe-core finds nothing serious in any of its states, and the keyboard alone is enough."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.app.processes import API, Gate, ServerProcess, archive_of, ended, half_way, submit
from tests.page.browsers import SIZE, Browser, Watch, needs_page
from tests.page.results import TOKEN, Done, look_again, show, visit
from tests.page.uploads import Upload

AXE = Path(__file__).resolve().parents[2] / "static" / "node_modules" / "axe-core" / "axe.min.js"

pytestmark = [*needs_page, pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not installed: npm ci in static/")]

NAMES = ("button-name", "link-name", "label", "select-name", "summary-name", "aria-toggle-field-name")
MANY_COLOURS = {"start", "form", "job", "report", "popup", "keyframe", "question", "finding"}
WIDTHS = (1280, 320)  # a desk, a small telephone (or the desk at 400 %)
# A telephone has another layout of the same elements: others are seen, which have to have names of their own.
NARROW_RULES = ["target-size", "scrollable-region-focusable", "aria-hidden-focus", *NAMES]
# What a state has brought: the rest of the page is looked at in the first.
LOOK = """async ([rules, isFirst]) => {
  const options = { resultTypes: ["violations"], preload: false, selectors: false };
  const own = ["dialog", ".leaflet-popup", "#drawer:not([hidden]), #stage > :not(#map), .legend, #panel"];
  const parts = own.map((part) => [...document.querySelectorAll(part)]).find((each) => each.length);
  const { violations } = await axe.run(isFirst ? document : parts, { ...options, ...(rules && { runOnly: rules }) });
  return violations.map(({ id, impact, help, nodes }) => ({ id, impact, help, nodes:
    nodes.map((node) => `${node.html.slice(0, 200)} | ${node.failureSummary.replace(/\\s+/g, " ")}`) }));
}"""

BESIDE = """() => [...document.querySelectorAll("#header *, #tabs *, #panel > :not([hidden]) *, #strip *, dialog *")]
  .filter((each) => !each.closest(".scroll, pre, .unseen, svg, .skip") && each.checkVisibility())
  .filter((each) => {
    const { left, right, width } = each.getBoundingClientRect();
    return width > 2 && (right > innerWidth + 1 || left < -1);
  })
  .map((each) => each.outerHTML.slice(0, 120))"""

UNCOVERED = """(selector) => {
  const part = document.querySelector(selector);
  const { left, right, top, bottom } = part.getBoundingClientRect();
  const corners = [[left + 1, top + 1], [right - 1, top + 1], [left + 1, bottom - 1], [right - 1, bottom - 1]];
  return corners.every(([x, y]) => part.contains(document.elementFromPoint(x, y)));
}"""


@pytest.fixture
def tab(browser: Browser) -> Any:
    """A tab with axe-core that the tests share."""
    return browser.kept_page(AXE.read_text())


def check(tab: Any, where: str) -> None:
    """Look for what keeps somebody out, and for what lies beside the screen."""
    width = tab.viewport_size["width"]
    where = f"{where} at {width} px"
    beside = tab.evaluate(BESIDE)
    assert not beside, f"{where}: {beside}"
    if width < SIZE["width"]:
        assert_clean(tab, where, NARROW_RULES)
        return
    assert_clean(tab, where, None)
    if where.split()[0] in MANY_COLOURS:  # all colours are variables: they are the same everywhere
        tab.emulate_media(color_scheme="dark")
        assert_clean(tab, f"{where}, dark", ["color-contrast"])
        tab.emulate_media(color_scheme="light")


def assert_clean(tab: Any, where: str, rules: list[str] | None) -> None:
    looked = tab.evaluate(LOOK, [rules, where.startswith("start")])
    found = [each for each in looked if each["impact"] in {"serious", "critical"}]
    assert not found, f"{where}: " + "\n".join(str(each) for each in found)


def check_widths(tab: Any, where: str) -> None:
    """Look at it on a desk and on a small telephone."""
    for width in WIDTHS:
        tab.set_viewport_size({"width": width, "height": 800})
        check(tab, where)


def go(page: Any, done: Done, fields: str) -> None:
    """Lead the tab elsewhere, by the address and without loading the page again."""
    page.keyboard.press("Escape")  # what is open above the page
    visit(page, done.server.address, f"job={done.job}&{fields}")
    page.locator(".legend").wait_for()


def see_start(page: Any, done: Done) -> None:
    page.keyboard.press("Escape")
    visit(page, done.server.address)
    page.wait_for_selector("article.drive")


def see_city(page: Any, done: Done) -> None:
    page.evaluate("location.hash = 'panel=map'")
    page.wait_for_selector("#panel-map .figure")
    page.locator(".stage-note", has_text="intersections").wait_for()


def see_city_dialog(page: Any, done: Done) -> None:
    page.get_by_role("button", name="Drives…").click()
    page.locator("dialog[open] li").first.wait_for()


def see_upload(page: Any, done: Done) -> None:
    page.keyboard.press("Escape")
    Upload(page, done.server.address).close()
    page.locator("#panel-upload summary").first.click()


def see_form(page: Any, done: Done) -> None:
    page.set_input_files("input[name=folder]", done.short)
    page.wait_for_selector(".upload-form >> text=read as semantickitti")
    page.evaluate("document.querySelectorAll('.upload-form details').forEach((each) => (each.open = true))")


def see_drive(page: Any, done: Done) -> None:
    go(page, done, "panel=drives")
    page.wait_for_selector("article.drive.is >> text=scans")


def see_job(page: Any, done: Done) -> None:
    go(page, done, "panel=result")
    page.locator("#panel-result summary", has_text="How it was made").wait_for()


def see_report(page: Any, done: Done) -> None:
    go(page, done, "panel=result&frame=12")
    page.wait_for_selector("#panel-result tbody tr >> visible=true")
    page.evaluate("document.querySelectorAll('#panel-result details').forEach((each) => (each.open = true))")


def see_popup(page: Any, done: Done) -> None:
    page.locator("#panel-result tbody tr").first.focus()
    page.keyboard.press("Enter")
    page.wait_for_selector(".leaflet-popup-content")
    page.wait_for_function(UNCOVERED, arg=".leaflet-popup-close-button")  # the map moves until the popup is clear


def see_export(page: Any, done: Done) -> None:
    go(page, done, "panel=export")
    page.get_by_role("button", name="Download", exact=True).wait_for()


def see_keyframe(page: Any, done: Done) -> None:
    go(page, done, "panel=result&frame=45&drawer=1")
    page.wait_for_selector("#drawer img:not(.waiting) >> nth=5")


def see_picture(page: Any, done: Done) -> None:
    page.get_by_role("button", name="Enlarge Centerline").click()
    page.wait_for_selector("dialog[open]")


def see_layers(page: Any, done: Done) -> None:
    go(page, done, "panel=result&layers=keyframes,detections,outside,zone")
    if not page.locator("#layer-roads").is_visible():
        page.locator(".legend summary").click()
    page.locator("#layer-roads").wait_for()


def see_run_dialog(page: Any, done: Done) -> None:
    see_drive(page, done)
    page.get_by_role("button", name="Run street", exact=True).last.click()
    page.wait_for_selector("dialog[open]")


def see_question(page: Any, done: Done) -> None:
    see_drive(page, done)
    page.get_by_role("button", name="Delete street", exact=True).last.click()
    page.wait_for_selector("dialog[open]")


def see_trash(page: Any, done: Done) -> None:
    drive = done.server.client.post(f"{API}/drives", json={"name": "unfinished"}).json()["id"]
    done.server.client.delete(f"{API}/drives/{drive}").raise_for_status()
    see_start(page, done)
    look_again(page)
    if page.locator(".trash[open]").count() == 0:
        page.locator(".trash summary").click()
    page.get_by_role("button", name="Empty the trash").wait_for()


def see_unscored(page: Any, done: Done) -> None:
    show(page, done, "panel=result", done.local_job)
    page.locator("#panel-result .note:visible", has_text="Not scored").wait_for()


WALK = [each for name, each in dict(globals()).items() if name.startswith("see_")]
"""What there is to see, each from where the one before has led."""


def test_nothing_keeps_anyone_out(tab: Any, done: Done) -> None:
    for see in WALK:
        see(tab, done)
        check_widths(tab, see.__name__.removeprefix("see_"))
        tab.set_viewport_size({"width": WIDTHS[0], "height": 800})


@pytest.fixture
def halted_job(done: Done) -> Iterator[str]:
    """A job that stands still half-way."""
    drive = done.server.client.get(f"{API}/jobs/{done.job}").json()["drive_id"]
    gate = Gate(done.data, drive, 45)
    job = submit(done.server.client, drive)
    half_way(done.server.client, job)
    yield job
    gate.open()
    assert ended(done.server.client, job)["state"] == "successful"


def test_a_running_job_is_told_to_everyone(tab: Any, done: Done, halted_job: str) -> None:
    visit(tab, done.server.address, f"panel=result&job={halted_job}")
    progress = tab.get_by_role("progressbar", name="Progress")
    progress.wait_for()
    assert 0 < float(progress.get_attribute("value")) < 1
    assert tab.locator("[aria-current=step]").inner_text() == "Finding intersections"
    check_widths(tab, "a running job")


def test_a_token_is_asked_for_once_and_refused_in_words(tab: Any, watch: Watch, guarded: ServerProcess) -> None:
    watch.expect("status of 401")
    tab.goto(guarded.address)
    field = tab.get_by_label("API token")
    field.wait_for()
    check_widths(tab, "the question")
    tab.get_by_role("button", name="Not now").click()
    told = tab.locator("#panel-drives .note.error", has_text="Press “Set token”")
    told.wait_for()
    with tab.expect_response(lambda answer: answer.status == 401):
        tab.get_by_role("tab", name="Map").click()
    tab.get_by_role("tab", name="Drives").click()
    assert not field.is_visible()
    tab.locator("#panel-drives").get_by_role("button", name="Try again").click()
    field.fill("not this one")
    field.press("Enter")
    tab.locator("dialog .note.error").wait_for()
    check_widths(tab, "the refusal")
    field.fill(TOKEN)
    field.press("Enter")
    tab.locator("article.drive").first.wait_for()
    tab.locator("dialog").wait_for(state="detached")
    tab.reload()
    tab.locator("article.drive").first.wait_for()
    assert tab.locator("dialog").count() == 0
    assert TOKEN not in tab.url
    tab.evaluate("sessionStorage.clear()")
    tab.goto("about:blank")


class Keyboard:
    """Somebody who has no mouse."""

    STOP = """() => {
      const at = document.activeElement;
      const { outlineStyle, outlineWidth } = getComputedStyle(at);
      const name = at.getAttribute("aria-label") || at.labels?.[0]?.innerText || at.innerText || "";
      const marked = outlineStyle !== "none" && outlineWidth !== "0px";
      const lost = at === document.body;
      const hidden = !lost && !at.checkVisibility();
      return { name: name.trim(), html: at.outerHTML.slice(0, 200), marked, lost, hidden };
    }"""

    def __init__(self, page: Any) -> None:
        self.page = page

    def tab_to(self, name: str, maximum: int = 100) -> None:
        """Press Tab until something of this name has the focus; each stop on the way must be seen."""
        stops = []
        for _ in range(maximum):
            self.page.keyboard.press("Tab")
            stop = self.page.evaluate(self.STOP)
            if not stop["lost"]:  # at the end the focus leaves the page once
                assert stop["marked"], f"the focus is not seen: {stop['html']}"
                assert not stop["hidden"], f"the focus is on what is hidden: {stop['html']}"
            stops.append(stop["name"])
            if re.search(name, stop["name"]):
                return
        pytest.fail(f"{name!r} is not reached; the stops: {stops}")

    def press(self, key: str) -> None:
        self.page.keyboard.press(key)

    def focus(self) -> str:
        return str(self.page.evaluate(self.STOP)["name"])


def test_from_a_drive_to_its_report_by_keyboard(browser: Browser, done: Done, tmp_path: Path) -> None:
    page = browser.new_page()
    archive = tmp_path / "keys.tar"
    archive.write_bytes(archive_of(done.short))
    keys = Keyboard(page)
    # Playwright does not wait until it has taken over the dialog for files: begun at the key that opens it, it is late
    # at times, and Chromium, which has no window for the dialog here, cancels it.
    page.on("filechooser", lambda _: None)
    page.goto(done.server.address)
    page.wait_for_selector("article.drive")
    keys.tab_to("^Skip to the panel")
    keys.press("Enter")
    assert page.evaluate("document.activeElement.id") == "panel"
    keys.tab_to("^Upload a drive", 4)
    keys.press("Enter")
    page.wait_for_selector(".drop")
    keys.tab_to("^Choose files", 12)
    with page.expect_file_chooser() as chooser:
        keys.press("Enter")
    chooser.value.set_files(archive)
    page.wait_for_selector(".upload-form")
    keys.tab_to("^Upload and run")
    keys.press("Enter")
    page.wait_for_selector(".upload-progress")
    assert page.evaluate("document.activeElement.id") == "panel"
    page.wait_for_selector("#panel-result .badge.good")
    page.wait_for_selector(".legend:visible")
    rows = page.locator("#panel-result tbody tr.can")
    rows.first.wait_for()
    keys.tab_to("^(right|wrong|not scored)")
    keys.press("Enter")
    page.locator(".leaflet-popup-content").wait_for()
    keys.tab_to("^Keyframe$")
    keys.press("ArrowRight")
    page.locator(".timeline-label", has_text="Scan 1").wait_for()
    keys.tab_to("^Look inside")
    keys.press("Enter")
    page.wait_for_selector("#drawer img:not(.waiting) >> nth=5")
    keys.tab_to("^Enlarge Road occupancy")
    keys.press("Enter")
    page.wait_for_selector("dialog[open]")
    keys.press("Escape")
    page.wait_for_selector("dialog", state="detached")
    assert keys.focus() == "Enlarge Road occupancy"
    keys.tab_to("^Close$")
    keys.press("Escape")
    page.locator("#drawer").wait_for(state="hidden")
