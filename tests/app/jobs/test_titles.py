"""Jobs are called by what tells them from the usual one, and from each other."""

from __future__ import annotations

from typing import Any

import pytest

from app.jobs.titles import distinct_titles, own_settings, title_of
from app.store.models import Job
from interloc.config import preset as preset_named
from interloc.config import with_settings

MAP = {"file": "map.osm"}


def job(*settings: str, preset: str = "default", name: str | None = None, **request: Any) -> Job:
    config = with_settings(preset_named(preset), settings).model_dump(mode="json")
    request = {"preset": preset, "osm": MAP, "policy": "drive", "config": config, **request}
    return Job(kind="intersections", name=name, request=request)


@pytest.mark.parametrize(
    ("made", "title"),
    [
        (job(), "default"),
        (job(labels="labels"), "default"),
        (job(preset="paper", labels="predictions", osm=None), "paper, predictions, no map"),
        (job("bev.resolution_m=0.25", policy="drive+service"), "default, drive+service, r = 0.25"),
        (job(policy="consolidated", tolerance_m=20.0), "default, consolidated within 20 m"),
        (job(osm={"overpass": True}, georeference="map"), "default, map by Overpass, placed by roads"),
        (job("fusion.min_confidence=0.5", "bev.vote=false"), "default, bev.vote = no, fusion.min_confidence = 0.5"),
        (
            job("bev.size_m=100", "bev.min_points=4", "keyframes.window=10", "keyframes.lookahead=0"),
            "default, n = 10, keyframes.lookahead = 0, 2 more settings",
        ),
        (job(name="mine", labels="predictions"), "mine"),
        (Job(kind="intersections", request={}), "default, no map"),
        (Job(kind="commit", request={}), "check"),
    ],
)
def test_a_title_tells_what_differs_from_the_preset(made: Job, title: str) -> None:
    assert title_of(made) == title


def test_only_changed_settings_are_own() -> None:
    assert own_settings(job("bev.resolution_m=0.25", "bev.size_m=120").request) == {"bev.resolution_m": 0.25}


@pytest.mark.parametrize(
    ("made", "names"),
    [
        ([job(), job(labels="predictions")], ["default", "predictions"]),
        ([job("bev.size_m=100", preset="paper"), job("bev.size_m=100")], ["paper", "default"]),
        ([job(osm={"file": "old.osm"}), job()], ["old.osm", "map.osm"]),
        ([job(), job(), job(name="mine")], ["default (1)", "default (2)", "mine"]),
    ],
)
def test_what_jobs_have_in_common_does_not_tell_them_apart(made: list[Job], names: list[str]) -> None:
    assert distinct_titles(made) == names
