"""What goes wrong is told in words; what goes right leaves no trace in the console and asks nobody else."""

import re
from pathlib import Path
from typing import Any

from tests.app.processes import API, Gate, ended, half_way, started, submit, upload
from tests.app.street import write_street
from tests.page.browsers import Browser, Watch, needs_page
from tests.page.results import SHORT, Done, show, visit
from tests.page.uploads import Upload, check_reduced_drive, newest

pytestmark = needs_page


def test_the_watch_sees_what_it_is_for(page: Any, done: Done, watch: Watch) -> None:
    visit(page, done.server.address)
    page.evaluate("""() => {
      const script = document.createElement("script");
      script.textContent = "window.inlined = true";
      document.body.append(script);
      console.warn("a warning");
      setTimeout(() => { throw new Error("thrown"); });
      return fetch("https://elsewhere.example/").catch(() => new Promise((done) => setTimeout(done)));
    }""")
    assert page.evaluate("window.inlined") is None
    for pattern in ("policy violated: script-src", "a warning", "error: .*thrown", "policy violated: connect-src"):
        watch.expect(pattern)
    watch.excuse("Content Security Policy|Refused to|Fetch API cannot load")
    watch.check()


BLOCKED = """
for (const kind of ["localStorage", "sessionStorage", "indexedDB"])
  Object.defineProperty(window, kind, { get() { throw new DOMException("Access is denied", "SecurityError"); } });
"""


def test_the_page_works_in_a_browser_that_blocks_storage(browser: Browser, done: Done, watch: Watch) -> None:
    """As Chromium does where all cookies are blocked: what would be remembered is forgotten with the page."""
    page = browser.new_page()
    page.add_init_script(BLOCKED)
    show(page, done, "panel=result")
    page.locator("#panel-result tbody tr.can").first.wait_for()
    layers = page.locator(".legend summary")
    layers.click()
    page.get_by_role("tab", name="Drives").click()
    page.locator("#panel-drives").get_by_text("street", exact=True).first.wait_for()
    page.get_by_role("button", name="Upload a drive").first.click()
    page.set_input_files("input[name=folder]", done.short)
    page.wait_for_selector(".upload-form >> text=read as semantickitti")
    assert watch.faults == []


def test_tiles_come_from_the_configured_server_only(page: Any, done: Done, watch: Watch) -> None:
    pixel = page.context.new_page()
    picture = pixel.screenshot(clip={"x": 0, "y": 0, "width": 256, "height": 256})
    pixel.close()
    asked: list[Any] = []

    def give(route: Any) -> None:
        asked.append(route.request)
        route.fulfill(body=picture, content_type="image/png")

    page.context.route("https://tiles.example/**", give)
    show(page, done, "panel=result")
    assert not asked
    assert watch.elsewhere == []
    page.locator("#layer-tiles").check()
    page.wait_for_selector(".tiles img.leaflet-tile-loaded")
    page.locator(".leaflet-control-attribution", has_text="(c) Tiles Example").wait_for()
    assert all(re.fullmatch(r"https://tiles\.example/\d+/\d+/\d+\.png", request.url) for request in asked)
    assert {request.headers.get("referer") for request in asked} == {f"{done.server.address}/"}
    assert set(watch.elsewhere) == {request.url for request in asked}
    assert page.locator("#map.with-tiles").count() == 1  # which dims the roads
    page.locator("#layer-tiles").uncheck()
    page.wait_for_selector(".leaflet-tile-pane .tiles", state="detached")
    assert page.locator("#map.with-tiles").count() == 0
    watch.elsewhere.clear()


def test_a_tile_server_that_fails_or_is_not_allowed_is_named(page: Any, done: Done, watch: Watch) -> None:
    watch.expect("ERR_NAME_NOT_RESOLVED")
    show(page, done, "panel=result&view=16/49.02/8.45")  # of other tiles than before: those may be kept
    page.locator("#layer-tiles").check()
    told = page.locator(".toast .note.error")
    told.wait_for()
    assert "tiles.example gave no tiles" in told.inner_text()
    assert "INTERLOC_TILE_URL" in told.inner_text()
    assert page.locator("#map.with-tiles").count() == 0  # the roads are the base map
    assert page.locator(".toast").count() == 1
    page.locator("#layer-tiles").uncheck()
    assert {re.match(r"https://[^/]+/", url)[0] for url in watch.elsewhere} == {"https://tiles.example/"}
    watch.elsewhere.clear()  # the browser tells of the requests that it did not send


