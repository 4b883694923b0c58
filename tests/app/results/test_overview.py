"""The map of all drives: tracks that are simplified, intersections of the newest result, nothing of the trash."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from app.results.overview import MAX_TRACK_POINTS, simplified
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
    assert np.abs(np.subtract(shown["coordinates"], track["coordinates"])).max() < 1e-6
    assert found["other"]["properties"] == {
        "layer": "drives",
        "drive": "other",
        "name": "Straße other",
        "job": "elsewhere",
        "intersections": None,  # a summary that the fixture leaves out
    }
    points = json.loads((finished.results / "default" / "intersections.geojson").read_text())["features"]
    assert len(found["other/intersections"]["geometry"]["coordinates"]) == len(points)
    assert found["local"]["geometry"] is None, "metres are not put on a map"
    assert found["street"]["properties"]["job"] == "lost", "the newest successful one, though its files are gone"
    assert features(finished, bbox="0,0,1,1") == {}


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
