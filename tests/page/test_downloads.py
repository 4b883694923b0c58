"""What the page gives to take along, with and without a token: each file by a click, each box by its copy button."""

from __future__ import annotations

import json
import os
import re
import subprocess
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import geopandas
import pyogrio
import pytest

from tests.app.processes import API, ServerProcess, started
from tests.page.browsers import Browser, copied_by, needs_page
from tests.page.results import Done, show

pytestmark = needs_page

TOKEN = "a-token-that-only-these-tests-know-012345"  # noqa: S105
LAYERS = ("intersections", "detections", "keyframes", "trajectory", "osm_nodes", "matches")
# What the page gets of a click.
COUNT_CLICKS = """() => {
  if (!window.clicked)
    for (const type of ["pointerdown", "pointerup", "pointercancel", "click"])
      addEventListener(type, (event) => clicked.push(`${type} ${event.target.title || event.target.href}`), true);
  window.clicked = [];
}"""
DOWNLOAD_MS = 15_000
# Chromium begins ten downloads of a page within a second, and drops the eleventh without a word.
PACE_MS = 110
TITLES = ("Intersections", "Detections", "Keyframes", "Trajectory", "OSM intersections", "Matches")


@dataclass(frozen=True)
class Open:
    """A tab that shows the exports of a scored result, and the server behind it."""

    page: Any
    server: ServerProcess
    job: str
    token: str | None
    asked: dict[Any, str] = field(default_factory=dict)  # by request: what became of it

    def __post_init__(self) -> None:
        self.page.on("request", lambda request: self.asked.update({request: "pending"}))
        self.page.on("response", lambda response: self.asked.update({response.request: f"{response.status}, begun"}))
        self.page.on("requestfinished", lambda request: self.asked.update({request: "answered"}))
        self.page.on("requestfailed", lambda request: self.asked.update({request: f"failed: {request.failure}"}))

    def click(self, title: str, tmp_path: Path) -> Path:
        """Click the button of this title, and return the file that comes."""
        return self.take(self.page.locator("#panel-export").get_by_title(title, exact=True), tmp_path)

    def take(self, button: Any, tmp_path: Path) -> Path:
        """Click a button, and return the file that comes."""
        from playwright.sync_api import TimeoutError as NoDownloadError  # noqa: PLC0415 - may be missing

        for attempt in (1, 2):
            self.asked.clear()
            self.page.evaluate(COUNT_CLICKS)
            try:
                with self.page.expect_download(timeout=DOWNLOAD_MS) as waiting:
                    button.click(timeout=DOWNLOAD_MS)
                break
            except NoDownloadError:
                got = self.page.evaluate("clicked")
                # What the browser shows of the last download may swallow that the mouse is released.
                if attempt == 1 and not any(event.startswith("click") for event in got):
                    continue
                shown = self.page.locator(".toast").all_inner_texts()
                asked = [f"{request.method} {request.url}: {state}" for request, state in self.asked.items()]
                pytest.fail(
                    f"{button}: no file within {DOWNLOAD_MS / 1000:.0f} s; the page got {got}, says {shown}, and asked "
                    f"{asked}"
                )
        path = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(path)
        self.page.wait_for_timeout(PACE_MS)
        return path

    def count(self, layer: str) -> int:
        """The features that the server has."""
        answer = self.server.client.get(f"{API}/jobs/{self.job}/{layer.replace('_', '-')}").raise_for_status()
        return len(answer.json()["features"])


