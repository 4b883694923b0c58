"""The point where the lines of the branches meet; forks: the place where one road parts into others."""

import math
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import least_squares, minimize

from interloc.arrays import FloatArray, UInt8Array
from interloc.detection.branches import Branches
from interloc.detection.edges import SLACK_M
from interloc.detection.lines import LINE, SIDE_BY_SIDE_RAD
from interloc.detection.refinement import MAX_SHIFTS, REACH, ROUNDS, TOLERANCE, UNKNOWN_M, _misfit, find_fork, refine
from tests.images import binary_image


def branches(
    points: list[tuple[float, float]],
    angles_deg: list[float],
    *,
    candidate: tuple[float, float] = (0.0, 0.0),
    inner: float = 1e6,
    weights: list[float] | None = None,
    length: float | FloatArray = math.inf,
) -> Branches:
    """Lay a line through each point, in the direction of an angle; none where the weight is 0."""
    angles = np.radians(angles_deg)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    lines = np.zeros(len(points), LINE)
    lines["point"], lines["direction"] = np.reshape(points, (-1, 2)), directions
    lines["weight"] = 1.0 if weights is None else weights
    lines["length"] = np.where(lines["weight"] > 0.0, length, 0.0)
    lines["begin"] = np.where(lines["length"] < math.inf, -0.5 * lines["length"], 0.0)
    return Branches(
        index=0,
        candidate=np.array(candidate, float),
        inner=float(inner),  # kernels are compiled for these alone
        lines=lines,
        lengths=np.full(len(points), 50.0),
        reaches=np.full(len(points), 60.0),
        core=np.empty((0, 2)),
        resolution_m=1.0,
    )


def residuals(p: FloatArray, given_branches: Branches) -> FloatArray:
    """Return the distance of a point from each line, times the root of its weight."""
    away, directions = given_branches.lines["point"] - p, given_branches.lines["direction"]
    across = away[:, 0] * directions[:, 1] - away[:, 1] * directions[:, 0]
    return across * np.sqrt(given_branches.lines["weight"])


def test_three_lines_meet_in_the_middle_of_their_triangle() -> None:
    found = refine(branches([(0.0, 3.0), (0.0, -3.0), (0.0, 0.0)], [0, 0, 90]))
    np.testing.assert_allclose(found.position, [0, 0], atol=1e-12)
    assert found.residual == pytest.approx(math.sqrt((9 + 9 + 0) / 3))
    assert found.std_m == pytest.approx(math.sqrt((1 / 2 + 1) / 2 + found.residual**2 + SLACK_M**2), rel=1e-3)


@given(st.integers(0, 2**32 - 1), st.integers(2, 6))
def test_point_is_that_of_a_general_least_squares_solver(seed: int, count: int) -> None:
    generator = np.random.default_rng(seed)
    angles = generator.uniform(0, 360, count)
    spread = np.abs(np.sin(np.radians(angles[:, None] - angles))).max()
    assume(spread > math.sin(math.radians(25)))
    lines = branches(
        [tuple(p) for p in generator.uniform(-40, 40, (count, 2))],
        angles.tolist(),
        candidate=(5, -3),
        weights=generator.uniform(0.1, 3, count).tolist(),
    )
    found = refine(lines)
    assume(math.isfinite(found.residual))
    strict = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
    expected = least_squares(residuals, np.zeros(2), jac="3-point", args=(lines,), **strict).x
    np.testing.assert_allclose(found.position, expected, atol=1e-6)
    mean_square = np.sum(residuals(found.position, lines) ** 2) / lines.lines["weight"].sum()
    assert found.residual == pytest.approx(math.sqrt(mean_square), abs=1e-9)


def test_point_is_known_as_its_lines_are() -> None:
    crossing = branches([(0.0, 0.0), (0.0, 0.0)], [0, 90], weights=[4.0, 25.0])
    assert refine(crossing).std_m == pytest.approx(math.sqrt((1 / 4 + 1 / 25) / 2 + SLACK_M**2), rel=1e-3)


