"""Exports over HTTP: the files of the library, built once, with the reasons where there is none."""

import io
import json
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyogrio
import pytest

from tests.app.results.conftest import Finished

DERIVED = ["branches", "uncertainty"]
MAIN = ["intersections", "roads", "trajectory", "osm_nodes"]
SCORED = [*MAIN, "detections", "keyframes", "junctions", "road_surface", "matches", "osm_roads"]


def layers_of(content: bytes, path: Path) -> dict[str, int]:
    path.write_bytes(content)
    names = [name for name in pyogrio.list_layers(path)[:, 0] if name != "layer_styles"]
    return {name: pyogrio.read_info(path, layer=name)["features"] for name in names}


def features_in(path: Path) -> int:
    return len(json.loads(path.read_text())["features"])


def test_a_geopackage_of_all_layers(finished: Finished, tmp_path: Path) -> None:
    assert finished.get("/jobs/default/export?f=gpkg").content == finished.get("/jobs/default/export").content
    answer = finished.get("/jobs/default/export?layer=all")
    assert answer.headers["content-type"] == "application/geopackage+sqlite3"
    assert answer.headers["content-disposition"] == (
        "attachment; filename=\"Stra_e_street-all.gpkg\"; filename*=UTF-8''Stra%C3%9Fe_street-all.gpkg"
    )
    expected = {layer: features_in(finished.results / f"default/{layer}.geojson") for layer in SCORED}
    made = layers_of(answer.content, tmp_path / "a.gpkg")
    assert [made.pop(layer) > 0 for layer in DERIVED] == [True, True]
    assert made == expected
    again = finished.get("/jobs/default/export?layer=all", headers={"if-none-match": answer.headers["etag"]})
    assert again.status_code == 304
    plain = layers_of(finished.get("/jobs/plain/export?f=gpkg").content, tmp_path / "plain.gpkg")
    assert list(plain) == MAIN[:3]


@pytest.mark.parametrize(("suffix", "media_type"), [
    ("fgb", "application/vnd.flatgeobuf"), ("kml", "application/vnd.google-earth.kml+xml")
])  # fmt: skip
def test_one_layer(suffix: str, media_type: str, finished: Finished, tmp_path: Path) -> None:
    for query, layer in (("", "intersections"), ("&layer=osm_nodes", "osm_nodes"), ("&layer=osm_roads", "osm_roads")):
        answer = finished.get(f"/jobs/default/export?f={suffix}{query}")
        assert answer.headers["content-type"] == media_type
        (count,) = layers_of(answer.content, tmp_path / f"a.{suffix}").values()
        assert count == features_in(finished.results / f"default/{layer}.geojson")
        assert b"OpenStreetMap contributors" in answer.content
    bare = finished.get(f"/jobs/plain/export?f={suffix}").content  # without verdicts it holds nothing of the map
    assert b"OpenStreetMap contributors" not in bare


def test_what_has_no_georeference_is_exported_in_metres(finished: Finished, tmp_path: Path) -> None:
    """The same formats that the command line writes of it."""
    own = {*MAIN[:3], *SCORED[4:8]}
    layers = layers_of(finished.get("/jobs/local/export?layer=all").raise_for_status().content, tmp_path / "local.gpkg")
    assert own <= layers.keys()
    assert not {"osm_nodes", "matches", "osm_roads"} & layers.keys()
    assert pyogrio.read_info(tmp_path / "local.gpkg", layer="detections")["crs"] is None
    with zipfile.ZipFile(io.BytesIO(finished.get("/jobs/local/export?f=qgz").content)) as project:
        assert project.namelist() == ["project.qgs", "result.gpkg", "road.tif"]
    for suffix in ("fgb", "csv", "geojson", "parquet"):
        answer = finished.get(f"/jobs/local/export?f={suffix}&layer=detections").raise_for_status()
        assert len(answer.content) > 500, suffix
    assert finished.get("/jobs/local/export?f=csv").text.startswith("\ufeffx_m,y_m,")


def test_tables_and_layers_that_are_made_of_the_intersections(finished: Finished) -> None:
    table = finished.get("/jobs/default/export?f=csv&layer=osm_roads")
    assert table.headers["content-type"] == "text/csv; charset=utf-8"
    assert table.text.startswith(
        "\ufeffwkt,osm_id,highway,name,is_drivable,is_one_way,seen_m,mapped,offset_m,width_m,is_driven,attribution\r\n"
        '"LINESTRING ('
    )
    lines = finished.get("/jobs/default/export?f=geojson&layer=branches").json()
    stored = json.loads((finished.results / "default/intersections.geojson").read_text())["features"]
    assert len(lines["features"]) == sum(each["properties"]["branch_count"] for each in stored)
    assert "drive Straße street" in finished.get("/jobs/default/export?f=kml").text  # as it is named now
    assert finished.get("/jobs/local/export?f=geojson&layer=uncertainty").status_code == 404