def test_a_job_that_fails_or_is_none_is_told_in_the_words_of_the_server(page: Any, done: Done, watch: Watch) -> None:
    client = done.server.client
    drive = client.get(f"{API}/jobs/{done.local_job}").json()["drive_id"]
    elsewhere = {"lat_deg": 0, "lon_deg": 0}
    job = submit(client, drive, osm={"file": "map.osm"}, georeference="map", near=elsewhere)
    error = ended(client, job)["error"]
    visit(page, done.server.address, f"panel=result&job={job}")  # as `interloc push` prints it
    page.locator("#stage .cover", has_text="This job failed.").wait_for()
    page.locator("#panel-result .note.error", has_text=error["detail"]).wait_for()
    assert page.locator("#panel-result .badge.error").inner_text() == "Failed"
    page.get_by_role("button", name="Run again…").click()
    dialog = page.locator("dialog[open]")
    near = dialog.get_by_label("Roughly where: latitude, longitude")
    assert near.input_value() == "0, 0"
    near.fill("somewhere")
    assert dialog.get_by_text("give latitude and longitude, or nothing").is_visible()
    near.fill("49.01, 8.43")
    with page.expect_response("**/api/v1/jobs") as made:
        dialog.get_by_role("button", name="Run", exact=True).click()
    again = made.value.json()
    assert again["request"]["near"] == {"lat_deg": 49.01, "lon_deg": 8.43, "radius_km": 3.0}
    client.delete(f"{API}/jobs/{again['id']}").raise_for_status()

    watch.expect("404 .*jobs/0123456789abcdef")
    detail = client.get(f"{API}/jobs/0123456789abcdef").json()["detail"]
    visit(page, done.server.address, "panel=result&job=0123456789abcdef")
    page.locator("#panel-result .note.error", has_text=detail).wait_for()
    visit(page, done.server.address, "drive=0123456789abcdef")
    page.locator("#stage", has_text="There is no such drive").get_by_role("button", name="To the drives").click()
    page.wait_for_url(lambda url: "drive=" not in url)


def test_a_panel_that_cannot_be_loaded_says_so(browser: Browser, done: Done, watch: Watch) -> None:
    """As after an upgrade of the service: the files of the page have other names."""
    watch.expect("404 .*later-")
    page = browser.new_page()
    page.route("**/later-*.js", lambda route: route.fulfill(status=404))
    page.goto(f"{done.server.address}/#panel=upload")
    page.locator("#panel-upload .note.error", has_text="After an upgrade, reload the page.").wait_for()


def test_what_goes_on_survives_a_restart_of_the_server(
    browser: Browser, watch: Watch, street: Path, tmp_path: Path
) -> None:
    """An upload is sent on, a job is watched on."""
    watch.expect("net::ERR_")
    watch.excuse("net::ERR_|network error|Failed to fetch")
    sending, page = browser.new_page(), browser.new_page()
    with started(tmp_path / "data", tmp_path / "log", workers=1) as first:
        sending.goto(first.address)
        welcome = sending.locator(".drop-stage")
        welcome.get_by_role("button", name="Try the demo").wait_for()
        sending.locator(".empty").wait_for()
        welcome.get_by_role("button", name="Upload a drive").click()
        drive = upload(first.client, write_street(tmp_path / "street", 40))
        gate = Gate(tmp_path / "data", drive, 24)
        job = submit(first.client, drive)
        half_way(first.client, job)
        page.goto(f"{first.address}/#panel=result&job={job}")
        page.get_by_role("progressbar", name="Progress").wait_for()
        held = Upload(sending, first.address)
        held.pick(street)
        held.let_through(5)
        held.press("Upload only")
        held.wait_for_files(5)
        first.kill()
        gate.open()
        held.release()
        sending.wait_for_selector("text=Trying again in")
        told = page.locator("#panel-result [role=status]", has_text="The server does not answer")
        told.wait_for()
        port = int(first.address.rsplit(":", 1)[1])
        with started(tmp_path / "data", tmp_path / "log", workers=1, port=port) as second:
            page.wait_for_selector("#panel-result .badge.good")
            page.wait_for_selector(".legend:visible")
            assert not told.is_visible()
            summary = ended(second.client, job)["summary"]
            page.locator("#panel-result summary", has_text="How it was made").click()
            assert re.search(rf"Detections\s+{summary['detections']}\s", page.inner_text("#panel-result"))
            sending.wait_for_selector("text=Upload another")
            check_reduced_drive(second.client, newest(second.client)["id"], SHORT)
            page.close()
            sending.close()
