"""All drives, each with its newest result: on one map, with tracks that are simplified, and as a STAC catalogue."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Any

import httpx
import numpy as np
import pystac
import pytest
import shapely

from app.overview.features import MAX_TRACK_POINTS, simplified
from app.store.database import Database
from app.store.models import Job
from interloc.geometry import enu_from_lonlat, lonlat_from_enu
from tests.app.results.conftest import Finished


def features(finished: Finished, **query: Any) -> dict[str, dict[str, Any]]:
    answer = finished.get("/overview", params=query).raise_for_status()
    assert answer.headers["content-type"] == "application/geo+json"
    return {each["id"]: each for each in answer.json()["features"]}


def test_every_drive_is_shown_with_its_newest_result(finished: Finished) -> None:
    found = features(finished)
    assert set(found) == {"street", "local", "other", "other/intersections"}
    track = json.loads((finished.results / "default" / "trajectory.geojson").read_text())["features"][0]["geometry"]
    shown = found["other"]["geometry"]
    assert shown["type"] == "LineString"
    line = np.array(shown["coordinates"])
    assert np.abs(line[[0, -1]] - np.array(track["coordinates"])[[0, -1]]).max() < 1e-6
    away_m = shapely.distance(shapely.LineString(line), shapely.points(track["coordinates"])) * 111_320
    assert away_m.max() < 1.0, "simplified to within a metre"
    assert found["other"]["properties"] == {
        "layer": "drives",
        "drive": "other",
        "name": "Straße other",
        "job": "elsewhere",
        "intersections": None,  # a summary that the fixture leaves out
        "verdict": None,
        "chosen": "best",
        "title": "default, no map",
    }
    points = json.loads((finished.results / "default" / "intersections.geojson").read_text())["features"]
    assert len(found["other/intersections"]["geometry"]["coordinates"]) == len(points)
    assert found["local"]["geometry"] is None, "metres are not put on a map"
    assert found["street"]["properties"]["job"] == "lost", "the newest of those of one rank, though its files are gone"
    assert features(finished, bbox="0,0,1,1") == {}


def test_a_pinned_job_stands_for_its_drive_else_the_best_does(finished: Finished) -> None:
    def shown() -> tuple[Any, ...]:
        found = features(finished)["street"]["properties"]
        item = finished.client.get("/stac/drives/street")
        told = item.json()["properties"] if item.is_success else {"interloc:job": None, "interloc:chosen": None}
        drive = finished.get("/drives/street").raise_for_status().json()
        (listed,) = (each for each in finished.get("/drives").json()["drives"] if each["id"] == "street")
        assert listed["result_job"] == drive["result_job"] == found["job"]
        return found["job"], found["chosen"], drive["pinned_job"], told["interloc:job"], told["interloc:chosen"]

    def pin(job: str | None) -> httpx.Response:
        return finished.client.patch("/api/v1/drives/street", json={"pinned_job": job})

    ids = {job: finished.get(f"/jobs/{job}").json()["id"] for job in ("default", "paper")}
    assert pin(ids["paper"]).is_success
    assert shown() == ("paper", "pinned", "paper", "paper", "pinned")
    assert pin("failed").status_code == 409
    assert pin("elsewhere").status_code == 404, "it is of another drive"
    assert pin(None).json()["pinned_job"] is None
    assert shown()[:3] == ("lost", "best", None)
    database = Database(f"sqlite:///{finished.data_dir}/interloc.sqlite3")
    scores = {"paper": {"map_f1": 1.0}, "default": {"map_f1": 0.5}, "plain": {"f1_at_5": 0.4}}
    with database.writing() as session:
        for job, report in scores.items():
            session.get_one(Job, job).summary = {"georeferenced": True, "report": report}
    assert shown() == ("default", "best", None, "default", "best"), "paper comes after, whatever its score"
    with database.writing() as session:
        for job in scores:
            session.get_one(Job, job).summary = None
    database.close()


def test_pages_are_bounded_and_not_sent_again_unchanged(finished: Finished) -> None:
    first = finished.get("/overview", params={"limit": 2})
    drives = [each for each in first.json()["features"] if each["properties"]["layer"] == "drives"]
    assert len(drives) == 2
    assert first.json()["next"] is not None
    assert 'rel="next"' in first.headers["link"]
    again = finished.get("/overview", params={"limit": 2}, headers={"If-None-Match": first.headers["etag"]})
    assert again.status_code == 304


def test_a_long_track_keeps_its_shape_in_few_points() -> None:
    angle = np.linspace(0, 6 * np.pi, 20_000)
    enu = np.stack([40 * angle * np.cos(angle), 40 * angle * np.sin(angle)], axis=-1)
    line = simplified(lonlat_from_enu(49.0, 8.4, enu))
    assert len(line) <= MAX_TRACK_POINTS
    kept = enu_from_lonlat(49.0, 8.4, line)
    assert np.abs(kept[[0, -1]] - enu[[0, -1]]).max() < 0.1
    assert np.linalg.norm(enu[:, None] - kept[None], axis=-1).min(axis=0).max() < 1.5


# STAC ----------------------------------------------------------------------------------------------------------------


@pytest.fixture
def offline(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("the schemas are part of pystac")

    monkeypatch.setattr("urllib.request.urlopen", refuse)


def test_the_catalogue_and_its_items_are_stac(finished: Finished, offline: None) -> None:
    client = finished.client
    catalog = client.get("/stac").raise_for_status()
    assert pystac.Catalog.from_dict(catalog.json()).validate()
    items = {link["title"]: link["href"] for link in catalog.json()["links"] if link["rel"] == "item"}
    base = str(client.base_url).rstrip("/")
    assert items == {f"Straße {name}": f"{base}/stac/drives/{name}" for name in ("street", "local", "other")}
    assert client.get("/stac", headers={"If-None-Match": catalog.headers["etag"]}).status_code == 304

    answer = client.get(items["Straße other"]).raise_for_status()
    assert answer.headers["content-type"] == "application/geo+json"
    item = pystac.Item.from_dict(answer.json())
    assert item.validate()
    track = json.loads((finished.results / "default" / "trajectory.geojson").read_text())
    assert item.bbox == pytest.approx(track["bbox"], abs=1e-5)
    assert item.geometry is not None
    assert item.geometry["type"] == "LineString"
    assert (item.properties["interloc:job"], item.properties["license"]) == ("elsewhere", "ODbL-1.0")
    assert set(item.assets) == {"intersections", "geopackage", "pmtiles", "report", "run"}
    for asset in item.assets.values():
        assert client.head(asset.href).headers["content-type"].partition(";")[0] == asset.media_type


def test_an_item_has_the_times_of_the_drive(finished: Finished, offline: None) -> None:
    path = finished.data_dir / "jobs/elsewhere/result/run.json"
    times = {"first_time": "2011-09-30T12:40:59.123Z", "last_time": "2011-09-30T12:41:01.000Z"}
    path.write_text(json.dumps(json.loads(path.read_text()) | times))
    item = pystac.Item.from_dict(finished.client.get("/stac/drives/other").raise_for_status().json())
    assert item.validate()
    told = item.properties
    assert (told["datetime"], told["start_datetime"], told["end_datetime"]) == (None, *times.values())
    assert told["interloc:datetime_of"] == "drive"


def test_a_drive_without_place_and_time_has_an_item_too(finished: Finished, offline: None) -> None:
    item = pystac.Item.from_dict(finished.client.get("/stac/drives/local").raise_for_status().json())
    assert item.validate()
    assert (item.geometry, item.bbox) == (None, None)
    assert set(item.assets) == {"intersections", "run"}
    assert all(finished.client.head(asset.href).status_code == 200 for asset in item.assets.values())
    assert item.properties["interloc:datetime_of"] == "job"
    job = finished.get("/jobs/local").json()
    assert item.datetime is not None
    assert item.datetime.timestamp() == pytest.approx(datetime.fromisoformat(job["created_at"]).timestamp(), abs=0.001)


@pytest.mark.parametrize(("drive", "status", "title"), [
    ("street", 410, "Result is gone"), ("nowhere", 404, "Drive not found")
])  # fmt: skip
def test_why_there_is_no_item(drive: str, status: int, title: str, finished: Finished) -> None:
    answer: httpx.Response = finished.client.get(f"/stac/drives/{drive}")
    assert (answer.status_code, answer.json()["title"]) == (status, title)