def test_vector_tiles_are_read_by_ranges(finished: Finished, tmp_path: Path) -> None:
    head = finished.get("/jobs/default/export?f=pmtiles", headers={"range": "bytes=0-126"})
    assert (head.status_code, head.content[:8]) == (206, b"PMTiles\x03")
    assert head.headers["content-type"] == "application/vnd.pmtiles"
    whole = finished.get("/jobs/default/export?f=pmtiles")
    assert whole.headers["accept-ranges"] == "bytes"
    assert whole.headers["etag"] == head.headers["etag"]
    assert head.headers["content-range"] == f"bytes 0-126/{len(whole.content)}"
    assert set(layers_of(whole.content, tmp_path / "a.pmtiles")) == {"intersections"}


def test_columns(finished: Finished, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = finished.get("/jobs/plain/export?f=parquet&layer=keyframes")
    assert columns.headers["content-type"] == "application/vnd.apache.parquet"
    assert columns.content[:4] == columns.content[-4:] == b"PAR1"
    assert ".parquet" in finished.client.get("/config.json").json()["exports"]
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert ".parquet" not in finished.client.get("/config.json").json()["exports"]
    refused = finished.get("/jobs/default/export?f=parquet")
    assert (refused.status_code, refused.json()["title"]) == (501, "Format not installed")


def test_all_layers_for_google_earth_and_as_projects_of_qgis(finished: Finished, tmp_path: Path) -> None:
    features = layers_of(finished.get("/jobs/default/export?f=kmz&layer=all").content, tmp_path / "a.kmz")
    assert len(features) == len(SCORED) + len(DERIVED)
    assert features["Intersections found"] == features_in(finished.results / "default/intersections.geojson")
    answer = finished.get("/jobs/default/export?f=qgz")
    assert 'filename="Stra_e_street.qgz"' in answer.headers["content-disposition"]
    with zipfile.ZipFile(io.BytesIO(answer.content)) as project:
        assert project.namelist() == ["project.qgs", "result.gpkg", "road.tif"]


def test_it_is_built_once_and_leaves_nothing_else(finished: Finished) -> None:
    kept = finished.data_dir / "jobs/paper/cache/exports"
    (kept / "of-other-code").mkdir(parents=True)
    for old in (kept / "layers.gpkg", kept / "of-other-code/all.gpkg"):
        old.write_bytes(b"old")
    with ThreadPoolExecutor(8) as threads:
        answers = list(threads.map(finished.get, ["/jobs/paper/export?f=gpkg"] * 8))
    assert {answer.status_code for answer in answers} == {200}
    assert len({answer.headers["etag"] for answer in answers}) == 1
    assert len(answers[0].content) > 10_000
    (folder,) = kept.iterdir()
    assert [path.name for path in folder.iterdir()] == ["layers.gpkg"]
    head = finished.client.head("/api/v1/jobs/paper/export?f=gpkg", headers={"accept-encoding": "identity"})
    assert head.headers["content-length"] == str(len(answers[0].content))


@pytest.mark.parametrize(("address", "status", "title"), [
    ("/jobs/local/export?f=kml", 404, "Not georeferenced"),
    ("/jobs/local/export?f=kmz", 404, "Not georeferenced"),
    ("/jobs/local/export?f=fgb&layer=matches", 404, "Not georeferenced"),
    ("/jobs/plain/export?f=fgb&layer=matches", 404, "Not scored"),
    ("/jobs/default/export?f=fgb&layer=roofs", 422, "Request not valid"),
    ("/jobs/default/export?f=shp", 422, "Request not valid"),
    ("/jobs/default/export?f=csv&layer=all", 422, "Bad setting"),
    ("/jobs/default/export?f=qgz&layer=matches", 422, "Bad setting"),
    ("/jobs/failed/export?f=gpkg", 409, "Result not ready"),
    ("/jobs/nobody/export", 404, "Job not found"),
])  # fmt: skip
def test_why_there_is_none(address: str, status: int, title: str, finished: Finished) -> None:
    answer = finished.get(address)
    assert (answer.status_code, answer.json()["title"]) == (status, title)
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_damaged_result_is_a_fault_of_the_service(finished: Finished, caplog: pytest.LogCaptureFixture) -> None:
    file = finished.data_dir / "jobs/elsewhere/result/roads.geojson"
    whole = file.read_bytes()
    file.write_bytes(b"garbage")
    try:
        answer = finished.get("/jobs/elsewhere/export?f=gpkg")
    finally:
        file.write_bytes(whole)
    assert (answer.status_code, answer.json()["title"]) == (500, "Result damaged")
    assert str(finished.data_dir) not in answer.text
    assert "roads.geojson" in caplog.text
    assert finished.get("/jobs/elsewhere/export?f=gpkg").status_code == 200
