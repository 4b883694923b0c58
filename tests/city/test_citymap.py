"""One map of many drives: towns whose truth is known, with offsets of metres."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from interloc.city.citymap import CityMap, merge
from interloc.city.drives import Pass
from interloc.city.models import Judgement, Precision, Verdict, latest, wilson
from interloc.errors import ConfigError, GeoreferenceError
from interloc.output.geojson import write_collection
from interloc.output.layers import LAYERS
from interloc.output.read import read_results
from interloc.output.write import write_results
from interloc.results import IntersectionTable
from tests.city.towns import ORIGIN, drive, metres, town
from tests.output.small import small_result, with_roads

NODES = town(np.random.default_rng(0), 40)


def assert_same_map(a: CityMap, b: CityMap, tolerance_m: float = 0.001) -> None:
    assert len(a.places) == len(b.places)
    assert_allclose(a.places.xy, b.places.xy, atol=tolerance_m)
    assert_allclose(a.places.position_cov_m2, b.places.position_cov_m2)
    assert a.places.drives == b.places.drives


@pytest.mark.parametrize("drifts", [False, True])
def test_the_order_of_drives_does_not_matter_nor_whether_they_come_at_once(drifts: bool) -> None:
    drives = [drive(NODES[i : i + 25], f"d{i}", drifts=drifts, seen=0.9) for i in range(0, 16, 2)]
    at_once = merge(drives)
    one_by_one = CityMap()
    for each in reversed(drives):
        one_by_one.add(each)
    assert_same_map(one_by_one, at_once)


def test_a_drive_that_is_taken_out_leaves_no_trace_and_can_come_back_or_be_replaced() -> None:
    drives = [drive(NODES, name) for name in "abcd"]
    city = merge(drives)
    names = dict(zip(map(tuple, np.round(city.places.xy).tolist()), city.places.uid, strict=True))
    city.remove("b")
    assert_same_map(city, merge([drives[0], *drives[2:]]))
    city.add(drives[1])
    assert_same_map(city, merge(drives))
    assert dict(zip(map(tuple, np.round(city.places.xy).tolist()), city.places.uid, strict=True)) == names
    other = drive(NODES, "b", seed=7)
    city.replace(other)
    assert_same_map(city, merge([drives[0], other, *drives[2:]]))
    city.remove(*"abcd")
    assert len(city.places) == 0
    city.add(replace(other, track_lonlat=np.tile([140.0, -30.0], (40, 1))))  # it may lie anywhere now


def test_offsets_of_metres_between_drives_are_found() -> None:
    city = merge([drive(NODES, "a", bias_m=(3.0, -2.0)), drive(NODES, "b", bias_m=(-3.0, 2.0))])
    assert len(city.places) == 40
    difference = city.drives["a"].knots.mean(axis=0) - city.drives["b"].knots.mean(axis=0)
    assert_allclose(difference, [6.0, -4.0], atol=0.3)


def test_two_close_places_stay_two_and_one_is_not_seen_as_two() -> None:
    pairs = np.repeat(NODES[:20], 2, axis=0) + np.tile([[0.0, 0.0], [8.0, 0.0]], (20, 1))
    drives = [drive(pairs, f"d{i}", seed=i, bias_m=2.0, noise_m=0.4, seen=0.9) for i in range(4)]
    places = merge(drives).places
    distance = np.hypot(*(metres(places.lonlat)[:, None] - pairs[None]).transpose(2, 0, 1))
    assert len(places) == 40
    assert (distance.min(axis=0) < 4.0).all()


@pytest.mark.parametrize("drifts", [False, True])
@pytest.mark.parametrize("passes", [1, 6])
def test_errors_shrink_with_the_passes_as_they_should_and_the_ellipses_hold(passes: int, drifts: bool) -> None:
    squares, held = [], []
    for seed in range(6):
        city = merge([drive(NODES, f"d{i}", seed=100 * seed + i, drifts=drifts) for i in range(passes)])
        xy = metres(city.places.lonlat)
        error = xy - NODES[np.argmin(np.hypot(*(xy[:, None] - NODES[None]).transpose(2, 0, 1)), axis=1)]
        squares.append(np.mean(error**2))
        held.append(np.mean(np.sum(error**2, axis=1) < 5.991 * city.places.position_std_m**2))
    assert np.sqrt(np.mean(squares)) < 1.3 * np.sqrt((1.0 + 0.25) / passes)  # few seeds; many: docs/city-accuracy.md
    assert np.mean(held) > 0.85


def test_what_all_drives_share_is_not_averaged_away() -> None:
    shape = np.tile([0.25, 0.0, 0.04], (40, 1))
    places = merge([replace(drive(NODES, f"d{i}", seed=i), shape_cov_m2=shape) for i in range(4)]).places
    assert_allclose(places.position_cov_m2 - shape, np.tile([(1.0 + 0.25) / 4, 0.0, (1.0 + 0.25) / 4], (40, 1)))
    assert_allclose(places.relative_cov_m2 - shape, np.tile([0.25 / 4, 0.0, 0.25 / 4], (40, 1)))


def test_a_place_counts_where_enough_of_the_drives_that_came_near_saw_it() -> None:
    ghost = np.vstack([NODES[:3], NODES[2] + [12.0, 0.0]])
    drives = [drive(NODES[:3], f"d{i}", bias_m=0.1, noise_m=0.1) for i in range(3)]
    drives.append(drive(ghost, "e", bias_m=0.1, noise_m=0.1))
    places = merge(drives).places
    assert places.is_shown.tolist() == [len(names) == 4 for names in places.drives]
    assert_allclose(places.confidence[places.is_shown], 0.9)
    assert_allclose(places.confidence[~places.is_shown], 0.9 / 4)


def test_pieces_of_one_drive_are_one_pass() -> None:
    pieces = [drive(NODES[:5], name, start_s=1.7e9 + start) for name, start in (("a", 0), ("b", 60), ("c", 90_000))]
    places = merge(pieces).places
    assert places.passes.tolist() == [2] * 5
    assert [len(each) for each in places.drives] == [3] * 5
    assert_allclose(places.seen_s[:, 0].min(), 1.7e9)


def test_drives_that_cannot_be_together_are_refused_by_name() -> None:
    with pytest.raises(GeoreferenceError, match="07: it has no georeference"):
        merge([small_result(local=True)])
    elsewhere = replace(drive(NODES, "far"), track_lonlat=np.tile([140.0, -30.0], (40, 1)))
    city = merge([drive(NODES, "a")])
    with pytest.raises(GeoreferenceError, match=r"far: it lies at lon 140\.0000"):
        city.add(elsewhere)
    with pytest.raises(ConfigError, match="'a' is on the map already"):
        city.add(drive(NODES, "a"))
    with pytest.raises(ConfigError, match="'b' is not on the map"):
        city.remove("b")
    with pytest.raises(ConfigError, match="'b' is the same as 'a'"):
        city.add(replace(drive(NODES, "a"), name="b"))
    assert list(city.drives) == ["a"]
    start = {"track_lonlat": np.array([ORIGIN[::-1]]), "track_along_m": np.zeros(1)}  # where one keyframe is all
    assert len(merge([replace(drive(NODES[:1], name), **start) for name in "cd"]).drives) == 2


def test_a_result_that_does_not_tell_the_parts_of_its_uncertainty_is_taken_with_care() -> None:
    """Fix and scatter 0.3 m at most, all else shared by all drives: the sum is what the result states."""
    result = small_result()
    table = result.intersections
    assert isinstance(table, IntersectionTable)
    wide = replace(result, intersections=replace(table, position_cov_m2=np.array([[4.0, 0.5, 1.0]])))
    data = Pass.of(wide)
    assert_allclose([data.fix_std_m, data.scatter_std_m], [[0.3], [0.3]])
    assert_allclose(data.shape_cov_m2, [[4.0 - 0.18, 0.5, 1.0 - 0.18]])
    assert_allclose(Pass.of(result).shape_cov_m2[0, 1], 0.03)


def test_roads_of_a_result_folder_come_along_whole_across_the_180th_meridian(tmp_path: Path) -> None:
    write_results(with_roads(small_result()), tmp_path)
    lines: list[Any] = [[[179.999, 50.0], [-179.999, 50.0]], [[8.0, 49.0]]]
    columns: dict[str, Any] = {"start_kind": ["place"] * 2, "end_kind": ["dead_end"] * 2, "width_profile_m": [[]] * 2}
    plain = {each.name: [1, 1] for each in LAYERS["roads"].attributes}
    plain |= {name: [1, 1] for name in ("width_p10_m", "width_p90_m", "keyframes")}
    columns |= plain | {"width_m": [6.5, 6.5], "is_driven": [True, False]}
    write_collection(tmp_path / "roads.geojson", LAYERS["roads"].features(lines, **columns), local=False)
    data = Pass.of(read_results(tmp_path))
    assert [line.tolist() for line in data.roads_lonlat] == [[[179.999, 50.0], [-179.999, 50.0]]]
    assert (data.road_width_m.tolist(), data.road_driven.tolist()) == ([6.5], [True])


def test_a_drive_without_intersections_is_on_the_map_too() -> None:
    city = merge([small_result(empty=True)])
    assert len(city.places) == 0
    other = Pass.of(small_result())
    city.add(replace(other, name="08", track_lonlat=other.track_lonlat + 1e-6))
    assert city.places.near == [("07", "08")]
    assert len(city.places) == 1


NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)


def judgement(finding: str, verdict: Verdict, minute: int) -> Judgement:
    at = NOON + timedelta(minutes=minute)
    return Judgement(finding=finding, kind="moved", verdict=verdict, by="Anna", at=at, lon=8.4, lat=49.0)


def test_wilsons_interval() -> None:
    assert wilson(0, 0) == (None, None)
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)  # Newcombe 1998, table I
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
    found = Precision.of(["right", "fixed", "wrong", "cannot_tell"])
    assert (found.right, found.wrong, found.cannot_tell) == (2, 1, 1)
    assert (found.share, found.low, found.high) == (2 / 3, *wilson(2, 3))


def test_the_last_verdict_of_a_finding_counts() -> None:
    first, second, other = judgement("a", "wrong", 0), judgement("a", "right", 5), judgement("b", "wrong", 1)
    assert latest([second, first, other]) == {"a": second, "b": other}
