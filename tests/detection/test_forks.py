"""Forks: the place where one road parts into others."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.arrays import FloatArray, UInt8Array
from interloc.detection.branches import Branches
from interloc.detection.refinement import REACH, _misfit, find_fork, refine
from tests.detection.test_refinement import branches
from tests.images import binary_image

NODE = (200.0, 150.0)
CROTCH = (200.0, 230.0)  # where the centerline branches
HALF = 20.0


def fork(*arms: list[tuple[float, float]], half: float = HALF, stem_half: float = HALF) -> tuple[Branches, UInt8Array]:
    """Draw a stem that comes from the left and arms that go on through the given places; return lines and road."""
    road = np.zeros((400, 400), np.uint8)
    for places, width in [([NODE, (200.0, -50.0)], stem_half), *(([NODE, *arm], half) for arm in arms)]:
        line = np.round(np.array(places)[:, ::-1]).astype(np.int32)
        cv2.polylines(road, [line], isClosed=False, color=1, thickness=round(2 * width) + 1)
    ends = [arm[-2:] if len(arm) > 1 else [NODE, *arm] for arm in arms]
    points = [(200.0, 60.0), *(end[1] for end in ends)]
    angles = [math.atan2(end[1][1] - end[0][1], end[1][0] - end[0][0]) for end in ends]
    found = branches(points, [270.0, *np.degrees(angles)], candidate=CROTCH, inner=70, length=60.0)
    found.lines["half_width"] = np.array([stem_half, *(half for _ in arms)]) + 1.0  # to the first pixel beside the road
    return found, road


def found_at(lines: Branches, road: UInt8Array) -> tuple[int, FloatArray]:
    """Return the stem and the place of the fork."""
    words = binary_image(road).words
    stem, row, col = find_fork(lines.lines, lines.candidate, lines.inner, words)
    return stem, lines.candidate + np.array([row, col])


@pytest.mark.parametrize("arms_deg", [(15, -15), (30, -30), (40, -10), (0, 40), (30, 0, -30)])
def test_straight_arms_part_where_their_axes_meet(arms_deg: tuple[int, ...]) -> None:
    ends = [(200.0 - 180 * math.sin(math.radians(a)), 150.0 + 180 * math.cos(math.radians(a))) for a in arms_deg]
    stem, place = found_at(*fork(*([end] for end in ends)))
    assert stem == 0
    np.testing.assert_allclose(place, NODE, atol=4.0)


def test_arms_that_bend_on_their_way_part_where_the_road_widens() -> None:
    """Their lines meet 55 pixels farther on."""
    lines, road = fork([(178.0, 235.0), (108.0, 330.0)], [(222.0, 235.0), (292.0, 330.0)])
    stem, place = found_at(lines, road)
    assert stem == 0
    assert math.dist(place, NODE) < 10.0
    by_fork = refine(lines, 2.0, binary_image(road)).position
    lines.lines["half_width"] = 0.0
    by_lines = refine(lines, 2.0, binary_image(road)).position
    assert math.dist(by_lines, NODE) > 50.0
    assert math.dist(by_fork, NODE) < 45.0  # it weighs one and a half lines


def test_carriageways_narrower_than_their_road_part_from_its_axis() -> None:
    lines, road = fork([(160.0, 330.0)], [(240.0, 330.0)], half=13.0, stem_half=21.0)
    np.testing.assert_allclose(found_at(lines, road)[1], NODE, atol=4.0)


def test_parked_car_does_not_move_it() -> None:
    lines, road = fork([(100.0, 330.0)], [(300.0, 330.0)])
    road[212:230, 105:135] = 0
    np.testing.assert_allclose(found_at(lines, road)[1], NODE, atol=4.0)


def test_near_parallel_lines_take_the_place_of_the_fork() -> None:
    lines, road = fork([(180.0, 350.0)], [(220.0, 350.0)])
    found = refine(lines, 2.0, binary_image(road))
    assert found.residual == math.inf
    np.testing.assert_allclose(found.position, found_at(lines, road)[1])


@pytest.mark.parametrize("arms_deg", [(0, 90), (60, -60), (0,)])
def test_branches_of_which_none_is_led_on_by_all_others_are_no_fork(arms_deg: tuple[int, ...]) -> None:
    ends = [(200.0 - 180 * math.sin(math.radians(a)), 150.0 + 180 * math.cos(math.radians(a))) for a in arms_deg]
    lines, road = fork(*([end] for end in ends))
    stem, place = found_at(lines, road)
    assert stem == -1
    assert place.tolist() == list(CROTCH)


@pytest.mark.parametrize("branch", [0, 1])
def test_branch_without_a_line_leads_from_the_candidate_through_its_mean(branch: int) -> None:
    lines, road = fork([(110.0, 330.0)], [(290.0, 330.0)])
    struck = lines.lines[branch]
    away = struck["point"] - lines.candidate
    struck["direction"], struck["length"], struck["weight"] = away / math.hypot(*away), 0.0, 0.0
    stem, place = found_at(lines, road)
    assert stem == 0
    np.testing.assert_allclose(place, NODE, atol=8.0)


def test_stem_of_unknown_width_makes_no_fork() -> None:
    lines, road = fork([(100.0, 330.0)], [(300.0, 330.0)])
    lines.lines["half_width"][0] = 0.0
    assert found_at(lines, road)[0] == -1


def plain_misfit(edges: FloatArray, place: int, half: float, arms: FloatArray) -> float:
    """Return the misfit by whole columns."""
    s = np.arange(len(edges), dtype=float)
    reached = [np.where(s <= place, half, 0.0)[:, None] * np.ones(2)]
    for along, aside, slope, half_width in arms:
        chord = aside / (along - place) if along > place else 0.0
        on_chord = (place < along) & (s <= along)
        slopes = np.where(on_chord, chord, slope)
        axis = np.where(on_chord, (s - place) * chord, aside + (s - along) * slope)
        across = half_width * np.hypot(1.0, slopes)
        beyond = s > place
        left, right = (
            np.where(beyond | (slopes > 0), across + axis, 0),
            np.where(beyond | (slopes < 0), across - axis, 0),
        )
        reached.append(np.column_stack([left, right]))
    off = np.abs(edges - np.minimum(np.max(reached, axis=0), REACH * half))
    return float(np.minimum(off, half).sum())


@given(st.integers(0, 2**32 - 1), st.integers(0, 79), st.integers(2, 4))
def test_misfit_is_that_of_whole_columns(seed: int, place: int, count: int) -> None:
    random = np.random.default_rng(seed)
    edges = random.uniform(5, 60, (80, 2))
    slopes, halves = random.uniform(-1, 1, count), random.uniform(5, 30, count)
    arms = np.column_stack([random.uniform(20, 100, count), random.uniform(-40, 40, count), slopes, halves])
    assert _misfit(edges, place, 20.0, arms) == pytest.approx(plain_misfit(edges, place, 20.0, arms), rel=1e-9)