def test_line_without_weight_does_not_count() -> None:
    two = branches([(3.0, 100.0), (70.0, 5.0)], [90, 0])
    three = branches([(3.0, 100.0), (70.0, 5.0), (900.0, 900.0)], [90, 0, 30], weights=[1, 1, 0])
    np.testing.assert_allclose(refine(three).position, refine(two).position)
    assert refine(three).residual == pytest.approx(0, abs=1e-9)


def test_point_stays_within_the_inner_circle() -> None:
    found = refine(branches([(30.0, 0.0), (0.0, 40.0)], [90, 0], inner=10))
    np.testing.assert_allclose(found.position, [6, 8])
    assert found.residual == pytest.approx(math.sqrt((24**2 + 32**2) / 2))
    just_within = refine(branches([(3.0, 0.0), (0.0, 4.0)], [90, 0], inner=5.001))
    np.testing.assert_allclose(just_within.position, [3, 4])


def test_for_perpendicular_lines_the_clamped_point_is_the_best_of_the_disc() -> None:
    lines = branches([(30.0, 0.0), (0.0, 40.0)], [90, 0], inner=10)
    inside = {"type": "ineq", "fun": lambda p: 100 - p @ p}
    best = minimize(lambda p: np.sum(residuals(p, lines) ** 2), np.zeros(2), constraints=[inside]).x
    np.testing.assert_allclose(refine(lines).position, best, atol=1e-3)


@pytest.mark.parametrize("fan_deg", [0.0, 2.0, 9.0])
def test_lines_that_run_alike_leave_the_candidate_where_it_is(fan_deg: float) -> None:
    found = refine(branches([(0.0, 10.0), (0.0, 20.0), (0.0, 15.0)], [0, fan_deg, 180 + fan_deg / 2], candidate=(7, 7)))
    assert found.position.tolist() == [7, 7]
    assert found.residual == math.inf


def test_lines_that_run_apart_enough_fix_the_point() -> None:
    found = refine(branches([(0.0, 0.0), (0.0, 0.0)], [0, 25], candidate=(7, 7)))
    np.testing.assert_allclose(found.position, [0, 0], atol=1e-9)


def test_crossing_lines_fix_the_point_however_unlike_their_weights() -> None:
    found = refine(branches([(0.0, 3.0), (0.0, 3.0), (5.0, 0.0)], [0, 180, 90], weights=[600, 600, 0.5]))
    np.testing.assert_allclose(found.position, [5, 3], atol=1e-6)


def test_parallel_lines_fix_nothing_however_heavy_the_candidate() -> None:
    found = refine(branches([(0.0, 3.0), (0.0, 4.0)], [0, 180], candidate=(7, 7)), 100.0)
    assert found.position.tolist() == [7, 7]
    assert (found.residual, found.std_m) == (math.inf, UNKNOWN_M)


