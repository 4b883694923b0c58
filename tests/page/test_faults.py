"""What goes wrong is told in words; what goes right leaves no trace in the console and asks nobody else."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.app.processes import API, Gate, ended, half_way, started, submit, upload, wait_until
from tests.app.street import write_street
from tests.page.browsers import Browser, Watch, needs_page
from tests.page.results import SHORT, Done, address_of, show

pytestmark = needs_page


def test_a_whole_walk_leaves_no_trace(page: Any, done: Done, watch: Watch) -> None:
    page.goto(done.server.address)
    page.get_by_role("button", name="Upload a drive").click()
    page.set_input_files("input[name=folder]", done.short)
    page.wait_for_selector(".upload-form >> text=read as semantickitti")
    page.get_by_role("button", name="Upload and run").click()
    page.wait_for_selector("#panel-job .badge.good")
    page.wait_for_selector(".legend:visible")
    page.get_by_label("Speed").select_option("60")
    page.get_by_role("button", name="Play").click()
    page.locator(".timeline-label", has_text=f"Scan {SHORT - 1}").wait_for()
    page.get_by_role("button", name="Look inside").click()
    page.wait_for_selector("#drawer img:not(.waiting) >> nth=5")
    page.locator("#drawer").get_by_role("button", name="Close").click()
    page.get_by_role("tab", name="Report").click()
    page.locator("#panel-report tbody tr.can").first.click()
    page.locator(".leaflet-popup-content").wait_for()
    page.get_by_role("tab", name="Export").click()
    with page.expect_download():
        page.get_by_role("button", name="GeoPackage, all layers").click()
    with page.expect_popup() as opened:
        page.get_by_role("link", name="API", exact=True).click()
    opened.value.wait_for_selector(".opblock")
    assert watch.elsewhere == []
    assert watch.faults == []


def test_the_watch_sees_what_it_is_for(browser: Browser, done: Done, watch: Watch) -> None:
    page = browser.new_page()
    page.goto(done.server.address)
    page.evaluate("""() => {
      const script = document.createElement("script");
      script.textContent = "window.inlined = true";
      document.body.append(script);
      console.warn("a warning");
      setTimeout(() => { throw new Error("thrown"); });
      return fetch("https://elsewhere.example/").catch(() => null);
    }""")
    page.wait_for_timeout(100)
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
    show(page, done, "panel=report")
    page.locator("#panel-report tbody tr.can").first.wait_for()
    layers = page.locator(".legend summary")
    layers.click()
    page.get_by_role("tab", name="Drives").click()
    page.locator("#panel-drives").get_by_text("street", exact=True).first.wait_for()
    page.get_by_role("button", name="Upload a drive").first.click()
    page.set_input_files("input[name=folder]", done.short)
    page.wait_for_selector(".upload-form >> text=read as semantickitti")
    assert watch.faults == []


def test_a_proxy_that_takes_no_large_requests_is_named(browser: Browser, done: Done, watch: Watch) -> None:
    page = browser.new_page()
    refusal = {"status": 413, "content_type": "text/html", "body": "<html><h1>413 Request Entity Too Large</h1></html>"}
    page.route(re.compile(r"/api/v1/drives/\w+/(files|scans)"), lambda route: route.fulfill(**refusal))
    watch.expect("413")
    page.goto(done.server.address)
    page.get_by_role("button", name="Upload a drive").click()
    page.set_input_files("input[name=folder]", done.short)
    page.wait_for_selector(".upload-form >> text=read as semantickitti")
    page.get_by_role("button", name="Upload and run").click()
    page.get_by_text("A reverse proxy between this browser and the service takes no request of this size").wait_for()


TILE = "https://tiles.example/{z}/{x}/{y}.png"


@pytest.fixture(scope="module")
def tiled(done: Done, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A second server on the same data, with a tile server of its own."""
    log = tmp_path_factory.mktemp("tiled") / "log"
    with started(done.data, log, workers=1, tile_url=TILE, tile_attribution="(c) Tiles Example") as server:
        yield Done(server, done.job, done.local_job, done.short)


def test_tiles_come_from_the_configured_server_only(page: Any, tiled: Done, watch: Watch) -> None:
    pixel = page.context.new_page()
    picture = pixel.screenshot(clip={"x": 0, "y": 0, "width": 256, "height": 256})
    pixel.close()
    asked: list[Any] = []

    def give(route: Any) -> None:
        asked.append(route.request)
        route.fulfill(body=picture, content_type="image/png")

    page.context.route("https://tiles.example/**", give)
    show(page, tiled, "panel=job")
    assert not asked
    assert watch.elsewhere == []
    page.locator("#layer-tiles").check()
    page.wait_for_selector(".tiles img.leaflet-tile-loaded")
    page.locator(".leaflet-control-attribution", has_text="(c) Tiles Example").wait_for()
    assert all(re.fullmatch(r"https://tiles\.example/\d+/\d+/\d+\.png", request.url) for request in asked)
    assert {request.headers.get("referer") for request in asked} == {f"{tiled.server.address}/"}
    assert set(watch.elsewhere) == {request.url for request in asked}
    assert page.locator("#map.with-tiles").count() == 1  # which dims the roads
    page.locator("#layer-tiles").uncheck()
    page.wait_for_selector(".leaflet-tile-pane .tiles", state="detached")
    assert page.locator("#map.with-tiles").count() == 0
    watch.elsewhere.clear()


