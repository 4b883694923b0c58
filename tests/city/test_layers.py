"""What of a map of many drives are features: its intersections, tracks, roads, and what changed between drives."""

from dataclasses import replace

import numpy as np
import pytest

from interloc.city.citymap import merge
from interloc.city.drives import Pass
from interloc.city.layers import city_features
from interloc.geometry import lonlat_from_enu
from tests.city.test_audit import SIDES_M, passes
from tests.city.towns import ORIGIN, drive, town

NODES = town(np.random.default_rng(3), 6)
DAY_S = 86_400.0


def test_intersections_and_tracks_are_layers() -> None:
    found = city_features(merge([drive(NODES, name, start_s=1.7e9 + 1e5 * k) for k, name in enumerate("ab")]))
    assert len(found["city"]) == 6
    facts = found["city"][0]["properties"]
    assert (facts["drives"], facts["passes"], facts["drive_names"], facts["branch_drives"]) == (2, 2, "a, b", [2, 2, 2])
    assert facts["branch_widths_m"] == [6.0, 5.0, None]
    assert facts["first_time"] < facts["last_time"]
    assert [each["id"] for each in found["drives"]] == ["a", "b"]
    stood = replace(drive(NODES[:1], "c"), track_lonlat=np.array([ORIGIN[::-1]]), track_along_m=np.zeros(1))
    (line,) = (each["geometry"]["coordinates"] for each in city_features(merge([stood]))["drives"])
    assert len(line) == 2  # of one keyframe (RFC 7946, 3.1.4)


def passed(name: str, bias_m: tuple[float, float], width_m: float, *, is_driven: bool = True) -> Pass:
    """Drive past three intersections in a row, and see the road between the first two, and one to the north."""
    nodes = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])
    between, north = np.array([[2.0, 1.0], [50.0, 1.0], [98.0, -1.0]]), np.array([[100.0, 40.0], [100.0, 2.0]])
    lines = tuple(lonlat_from_enu(*ORIGIN, line + bias_m) for line in (between, north))
    seen = drive(nodes, name, bias_m=bias_m, noise_m=0.1)
    wide, driven = np.array([width_m, np.nan]), np.array([is_driven, False])
    return replace(seen, roads_lonlat=lines, road_width_m=wide, road_driven=driven)


def test_roads_of_several_drives_are_fused() -> None:
    city = merge(
        [passed("a", (1.0, 0.0), 6.0), passed("b", (0.0, 1.0), 7.0), passed("c", (0.0, 0.0), 3.0, is_driven=False)]
    )
    north, between = sorted((each["properties"] for each in city_features(city)["roads"]), key=lambda r: r["length_m"])
    assert (between["drive_names"], between["is_driven"], between["end_uid"] is None) == ("a, b, c", True, False)
    assert (between["width_m"], between["width_std_m"]) == pytest.approx((6.5, 0.71))  # c did not go along it
    assert between["length_m"] == pytest.approx(96, abs=0.5)
    assert (north["drives"], north["end_uid"], north["width_m"]) == (3, None, None)


def on_day(day: int, *, without: int | None = None) -> Pass:
    """Drive past all intersections, of which one may not be there; the track is the same."""
    left = NODES if without is None else np.delete(NODES, without, axis=0)
    whole, part = (
        drive(nodes, f"day{day}", bias_m=0.2, noise_m=0.1, start_s=1.7e9 + day * DAY_S) for nodes in (NODES, left)
    )
    return replace(part, track_lonlat=whole.track_lonlat, track_along_m=whole.track_along_m)


def changes(*drives: Pass) -> list[dict[str, object]]:
    return [{"name": each["id"], **each["properties"]} for each in city_features(merge(drives))["changes"]]


def test_a_junction_that_came_and_one_that_went() -> None:
    (change,) = changes(on_day(0, without=2), on_day(1, without=2), on_day(2), on_day(3))
    assert (change["kind"], change["bearing_deg"]) == ("new_junction", None)
    assert (change["seen_by"], change["not_seen_by"]) == ("day2, day3", "day0, day1")
    assert str(change["after_time"]) < str(change["before_time"])
    assert change["name"] == f"new_junction-{change['uid']}"
    (went,) = changes(on_day(0), on_day(1), on_day(2, without=2), on_day(3, without=2))
    assert went["kind"] == "gone_junction"


def test_one_drive_is_not_enough_and_one_that_contradicts_is_too_many() -> None:
    assert changes(on_day(0), on_day(1), on_day(2, without=2)) == []
    days = [on_day(0), on_day(1, without=2), on_day(2), on_day(3, without=2), on_day(4, without=2)]
    assert changes(*days) == []
    timeless = [replace(on_day(day, without=2 if day < 2 else None), span_s=np.full(2, np.nan)) for day in range(4)]
    assert changes(*timeless) == []
    first, *days = [on_day(day, without=2 if day > 1 else None) for day in range(4)]
    assert changes(replace(first, span_s=first.span_s + np.array([0.0, 2.0 * DAY_S])), *days) == []  # two at once


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
    (change,) = changes(*days)
    assert (change["kind"], change["seen_by"], change["not_seen_by"]) == ("gone_branch", "d0, d1", "d2, d3")
    assert change["bearing_deg"] == 180.0
