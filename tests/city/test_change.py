"""Places and branches that came or went between drives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from interloc.city.change import changes_of
from interloc.city.citymap import merge
from interloc.city.folder import city_features
from interloc.city.passes import Pass
from tests.city.test_audit import SIDES_M, passes
from tests.city.towns import drive, town

NODES = town(np.random.default_rng(3), 6)
DAY_S = 86_400.0


def on_day(day: int, *, without: int | None = None) -> Pass:
    """Drive past all intersections, of which one may not be there; the track is the same."""
    whole = drive(NODES, f"day{day}", bias_m=0.2, noise_m=0.1, start_s=1.7e9 + day * DAY_S)
    part = drive(
        NODES if without is None else np.delete(NODES, without, axis=0),
        f"day{day}",
        bias_m=0.2,
        noise_m=0.1,
        start_s=1.7e9 + day * DAY_S,
    )
    return replace(part, track_lonlat=whole.track_lonlat, track_along_m=whole.track_along_m)


def test_a_junction_that_came_and_one_that_went() -> None:
    came = merge([on_day(0, without=2), on_day(1, without=2), on_day(2), on_day(3)])
    (change,) = changes_of(came)
    assert (change.kind, change.bearing_deg) == ("new_junction", None)
    assert (change.seen_by, change.not_seen_by) == (("day2", "day3"), ("day0", "day1"))
    assert change.between_s[0] < change.between_s[1]
    (went,) = changes_of(merge([on_day(0), on_day(1), on_day(2, without=2), on_day(3, without=2)]))
    assert went.kind == "gone_junction"
    (feature,) = city_features(came)["changes"]
    assert feature["properties"]["seen_by"] == "day2, day3"
    assert feature["id"] == f"new_junction-{change.uid}"


def test_one_drive_is_not_enough_and_one_that_contradicts_is_too_many() -> None:
    assert changes_of(merge([on_day(0), on_day(1), on_day(2, without=2)])) == []
    days = [on_day(0), on_day(1, without=2), on_day(2), on_day(3, without=2), on_day(4, without=2)]
    assert changes_of(merge(days)) == []
    timeless = [replace(on_day(day, without=2 if day < 2 else None), span_s=np.full(2, np.nan)) for day in range(4)]
    assert changes_of(merge(timeless)) == []


def test_a_branch_that_went_is_one_where_other_ground_was_seen() -> None:
    """The painted road has none to the south: drives that say there was one contradict those that saw other ground."""
    four, three = np.array([0.0, 90.0, 180.0, 270.0]), np.array([0.0, 90.0, 270.0])
    days = [
        replace(
            each,
            widths_m=tuple(np.full(4 if day < 2 and x == 100.0 else 3, 6.0) for x in SIDES_M),
            bearings_deg=tuple(four if day < 2 and x == 100.0 else three for x in SIDES_M),
            span_s=1.7e9 + day * DAY_S + np.array([0.0, 100.0]),
        )
        for day, each in enumerate(passes(4))
    ]
    (change,) = changes_of(merge(days))
    assert (change.kind, change.seen_by, change.not_seen_by) == ("gone_branch", ("d0", "d1"), ("d2", "d3"))
    assert change.bearing_deg == 180.0
