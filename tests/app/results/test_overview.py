"""All drives, each with its newest result, on one map, with tracks that are simplified."""

import json
from typing import Any

import httpx
import numpy as np
import shapely

from app.ogc.work import MAX_OUTLINE, simplified
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


def test_a_pinned_job_stands_for_its_drive_else_the_best_does(finished: Finished) -> None:
    def shown() -> tuple[Any, ...]:
        found = features(finished)["street"]["properties"]
        drive = finished.get("/drives/street").raise_for_status().json()
        (listed,) = (each for each in finished.get("/drives").json()["drives"] if each["id"] == "street")
        assert listed["result_job"] == drive["result_job"] == found["job"]
        return found["job"], found["chosen"], drive["pinned_job"]

    def pin(job: str | None) -> httpx.Response:
        return finished.client.patch("/api/v1/drives/street", json={"pinned_job": job})

    ids = {job: finished.get(f"/jobs/{job}").json()["id"] for job in ("default", "paper")}
    assert pin(ids["paper"]).is_success
    assert shown() == ("paper", "pinned", "paper")
    assert pin("failed").status_code == 409
    assert pin("elsewhere").status_code == 404, "it is of another drive"
    assert pin(None).json()["pinned_job"] is None
    assert shown() == ("lost", "best", None)
    database = Database(f"sqlite:///{finished.data_dir}/interloc.sqlite3")
    scores = {"paper": {"map_f1": 1.0}, "default": {"map_f1": 0.5}, "plain": {"f1_at_5": 0.4}}
    with database.writing() as session:
        for job, report in scores.items():
            session.get_one(Job, job).summary = {"georeferenced": True, "report": report}
    assert shown() == ("default", "best", None), "paper comes after, whatever its score"
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
    assert len(line) <= MAX_OUTLINE
    kept = enu_from_lonlat(49.0, 8.4, line)
    assert np.abs(kept[[0, -1]] - enu[[0, -1]]).max() < 0.1
    assert np.linalg.norm(enu[:, None] - kept[None], axis=-1).min(axis=0).max() < 1.5