def test_a_tile_server_that_fails_is_named(page: Any, tiled: Done, watch: Watch) -> None:
    watch.expect("ERR_NAME_NOT_RESOLVED")
    show(page, tiled, "panel=job")
    page.locator("#layer-tiles").check()
    told = page.locator(".toast .note.error")
    told.wait_for()
    assert "tiles.example gave no tiles" in told.inner_text()
    assert "INTERLOC_TILE_URL" in told.inner_text()
    assert page.locator("#map.with-tiles").count() == 0  # the roads are the base map
    assert page.locator(".toast").count() == 1
    assert {re.match(r"https://[^/]+/", url)[0] for url in watch.elsewhere} == {"https://tiles.example/"}
    watch.elsewhere.clear()


def test_a_server_of_tiles_that_is_not_allowed_is_not_asked(page: Any, tiled: Done, watch: Watch) -> None:
    watch.expect("policy violated: img-src by https://other.example")
    watch.excuse("other.example|ERR_NAME_NOT_RESOLVED")
    show(page, tiled, "panel=job")
    page.locator("#layer-tiles").check()
    page.get_by_label(re.compile("Address of the tiles")).fill("https://other.example/{z}/{x}/{y}.png")
    page.get_by_role("button", name="Use", exact=True).click()
    page.locator(".toast", has_text="other.example gave no tiles").wait_for()
    watch.elsewhere[:] = [url for url in watch.elsewhere if not url.startswith("https://tiles.example/")]
    assert all(url.startswith("https://other.example/") for url in watch.elsewhere)
    watch.elsewhere.clear()  # the browser tells of the requests that it did not send


def test_what_the_server_refuses_is_told_by_file(page: Any, done: Done, watch: Watch, tmp_path: Path) -> None:
    watch.excuse("status of 4(09|22)")
    drive = Path(shutil.copytree(done.short, tmp_path / "bent"))
    scan = drive / "velodyne/000010.bin"
    points = np.fromfile(scan, "<f4").reshape(-1, 4)
    points[:, 1] = np.nan
    points.tofile(scan)
    page.goto(f"{done.server.address}/#panel=upload")
    page.set_input_files("input[name=folder]", drive)
    page.wait_for_selector(".upload-form")
    page.evaluate("document.querySelectorAll('.upload-form details').forEach((each) => (each.open = true))")
    page.locator("label.check", has_text="Everything as it is").locator("input").check()
    page.get_by_role("button", name="Upload and run").click()
    told = page.locator("#panel-upload .note.error", has_text="velodyne/000010.bin").first
    told.wait_for()
    assert "not finite" in told.inner_text()
    assert "job=" not in address_of(page)


def test_a_job_that_fails_says_why(page: Any, done: Done) -> None:
    client = done.server.client
    drive = client.get(f"{API}/jobs/{done.local_job}").json()["drive_id"]
    elsewhere = {"lat_deg": 0, "lon_deg": 0}
    job = submit(client, drive, osm={"file": "map.osm"}, georeference="map", near=elsewhere)
    error = ended(client, job)["error"]
    page.goto(f"{done.server.address}/#panel=report&job={job}")  # as `interloc push` prints it
    page.locator("#stage .note.error", has_text=error["detail"]).wait_for()
    page.goto("about:blank")
    page.goto(f"{done.server.address}/#job={job}")
    note = page.locator("#panel-job .note.error")
    note.wait_for()
    assert error["detail"] in note.inner_text()
    assert page.locator("#panel-job .badge.error").inner_text() == "Failed"
    page.get_by_role("button", name="Run again…").click()
    page.locator("dialog label.check", has_text="No map").locator("input").check()
    page.get_by_role("button", name="Run", exact=True).click()
    page.wait_for_selector("#panel-job .badge.good")


def test_a_job_is_watched_through_a_restart_of_the_server(browser: Browser, watch: Watch, tmp_path: Path) -> None:
    watch.expect("net::ERR_")
    watch.excuse("net::ERR_|network error|Failed to fetch")
    street = write_street(tmp_path / "street", 60)
    page = browser.new_page()
    with started(tmp_path / "data", tmp_path / "log", workers=1) as first:
        drive = upload(first.client, street)
        gate = Gate(tmp_path / "data", drive, 45)
        job = submit(first.client, drive)
        half_way(first.client, job)
        page.goto(f"{first.address}/#panel=job&job={job}")
        page.get_by_role("progressbar", name="Progress").wait_for()
        wait_until(lambda: "interloc_event_listeners 1.0" in first.client.get("/metrics").text, "the page to listen")
        first.kill()
        gate.open()
        told = page.locator("#panel-job [role=status]", has_text="The server does not answer")
        told.wait_for()
        port = int(first.address.rsplit(":", 1)[1])
        with started(tmp_path / "data", tmp_path / "log", workers=1, port=port) as second:
            page.wait_for_selector("#panel-job .badge.good")
            page.wait_for_selector(".legend:visible")
            assert not told.is_visible()
            summary = ended(second.client, job)["summary"]
            assert re.search(rf"{summary['detections']}\s+detections", page.inner_text("#panel-job"))

            page.route("**/events", lambda route: route.abort())  # the end is heard of by the list of jobs alone
            gate = Gate(tmp_path / "data", drive, 45)
            job = submit(second.client, drive)
            half_way(second.client, job)
            page.goto("about:blank")
            page.goto(f"{second.address}/#panel=job&job={job}")
            page.get_by_role("progressbar", name="Progress").wait_for()
            gate.open()
            ended(second.client, job)
            page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
            page.wait_for_selector(".legend:visible")
            page.close()