@pytest.mark.parametrize("weights", [[], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
def test_fewer_than_two_lines_leave_the_candidate_where_it_is(weights: list[float]) -> None:
    points, count = [(0.0, 1.0), (1.0, 0.0), (2.0, 2.0)], len(weights)
    found = refine(branches(points[:count], [0, 90, 45][:count], candidate=(7, 7), weights=weights))
    assert found.position.tolist() == [7, 7]
    assert found.residual == math.inf


# --- the candidate as one more observation (beyond the paper) --------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10))
def test_point_with_the_candidate_is_that_of_a_general_solver(seed: int, weight: float) -> None:
    generator = np.random.default_rng(seed)
    places = [tuple(p) for p in generator.uniform(-40, 40, (3, 2))]
    lines = branches(places, [10, 100, 230], candidate=(5, -3), weights=generator.uniform(0.1, 3, 3).tolist())

    def all_residuals(p: FloatArray) -> FloatArray:
        return np.concatenate([residuals(p, lines), math.sqrt(weight) * (p - lines.candidate)])

    expected = least_squares(all_residuals, np.zeros(2), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    np.testing.assert_allclose(refine(lines, weight).position, expected, atol=1e-5)


# --- lines that count by what is known of them at the point (beyond the paper) ----------------------------------------


def plain_reweighted(given_branches: Branches, prior_weight: float) -> FloatArray:
    """Return the point after four rounds of reweighted least squares, on road that ends nowhere."""
    candidate, inner = given_branches.candidate, given_branches.inner
    points, directions, spans, heavy = (
        given_branches.lines[name] for name in ("point", "direction", "length", "weight")
    )
    normals = np.column_stack([directions[:, 1], -directions[:, 0]])
    offsets = np.sum(normals * (points - candidate), axis=1)
    pairs = [(u @ v, u + v) for u, v in combinations(directions, 2) if u @ v < math.cos(SIDE_BY_SIDE_RAD)]
    cosine, middle = max(pairs, key=lambda pair: pair[0])
    farther = max(1.0, math.sin(math.pi / 4) / math.sin(0.5 * math.acos(cosine)))
    along = np.outer(middle, middle) / (middle @ middle)
    prior = prior_weight * (np.eye(2) - along + along / farther**4)

    def variance(p: FloatArray) -> FloatArray:
        return 1.0 + 12.0 * (np.sum((p - points) * directions, axis=1) / spans) ** 2

    shift = np.zeros(2)
    for _ in range(ROUNDS):
        off = (normals @ shift - offsets) / (TOLERANCE * inner)
        weights = heavy * variance(candidate) / variance(candidate + shift) / (1.0 + off**2) ** 2
        normal_matrix = (normals.T * weights) @ normals + prior
        shift = np.linalg.solve(normal_matrix, normals.T @ (weights * offsets))
        shift *= min(1.0, MAX_SHIFTS * inner / math.hypot(*shift))
    return candidate + shift


@given(st.integers(0, 2**32 - 1), st.sampled_from([4.0, 12.0, 40.0]))
def test_point_on_the_road_is_that_of_reweighted_least_squares(seed: int, inner: float) -> None:
    generator = np.random.default_rng(seed)
    points = [(math.cos(angle) * 40.0 + 100.0, math.sin(angle) * 40.0 + 100.0) for angle in (0.0, 1.6, 3.5)]
    angles_deg = (np.degrees([0.0, 1.6, 3.5]) + generator.normal(0.0, 20.0, 3)).tolist()
    weights = generator.uniform(0.5, 9.0, 3).tolist()
    spans = generator.uniform(20.0, 90.0, 3)
    lines = branches(points, angles_deg, candidate=(100.0, 100.0), inner=inner, weights=weights, length=spans)
    road = binary_image(np.ones((200, 200), np.uint8))
    found = refine(lines, 0.25, road)
    assume(math.isfinite(found.residual))  # not near-parallel
    np.testing.assert_allclose(found.position, plain_reweighted(lines, 0.25), atol=1e-9)


def test_lines_that_bend_meet_where_their_roads_do() -> None:
    """Two carriageways of a bend with a radius of 50 pixels whose middle is 50 pixels above, and a straight road."""
    lines = branches(
        [(96.8, 82.3), (96.8, 117.7), (120.0, 100.0)], [200.9, 159.1, 0], candidate=(97.0, 101.0), length=30.0
    )
    lines.lines["direction"][:2] = [[-0.3535, -0.9354], [-0.3535, 0.9354]]
    straight = on_open_road(lines, 0.0)
    lines.lines["bend"] = 0.01, -0.01, 0.0
    meeting = on_open_road(lines, 0.0)
    np.testing.assert_allclose(meeting, [100.0, 100.0], atol=0.4)
    assert math.dist(straight, (100.0, 100.0)) > 2.0


def test_mouth_of_a_side_road_tells_where_it_joins_when_its_road_strays_from_its_line() -> None:
    """A side road at right angles whose line leans by 20 degrees, as where it bends; its candidate lies there, too."""
    road = np.zeros((200, 200), np.uint8)
    road[90:111], road[90:, 92:109] = 1, 1
    for row in range(111, 126):  # corners between kerbs
        road[row, row - 34 : 235 - row] = 1
    lines = branches([(100.0, 40.0), (100.0, 160.0), (145.0, 100.0)], [270, 90, -20], candidate=(100, 112), inner=15.0)
    lines.lines["length"], lines.lines["half_width"], lines.lines["is_parallel"] = 30.0, (10.0, 10.0, 8.0), True
    lines.lines["stray"][2] = 1e-4
    lines = replace(lines, resolution_m=0.25)
    seen, unseen = (binary_image(each, 0.25) for each in (1 - road, np.zeros_like(road)))
    without = refine(lines, 1.0, binary_image(road, 0.25), unseen).position
    found = refine(lines, 1.0, binary_image(road, 0.25), seen).position
    assert math.dist(without, (100.0, 100.0)) > 9.0
    assert math.dist(found, (100.0, 100.0)) < 5.0


def test_what_a_bend_leaves_unsure_is_a_residual() -> None:
    lines = branches([(0.0, 0.0)] * 3, [0, 180, 90], candidate=(0.0, 0.0))
    lines.lines["unsure"] = 0.0, 3.0, 9.0
    assert refine(lines).residual == pytest.approx(2.0)


def on_open_road(lines: Branches, prior_weight: float) -> FloatArray:
    """Return the point on road that ends nowhere."""
    road = binary_image(np.ones((400, 400), np.uint8))
    return refine(lines, prior_weight, road).position


def test_candidate_of_an_acute_pair_holds_the_point_across_it_but_hardly_along_it() -> None:
    """The surfaces of roads at 40 degrees part, and the centerline branches, far from where their axes meet."""
    points = [(200.0, 140.0), (200.0, 200.0), (200.0, 200.0)]
    acute = branches(points, [90, 20, -20], candidate=(240, 200), inner=60, weights=[0.1, 9, 9], length=60.0)
    row, col = on_open_road(acute, 4.0)
    assert col == pytest.approx(200.0, abs=0.1)
    assert row < 206.0  # as heavy along the road as across it, it would hold the point at 226


def test_candidate_between_two_carriageways_is_as_well_known_as_that_of_a_crossing() -> None:
    """Roads side by side meet nowhere, so they do not say that the centerline branches far off."""
    points = [(140.0, 212.0), (200.0, 260.0), (230.0, 260.0)]  # the stem runs beside the candidate
    dual = branches(points, [180, 90, 89], candidate=(200, 200), inner=60, weights=[0.1, 9, 0.1], length=60.0)
    assert on_open_road(dual, 4.0)[1] == pytest.approx(200.0, abs=1.0)


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
    stem, row, col, _ = find_fork(lines.lines, lines.candidate, lines.inner, words)
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
    lines = replace(lines, resolution_m=0.16)
    stem, place = found_at(lines, road)
    assert stem == 0
    assert math.dist(place, NODE) < 10.0
    by_fork = refine(lines, 2.0, binary_image(road)).position
    lines.lines["half_width"] = 0.0
    by_lines = refine(lines, 2.0, binary_image(road)).position
    assert math.dist(by_lines, NODE) > 50.0
    assert math.dist(by_fork, NODE) < 25.0


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


@pytest.mark.parametrize(("arms_deg", "bend"), [((0, 90), 0), ((60, -60), 0), ((0,), 0), ((30, -30), 0.01)])
def test_branches_of_which_none_is_led_on_by_all_others_are_no_fork(arms_deg: tuple[int, ...], bend: float) -> None:
    ends = [(200.0 - 180 * math.sin(math.radians(a)), 150.0 + 180 * math.cos(math.radians(a))) for a in arms_deg]
    lines, road = fork(*([end] for end in ends))
    lines.lines["bend"][1:] = bend  # they begin farther aside
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
