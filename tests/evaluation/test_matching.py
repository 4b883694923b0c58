import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.evaluation.metrics import UNMATCHED, match, pairs_in_square
from interloc.geometry import enu_from_lonlat, rotate_2d
from interloc.results import DriveResult
from tests.evaluation.made import at, run


def test_a_detection_takes_the_nearest_node_of_the_roi() -> None:
    one = run([(0, 0)], [(0, 1, 0), (0, 28, 0), (0, -50, 50)])
    result = match(one.keyframes, one.detections, at([(0, 0), (30, 0)]), roi_m=120, relevant_zone_m=40)
    assert result.node.tolist() == [0, 1, 0]
    assert result.error_m == pytest.approx([1.0, 2.0, math.hypot(50, 50)], abs=1e-3)
    assert (result.zone_keyframe.tolist(), result.zone_node.tolist()) == ([0], [0])  # the other lies 30 m ahead
    assert result.zone_found.tolist() == [True]


def test_a_far_detection_still_saves_its_node_from_being_missed() -> None:
    """The paper asks for a matching detection, not for a close one."""
    one = run([(0, 0)], [(0, 55, 55)])
    result = match(one.keyframes, one.detections, at([(0, 0)]), roi_m=120, relevant_zone_m=40)
    assert result.zone_found.tolist() == [True]


def test_the_squares_are_aligned_with_the_world_frame() -> None:
    corner = at([(19, 19)])  # in a 40 m square that looks east, outside of one turned by 45 degrees
    straight = run([(0, 0)], world_yaw_in_enu_rad=0.0)
    turned = run([(0, 0)], world_yaw_in_enu_rad=math.pi / 4)
    assert pairs_in_square(straight.keyframes, corner, 40)[1].tolist() == [0]
    assert pairs_in_square(turned.keyframes, corner, 40)[1].tolist() == []
    assert pairs_in_square(turned.keyframes, at([(27, 0)]), 40)[1].tolist() == [0]


def test_the_heading_of_the_car_does_not_turn_the_squares() -> None:
    turning = run([(0, 0)], yaw_rad=[math.pi / 4], world_yaw_in_enu_rad=0.0)
    assert pairs_in_square(turning.keyframes, at([(19, 19)]), 40)[1].tolist() == [0]


@pytest.mark.parametrize(("detections", "nodes"), [((), [(0, 0)]), ([(0, 1, 1)], []), ((), [])])
def test_nothing_there_is_no_error(detections: list[Any], nodes: list[Any]) -> None:
    one = run([(0, 0)], detections)
    result = match(one.keyframes, one.detections, at(nodes), roi_m=120, relevant_zone_m=40)
    assert len(result.node) == len(detections)
    assert not result.is_matched.any()


def match_plainly(
    run: DriveResult, node_lonlat: np.ndarray, roi_m: float, zone_m: float
) -> tuple[list[int], list[float], list[tuple[int, int, bool]]]:
    """Say the same as `match`, detection by detection and node by node."""
    keys, detections = run.keyframes, run.detections
    node, error, zone = [], [], []
    matched = set()
    for d in range(len(detections)):
        k = detections.keyframe[d]
        lon, lat = keys.lonlat[k]
        best, best_error = UNMATCHED, math.inf
        for n in range(len(node_lonlat)):
            place = enu_from_lonlat(lat, lon, node_lonlat[n])
            seen = enu_from_lonlat(lat, lon, detections.lonlat[d])
            if in_square(run, k, place, roi_m) and math.dist(place, seen) < best_error:
                best, best_error = n, math.dist(place, seen)
        node.append(best)
        error.append(best_error)
        matched.add((k, best))
    for k in range(len(keys)):
        lon, lat = keys.lonlat[k]
        zone += [
            (k, n, (k, n) in matched)
            for n in range(len(node_lonlat))
            if in_square(run, k, enu_from_lonlat(lat, lon, node_lonlat[n]), zone_m)
        ]
    return node, error, zone


def in_square(run: DriveResult, k: int, enu: np.ndarray, side_m: float) -> bool:
    x, y = rotate_2d(enu, run.keyframes.world_yaw_rad[k] - run.keyframes.enu_yaw_rad[k])
    return max(abs(x), abs(y)) <= side_m / 2


metres = st.integers(-90, 90).map(float)
places = st.lists(st.tuples(metres, metres), max_size=8)


@settings(deadline=None, max_examples=60)
@given(
    keyframes=st.lists(st.tuples(metres, metres), min_size=1, max_size=4),
    detections=st.lists(st.tuples(st.integers(0, 3), metres, metres), max_size=8),
    nodes=places,
    world_yaw=st.floats(-3, 3),
)
def test_matching_is_what_the_plain_loops_say(
    keyframes: list[Any], detections: list[Any], nodes: list[Any], world_yaw: float
) -> None:
    detections = [(min(k, len(keyframes) - 1), x + 0.25, y - 0.125) for k, x, y in detections]
    made = run(keyframes, detections, world_yaw_in_enu_rad=world_yaw)
    result = match(made.keyframes, made.detections, at(nodes), roi_m=120, relevant_zone_m=40)
    node, error, zone = match_plainly(made, at(nodes), 120, 40)
    assert result.error_m == pytest.approx(error)
    assert list(zip(result.zone_keyframe, result.zone_node, strict=True)) == [(k, n) for k, n, _ in zone]
    if result.node.tolist() == node:  # among equally distant nodes rounding decides
        assert result.zone_found.tolist() == [found for *_, found in zone]