@pytest.fixture(scope="module")
def guarded(done: Done, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    """A second server on the same data, which wants a token."""
    with started(done.data, tmp_path_factory.mktemp("guarded") / "log", workers=1, token=TOKEN) as server:
        server.client.headers["Authorization"] = f"Bearer {TOKEN}"
        yield server


@pytest.fixture(params=["open", "token"])
def opened(request: pytest.FixtureRequest, browser: Browser, done: Done) -> Open:
    with_token = request.param == "token"
    server = request.getfixturevalue("guarded") if with_token else done.server
    page = browser.new_page() if with_token else browser.kept_page()
    if with_token:  # as a tab that was told the token before
        page.add_init_script(f"if (origin !== 'null') sessionStorage.setItem('interloc.token', '{TOKEN}')")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"], origin=server.address)
    show(page, replace(done, server=server), "panel=export")
    page.locator("#panel-export h2").wait_for()
    return Open(page, server, done.job, TOKEN if with_token else None)


def test_each_layer_comes_in_each_format_with_all_its_features(opened: Open, tmp_path: Path) -> None:
    for title, layer in zip(TITLES, LAYERS, strict=True):
        expected = opened.count(layer)
        assert expected > 0, layer
        row = opened.page.locator("#panel-export .downloads > span", has_text=re.compile(f"^{title}$"))
        assert row.count() == 1, title
        for text, suffix in (("GeoJSON", "geojson"), ("FGB", "fgb"), ("KML", "kml")):
            path = opened.click(f"{text}: street-{layer}.{suffix}", tmp_path)
            assert path.suffix == f".{suffix}", path.name
            info = pyogrio.read_info(path)
            assert info["features"] == expected, path.name
            frame = pyogrio.read_dataframe(path)
            assert len(frame) == expected
            assert frame.crs.to_epsg() == 4326
            lon, lat, *_ = frame.total_bounds
            assert (round(lon), round(lat)) == (8, 49), path.name  # of the street
        assert json.loads((tmp_path / path.with_suffix(".geojson").name).read_text())["type"] == "FeatureCollection"
    table = opened.click("CSV: street-intersections.csv", tmp_path).read_text()
    assert len(table.splitlines()) == 1 + opened.count("intersections")
    columns = opened.click("Parquet: street-intersections.parquet", tmp_path)
    assert len(geopandas.read_parquet(columns)) == opened.count("intersections")
    track = opened.click("GPX: street.gpx", tmp_path)
    assert len(pyogrio.read_dataframe(track, layer="waypoints")) == opened.count("intersections")
    circles = json.loads(opened.click("GeoJSON: street-uncertainty.geojson", tmp_path).read_text())
    assert len(circles["features"]) == opened.count("intersections")


def test_the_geopackage_and_the_archive_hold_everything(opened: Open, tmp_path: Path) -> None:
    panel = opened.page.locator("#panel-export")
    names = ("GeoPackage, all layers", "Everything (.zip)", "QGIS project", "Google Earth", "PMTiles, for web maps")
    files = [opened.take(panel.get_by_role("button", name=name), tmp_path) for name in names]
    geopackage, archive, project, earth, tiles = files
    assert [path.suffix for path in files] == [".gpkg", ".zip", ".qgz", ".kmz", ".pmtiles"]
    assert zipfile.ZipFile(project).namelist() == ["project.qgs", "result.gpkg", "road.tif"]
    assert len(pyogrio.list_layers(earth)) == len(pyogrio.list_layers(geopackage)) - 1  # its styles
    assert set(LAYERS) < {name for name, _ in pyogrio.list_layers(tiles)}
    found = {name: pyogrio.read_info(geopackage, layer=name)["features"] for name, _ in pyogrio.list_layers(geopackage)}
    assert {layer: found[layer] for layer in LAYERS} == {layer: opened.count(layer) for layer in LAYERS}
    with zipfile.ZipFile(archive) as packed:
        assert packed.testzip() is None
        members = {Path(name).name: name for name in packed.namelist()}
        for layer in LAYERS:
            content = json.loads(packed.read(members[f"{layer}.geojson"]))
            assert len(content["features"]) == opened.count(layer), layer
        report = json.loads(packed.read(members["report.json"]))
    assert report == opened.server.client.get(f"{API}/jobs/{opened.job}/report").json()


def test_the_report_and_the_settings_come_as_files(opened: Open, tmp_path: Path) -> None:
    report = json.loads(opened.click("JSON: street-report.json", tmp_path).read_text())
    assert report == opened.server.client.get(f"{API}/jobs/{opened.job}/report").json()
    text = opened.click("HTML: street-report.html", tmp_path).read_text()
    assert text.lstrip().lower().startswith("<!doctype html>")
    assert text.rstrip().endswith("</html>")
    assert all(str(node["osm_id"]) in text for node in report["nodes"])
    run = json.loads(opened.click("JSON: street-run.json", tmp_path).read_text())
    assert run == opened.server.client.get(f"{API}/jobs/{opened.job}/run").json()


def test_copy_buttons_copy_what_their_boxes_show(opened: Open) -> None:
    page, panel = opened.page, opened.page.locator("#panel-export")
    link = panel.get_by_label("Link to this view")
    shown = [link.input_value(), *panel.locator(".code-box pre").all_inner_texts()]
    buttons = panel.get_by_role("button", name="Copy", exact=True)
    assert buttons.count() == len(shown) == (2 if opened.token else 3)  # QGIS sends no token, so it has no box then
    for number, text in enumerate(shown):
        assert text
        page.evaluate("navigator.clipboard.writeText('of before')")
        row = panel.locator(".row:has(> .grow), .code-box").nth(number)
        assert copied_by(row.get_by_role("button")) == text
        assert TOKEN not in text


def test_the_commands_and_addresses_of_the_boxes_work(opened: Open, tmp_path: Path) -> None:
    boxes = opened.page.locator("#panel-export .code-box pre").all_inner_texts()
    command, *addresses = boxes
    assert command.startswith("curl ")
    variables = {**os.environ, **({"INTERLOC_TOKEN": opened.token} if opened.token else {})}
    subprocess.run(["bash", "-c", command], cwd=tmp_path, env=variables, check=True, capture_output=True, timeout=60)
    (file,) = tmp_path.iterdir()
    assert file.suffix == ".gpkg"
    assert set(LAYERS) <= {name for name, _ in pyogrio.list_layers(file)}
    for address in addresses:  # as QGIS reads it: by GDAL
        assert pyogrio.read_info(f"/vsicurl/{address}")["features"] == opened.count("intersections")
    if opened.token:
        del variables["INTERLOC_TOKEN"]
        refused = subprocess.run(["bash", "-c", command], cwd=tmp_path, env=variables, check=False, capture_output=True)
        assert refused.returncode == 22  # of -f: the server said 401
