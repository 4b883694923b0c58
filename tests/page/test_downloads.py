"""What the page gives to take along, with and without a token: each file by a click, each box by its copy button."""

import json
import os
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyogrio
import pytest

from tests.app.processes import API, ServerProcess
from tests.page.browsers import Browser, copied_by, needs_page
from tests.page.canvas import NOTE_PATHS
from tests.page.results import TOKEN, Done, show

pytestmark = needs_page

FILES = {
    "GeoPackage": "export?f=gpkg",
    "QGIS project": "export?f=qgz",
    "Everything (.zip)": "archive.zip",
    "Report": "report?format=html",
    "Intersections, GeoJSON": "export?f=geojson&layer=intersections",
    "Intersections, PMTiles, for web maps": "export?f=pmtiles",
    "Detections, FlatGeobuf": "export?f=fgb&layer=detections",
    "All layers, KMZ, for Google Earth": "export?f=kmz&layer=all",
    "Road seen by LiDAR, GeoTIFF": "files/road.tif",
    "Report, JSON": "report?format=json",
    "Settings, versions, timings, JSON": "files/run.json",
}
"""Name of a button, or layer and format to choose -> address of what it gives, below the job."""
# Chromium begins ten downloads of a page within a second, and drops the eleventh without a word.
PACE_MS = 110


@dataclass(frozen=True)
class Open:
    """A tab that shows the exports of a scored result, and the server behind it."""

    page: Any
    server: ServerProcess
    job: str
    token: str | None

    def take(self, button: Any, tmp_path: Path) -> Path:
        """Click a button, and return the file that comes."""
        with self.page.expect_download() as waiting:
            button.click()
        path = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(path)
        self.page.wait_for_timeout(PACE_MS)
        return path

    def served(self, path: str) -> bytes:
        """What the server gives for a path of the job."""
        return self.server.client.get(f"{API}/jobs/{self.job}/{path}").raise_for_status().content


@pytest.fixture(params=["open", "token"])
def opened(request: pytest.FixtureRequest, browser: Browser, done: Done) -> Open:
    with_token = request.param == "token"
    server = request.getfixturevalue("guarded") if with_token else done.server
    page = browser.new_page() if with_token else browser.kept_page(NOTE_PATHS)
    if with_token:  # as a tab that was told the token before
        page.add_init_script(f"if (origin !== 'null') sessionStorage.setItem('interloc.token', '{TOKEN}')")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"], origin=server.address)
    show(page, replace(done, server=server), "panel=export")
    page.locator("#panel-export h2").wait_for()
    assert page.locator("#tab-result").get_attribute("aria-controls") == "panel-export"  # the other one is not made yet
    return Open(page, server, done.job, TOKEN if with_token else None)


def test_files_come_by_a_click_and_boxes_by_their_copy_buttons(opened: Open, tmp_path: Path) -> None:
    page, panel = opened.page, opened.page.locator("#panel-export")
    layers, formats = (panel.get_by_role("combobox", name=name) for name in ("Layer", "Format"))
    for name, path in FILES.items():
        layer = next(
            (each for each in layers.locator("option").all_inner_texts() if name.startswith(f"{each}, ")), None
        )
        if layer:
            layers.select_option(layer)
            formats.select_option(name.removeprefix(f"{layer}, "))
        button = panel.get_by_role("button", name="Download" if layer else name, exact=True)
        content = opened.take(button, tmp_path).read_bytes()
        assert len(content) == len(opened.served(path)) > 100, name
        if opened.token:  # which goes another way, the same for all
            break
    layers.select_option("Trajectory")
    assert formats.locator("option").all_inner_texts()[:4] == ["GeoJSON", "FlatGeobuf", "KML", "CSV"]

    command, *addresses = boxes = panel.locator(".code-box pre").all_inner_texts()
    assert len(boxes) == (1 if opened.token else 2)  # QGIS sends no token, so it has no box then
    for number, text in enumerate(boxes):
        assert text
        page.evaluate("navigator.clipboard.writeText('of before')")
        row = panel.locator(".code-box").nth(number)
        assert copied_by(row.get_by_role("button")) == text
        assert TOKEN not in text

    here = tmp_path / "by command"
    here.mkdir()
    variables = {**os.environ, **({"INTERLOC_TOKEN": opened.token} if opened.token else {})}
    subprocess.run(["bash", "-c", command], cwd=here, env=variables, check=True, capture_output=True, timeout=60)
    (file,) = here.iterdir()
    assert (file.suffix, file.stat().st_size) == (".gpkg", len(opened.served("export")))
    for address in addresses:  # as QGIS reads it: by GDAL
        count = len(json.loads(opened.served("layers/intersections"))["features"])
        assert pyogrio.read_info(f"/vsicurl/{address}")["features"] == count > 0
    if opened.token:
        del variables["INTERLOC_TOKEN"]
        refused = subprocess.run(["bash", "-c", command], cwd=here, env=variables, check=False, capture_output=True)
        assert refused.returncode == 22  # of -f: the server said 401
