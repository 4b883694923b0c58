"""Where intersections may be: Harris corners and junctions of the centerline."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.arrays import FloatArray, UInt8Array
from interloc.config import CrossingCandidates, HarrisCandidates
from interloc.detection.candidates import Candidates, find_candidates, harris_corners, merge_until_stable
from interloc.detection.centerline import Centerline
from tests.images import binary_image


def line_image(*lines: tuple[int, int, int, int], size: int = 300) -> UInt8Array:
    image = np.zeros((size, size), np.uint8)
    for r0, c0, r1, c1 in lines:
        cv2.line(image, (c0, r0), (c1, r1), 1)
    return image


def centerline(lines: UInt8Array, width: int = 21) -> Centerline:
    """Take lines as the axis of roads of a width in pixels; a pixel is a metre."""
    road = cv2.dilate(lines, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width)))
    return Centerline.of(binary_image(lines), binary_image(road))


# --- merging ---------------------------------------------------------------------------------------------------------


def test_near_points_are_replaced_by_their_average() -> None:
    merged, groups = merge_until_stable(np.array([[0.0, 0.0], [50.0, 0.0], [4.0, 2.0]]), 10)
    assert merged.tolist() == [[2, 1], [50, 0]]
    assert groups == [[0, 2], [1]]


def test_average_that_comes_near_to_another_is_merged_again() -> None:
    merged, groups = merge_until_stable(np.array([[0.0, 0.0], [9.0, 0.0], [14.0, 0.0]]), 10)
    np.testing.assert_allclose(merged, [[23 / 3, 0]])
    assert sorted(groups[0]) == [0, 1, 2]


def test_points_just_as_far_as_the_radius_stay_apart() -> None:
    merged, _ = merge_until_stable(np.array([[0.0, 0.0], [6.0, 8.0]]), 10)
    assert merged.tolist() == [[0, 0], [6, 8]]


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), max_size=15), st.integers(0, 30))
def test_merged_points_are_averages_and_none_are_near(points: list[tuple[int, int]], radius: int) -> None:
    positions = np.array(points, np.float64).reshape(-1, 2)
    merged, groups = merge_until_stable(positions, radius)
    assert sorted(i for group in groups for i in group) == list(range(len(points)))
    np.testing.assert_allclose(merged, np.array([positions[g].mean(axis=0) for g in groups]).reshape(-1, 2))
    for i in range(len(merged)):
        for j in range(i):
            assert math.dist(merged[i], merged[j]) >= radius - 1e-9


# --- Harris corners --------------------------------------------------------------------------------------------------


def test_harris_finds_the_crossing_of_two_lines() -> None:
    line = centerline(line_image((150, 0, 150, 299), (0, 100, 299, 100)))
    found = find_candidates(line, HarrisCandidates())
    assert len(found.positions) == 1
    assert math.dist(found.positions[0], (150, 100)) < 5
    assert found.widths[0] >= 20


def test_harris_finds_nothing_on_a_straight_line() -> None:
    line = centerline(line_image((150, -10, 150, 310)))
    inner = HarrisCandidates(min_score=0)
    positions = find_candidates(line, inner).positions
    assert all(min(p[1], 299 - p[1]) < 12 for p in positions)  # the window's edge is a corner, if anything


def test_weak_corners_are_left_out_by_their_share_of_the_best() -> None:
    lines = line_image((150, 0, 150, 299), (0, 100, 299, 100), (60, 200, 60, 260), (60, 260, 30, 280))
    line = centerline(lines)
    every, _ = harris_corners(line, HarrisCandidates(min_score=0.01))
    best, scores = harris_corners(line, HarrisCandidates(min_score=0.9))
    assert len(best) < len(every)
    assert np.all(scores[best] >= 0.9 * scores.max())
    assert np.all(np.diff(scores[every]) <= 0)


def test_harris_corners_nearer_than_the_merging_distance_are_one() -> None:
    lines = line_image((150, 0, 150, 299), (0, 100, 150, 100), (150, 130, 299, 130))
    apart = find_candidates(centerline(lines), HarrisCandidates(merge_m=10))
    merged = find_candidates(centerline(lines), HarrisCandidates(merge_m=50))
    assert len(apart.positions) == 2
    assert len(merged.positions) == 1
    assert abs(merged.positions[0, 1] - 115) < 6


# --- crossings -------------------------------------------------------------------------------------------------------


def crossings(lines: UInt8Array, width: int = 21, **settings: float) -> tuple[FloatArray, FloatArray]:
    values = {"merge_widths": 1.0, "merge_max_m": 100.0} | settings
    found = find_candidates(centerline(lines, width), CrossingCandidates(**values))
    return found.positions, found.widths


def test_crossing_lines_have_one_candidate() -> None:
    positions, widths = crossings(line_image((150, 0, 150, 299), (0, 100, 299, 100)))
    assert positions.tolist() == [[150, 100]]
    assert widths[0] >= 20


def test_corner_is_no_candidate() -> None:
    positions, widths = crossings(line_image((150, 0, 150, 100), (150, 100, 299, 100)))
    assert positions.shape == (0, 2)
    assert widths.shape == (0,)


STAGGERED = line_image((150, 0, 150, 299), (0, 100, 150, 100), (150, 130, 299, 130))


def test_junctions_joined_within_a_road_width_are_one() -> None:
    two, _ = crossings(STAGGERED, 21)
    one, _ = crossings(STAGGERED, 41)
    assert two.tolist() == [[150, 100], [150, 130]]
    assert one.tolist() == [[150, 115]]


def test_junctions_of_one_candidate_part_where_they_are_far_apart() -> None:
    whole = find_candidates(centerline(STAGGERED, 21), CrossingCandidates(merge_widths=1.6, merge_max_m=100))
    parted = whole.parted([0])
    assert len(whole.positions) == 1
    assert parted.positions.tolist() == [[150, 100], [150, 130]]
    assert parted.parted([0, 1]) is parted


@pytest.mark.parametrize(("settings", "count"), [({"merge_max_m": 28}, 2), ({"merge_max_m": 50}, 1)])
def test_junctions_beyond_the_most_length_are_apart_however_wide(settings: dict[str, float], count: int) -> None:
    assert len(crossings(STAGGERED, 41, **settings)[0]) == count


def test_junctions_near_each_other_but_not_joined_are_apart() -> None:
    lines = line_image((150, 0, 150, 299), (150, 100, 0, 100), (160, 0, 160, 299), (160, 100, 299, 100))
    positions, _ = crossings(lines, 31)
    assert positions.tolist() == [[150, 100], [160, 100]]


def test_width_of_a_candidate_is_the_widest_of_its_junctions() -> None:
    line = centerline(STAGGERED, 41)
    road = line.occupancy.to_array()
    road[151:, 131:] = 0  # one side of the second junction is narrow
    narrowed = Centerline.of(line.image, binary_image(road))
    config = CrossingCandidates(merge_widths=2, merge_max_m=100)
    (width,) = find_candidates(narrowed, config).widths
    junctions = np.flatnonzero(narrowed.degrees >= 3).astype(np.int32)
    widths = narrowed.widths(junctions)
    assert len(set(widths.tolist())) == 2
    assert width == widths.max()


@pytest.mark.parametrize("config", [HarrisCandidates(), CrossingCandidates()])
def test_no_line_no_candidates(config: HarrisCandidates | CrossingCandidates) -> None:
    found = find_candidates(centerline(line_image()), config)
    assert found.positions.shape == (0, 2)
    assert found.widths.shape == (0,)


def test_candidates_inside_keep_the_margin_to_every_border() -> None:
    positions = np.array([[10, 50], [9.9, 50], [50, 89], [50, 89.1], [50, 10], [89.1, 10], [50, 50]])
    found = Candidates(positions, np.ones(7), [np.empty((0, 2))] * 7, are_junctions=True)
    assert found.inside(100, 10).tolist() == [0, 2, 4, 6]
    assert found.inside(100, 0).tolist() == list(range(7))
