"""Lines through branches: small drawings checked by eye."""

import math
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.arrays import StructuredArray, UInt8Array
from interloc.detection.centerline import Centerline
from interloc.detection.edges import PLACE, RING_PX, SLACK_PX
from interloc.detection.image import BinaryImage
from interloc.detection.lines import FIT, LINE, _bend, _join_roads, _scatters, _square_stems, _stray, fit_lines
from interloc.kernels.bits import NOWHERE
from interloc.kernels.skeleton import thin, trace_branches
from tests.images import binary_image, cross

ANGLES_RAD = math.radians(25.0), math.radians(7.0)  # within which a road is straight; of square stems


def fit(
    image: BinaryImage,
    candidate: tuple[int, int],
    *,
    width: float = 0.0,
    inner: float = 10.0,
    length: float = 99.0,
    shortest: float = 99.0,
    slack: float = SLACK_PX,
    trim: float = 0.0,
) -> StructuredArray:
    """Fit a line to each branch of a candidate, from its inner circle 60 pixels far; all lengths are pixels."""
    line, place = Centerline.of(image, image), np.array(candidate, np.float64)
    traced, is_main, pieces = trace_branches(
        line.rows, line.cols, line.neighbours, place, np.empty((0, 2)), inner, 60.0, 5.0
    )
    given = np.array((*place, width, inner, length, shortest, trim, 99.0, RING_PX, slack, *ANGLES_RAD), FIT)[()]
    no_surface = np.zeros_like(image.words)  # so there are no edges to follow
    return fit_lines(given, line.pixels, traced, is_main, pieces, no_surface, NOWHERE)


def test_line_is_fitted_to_the_trusted_part_only() -> None:
    image = np.zeros((201, 201), np.uint8)
    image[100, 100:151] = 1
    image[np.arange(93, 100), np.arange(157, 150, -1)] = 1  # the tip bends away, 45 degrees, and ends 57 pixels off
    packed = binary_image(image)
    bent = fit(packed, (100, 100), trim=0.0)
    assert abs(bent[0]["direction"][0]) > 0.02
    trimmed = fit(packed, (100, 100), trim=12.0)
    assert abs(trimmed[0]["direction"][0]) < 1e-9
    short = fit(packed, (100, 100), length=30.0)
    assert abs(short[0]["direction"][0]) < 1e-9
    assert short[0]["length"] == pytest.approx(30, abs=RING_PX)


def test_line_is_fitted_as_far_as_the_branch_is_straight() -> None:
    image = np.zeros((201, 201), np.uint8)
    image[100, 100:130] = 1
    image[np.arange(80, 100), np.arange(149, 129, -1)] = 1  # turns off by 45 degrees 30 pixels from the candidate
    packed = binary_image(image)
    (whole,) = fit(packed, (100, 100))
    (straight,) = fit(packed, (100, 100), shortest=8.0, slack=0.3)
    assert abs(whole["direction"][0]) > 0.3
    assert abs(straight["direction"][0]) < 0.05
    assert straight["length"] == pytest.approx(20, abs=2 * RING_PX)


def test_line_is_fitted_to_half_the_least_length_however_bent() -> None:
    image = np.zeros((201, 201), np.uint8)
    angles = np.linspace(0, 1.5, 500)  # an arc of 40 pixels' radius
    image[np.round(60 + 40 * np.cos(angles)).astype(int), np.round(100 + 40 * np.sin(angles)).astype(int)] = 1
    packed = binary_image(image)
    thin(packed.words)
    (row,) = fit(packed, (100, 100), shortest=24.0, slack=0.1)
    assert row["rms"] > 0.1
    assert row["length"] == pytest.approx(12, abs=RING_PX)


def test_line_begins_where_the_road_parts_from_its_neighbours() -> None:
    image = np.zeros((201, 201), np.uint8)
    image[100, 100:180] = 1
    image[20:101, 100] = 1
    image[100, 100:130] = 0
    image[np.round(100 - 4 * np.linspace(1, 0, 60)).astype(int), np.linspace(100, 130, 60).astype(int)] = 1  # bent
    packed = binary_image(image)
    early = fit(packed, (100, 100), inner=5.0)
    late = fit(packed, (100, 100), inner=5.0, width=43.0)  # two such roads part at 30 pixels: 43 / 2 / sin 45
    assert abs(early[-1]["direction"][0]) > 0.02
    assert abs(late[-1]["direction"][0]) < 0.01
    assert late[-1]["length"] == pytest.approx(30, abs=2 * RING_PX)


def test_roads_side_by_side_begin_at_the_inner_circle() -> None:
    image = np.zeros((201, 201), np.uint8)
    diagonal = np.arange(16)
    for row, sense in ((85, -1), (115, 1)):
        image[100 + sense * diagonal, 100 + diagonal] = 1
        image[row, 115:190] = 1
    carriageways = fit(binary_image(image), (100, 100), inner=25.0, width=40.0)
    at_inner_circle = int(np.pi * 25.0 / RING_PX) + 1
    assert carriageways["first"].tolist() == [at_inner_circle] * 2
    for row in range(115, 190):  # the lower one turns away by 20 degrees, so that they come from one place
        image[115, row] = 0
        image[115 + round(0.36 * (row - 115)), row] = 1
    fork = fit(binary_image(image), (100, 100), inner=25.0, width=40.0)
    assert fork["first"].min() > at_inner_circle + 2


def test_longer_and_straighter_lines_weigh_more() -> None:
    image = cross()
    weights = [fit(binary_image(image), (100, 100), length=length)[0]["weight"] for length in (12.0, 24.0, 48.0)]
    assert 0 < weights[0] < weights[1] < weights[2]
    image[100, 131:] = 0
    image[np.arange(101, 131), np.arange(131, 161)] = 1
    table = fit(binary_image(image), (100, 100))
    assert table[2]["rms"] > 1
    assert 0 < table[2]["weight"] < table[0]["weight"]


def test_branch_with_nothing_to_trust_has_no_line() -> None:
    image = np.zeros((201, 201), np.uint8)
    image[100, 100:116] = 1
    assert fit(binary_image(image), (100, 100), trim=20.0)[["length", "weight"]].tolist() == [(0.0, 0.0)]


@pytest.mark.parametrize("angle_deg", [0, 10, 45, 77, 90, 135, 200, 290])
def test_fitted_line_is_that_of_total_least_squares(angle_deg: float) -> None:
    along = np.array([-math.sin(math.radians(angle_deg)), math.cos(math.radians(angle_deg))])  # row, column
    image = np.zeros((201, 201), np.uint8)
    end = np.round(100 + 80 * along).astype(int)
    cv2.line(image, (100, 100), (int(end[1]), int(end[0])), 1)
    packed = binary_image(image)
    (row,) = fit(packed, (100, 100))
    points = np.column_stack(packed.pixels()).astype(np.float64)
    distance = np.hypot(*(points - 100).T)
    points = points[(distance > 10) & (distance < 60)]
    centred = points - points.mean(axis=0)
    direction = np.linalg.svd(centred)[2][0]
    direction *= np.sign(direction @ along)
    np.testing.assert_allclose(row["point"] + row["begin"] * row["direction"], 100 + 12 * along, atol=1.5)
    np.testing.assert_allclose(row["point"], points.mean(axis=0))
    np.testing.assert_allclose(row["direction"], direction, atol=1e-9)
    across = centred @ np.array([-direction[1], direction[0]])
    np.testing.assert_allclose(row["rms"], np.sqrt(np.mean(across**2)), atol=1e-6)
    assert direction @ along > 0.999


def test_what_leads_aside_of_a_branch_does_not_pull_its_line() -> None:
    image = cross()
    image[85:100, 130] = 1
    np.testing.assert_allclose(fit(binary_image(image), (100, 100))["direction"][2], [0, 1], atol=0.01)


def lines_at(*angles_deg: float, length: float | list[float] = 60.0, rms: float | list[float] = 0.4) -> StructuredArray:
    angles = np.radians(angles_deg)
    lines = np.zeros(len(angles), LINE)
    lines["direction"] = np.column_stack([-np.sin(angles), np.cos(angles)])
    lines["length"], lines["rms"] = length, rms
    return lines


def squared(lines: StructuredArray) -> list[float]:
    """Turn stems towards the right angle; return the angles of all lines."""
    given = np.zeros((), FIT)
    (given["straight"], given["square"]), given["shortest"] = ANGLES_RAD, 20.0
    _square_stems(lines, _scatters(lines), given[()])
    row, col = lines["direction"].T
    np.testing.assert_allclose(np.hypot(row, col), 1.0)
    return [float(angle) for angle in np.degrees(np.arctan2(-row, col)) % 360.0]


def bent(curvature: float, halves: list[float], *, straight: float = 40.0, wavy: float = 0.0) -> StructuredArray:
    """Let the line of a branch bend that leads along a row from column 10 to 110; the candidate is at the origin."""
    axis, col = np.zeros(25, PLACE), 12.0 + 4.0 * np.arange(25)
    axis["row"], axis["col"], axis["n"], axis["half"] = 0.5 * curvature * col**2, col, 4.0, np.resize(halves, 25)
    axis["row"] += wavy * np.sin(col / 3.0)
    lines, given = np.zeros(1, LINE), np.zeros((), FIT)
    middle = 10.0 + straight / 2.0
    slope = curvature * middle
    lines["point"] = 0.5 * curvature * middle**2, middle
    lines["direction"] = np.array([slope, 1.0]) / math.hypot(slope, 1.0)
    lines["length"], lines["rms"] = straight, curvature * straight**2 / 26.8
    given["ring"], given["slack"], given["length"] = 4.0, 1.5, 180.0
    _bend(lines[0], axis, 0, np.inf, given[()])
    return lines


def row_at_candidate(lines: StructuredArray) -> float:
    (row, col), (d_row, d_col) = lines["point"][0], lines["direction"][0]
    away = -row * d_row - col * d_col
    return float(row + away * d_row + lines["bend"][0] * away**2 * d_col)


@pytest.mark.parametrize("curvature", [0.0, 0.01, -0.02])
def test_branch_strays_inwards_half_as_far_as_beyond_its_line(curvature: float) -> None:
    axis, line = np.zeros(25, PLACE), np.zeros(1, LINE)
    axis["row"], axis["col"], axis["n"] = 0.5 * curvature * 100.0**2, 160.0, 1.0
    line["point"], line["direction"], line["length"] = (0.0, 60.0), (0.0, 1.0), 80.0
    _stray(line[0], axis)
    np.testing.assert_allclose(line["stray"], (0.25 * curvature) ** 2)


@pytest.mark.parametrize("radius", [200.0, -300.0])
def test_line_bends_with_a_branch_whose_edges_both_do(radius: float) -> None:
    lines = bent(1.0 / radius, [15.0])
    assert lines["length"][0] == 100.0
    assert abs(row_at_candidate(lines)) < 1.5
    np.testing.assert_allclose(lines["bend"], 0.5 / radius, rtol=0.25)
    assert lines["unsure"][0] > 0.0


@pytest.mark.parametrize(
    ("curvature", "halves", "straight", "wavy"),
    [
        (0.0, [15.0], 40.0, 0.0),  # the branch is straight
        (0.005, [8.0, 24.0], 40.0, 0.0),  # its width changes by more than it bends
        (0.0, [15.0], 40.0, 1.0),  # it is ragged
        (0.01, [15.0], 104.0, 0.0),  # its line tells as much of it
    ],
)
def test_line_stays_straight_where_it_is_not_known_to_bend(
    curvature: float, halves: list[float], straight: float, wavy: float
) -> None:
    lines = bent(curvature, halves, straight=straight, wavy=wavy)
    assert lines["bend"][0] == 0.0
    assert lines["length"][0] == straight


def two_arms(bend: float, slope: float, rms: float) -> StructuredArray:
    """Join the lines of two branches that lead to both sides of a candidate at the origin."""
    axes, cols = np.zeros((2, 20), PLACE), 24.0 + 4.0 * np.arange(20)
    lines, given = np.zeros(2, LINE), np.zeros((), FIT)
    axes["row"], axes["col"], axes["n"], axes["half"] = bend * cols**2 + slope * cols, (cols, -cols), 4.0, 15.0
    lines["point"] = [(bend * 62.0**2 + slope * 62.0, col) for col in (62.0, -62.0)]
    lines["direction"] = np.array([(2.0 * bend * 62.0 + slope, col) for col in (1.0, -1.0)])
    lines["direction"] /= np.linalg.norm(lines["direction"], axis=1)[:, None]
    lines["length"], lines["rms"], lines["is_parallel"], given["ring"], given["length"] = 80.0, rms, True, 4.0, 180.0
    _join_roads(lines, axes, _scatters(lines), given[()])
    return lines


def test_branches_of_one_road_that_bends_lie_on_one_curve() -> None:
    lines = two_arms(0.002, 0.0, 0.95)
    assert abs(row_at_candidate(lines)) < 0.1
    np.testing.assert_allclose(lines["direction"], [[0.0, 1.0], [0.0, -1.0]], atol=1e-9)
    np.testing.assert_allclose(lines["bend"], [0.002, -0.002], rtol=0.02)
    assert (two_arms(0.0, 0.2, 0.3)["length"] == 80.0).all()  # two roads that meet at an angle


RAGGED = {"length": [80.0, 20.0, 80.0], "rms": [0.6, 2.0, 0.6]}  # the second of three


@pytest.mark.parametrize(
    ("angles", "shape", "minimum", "maximum"),
    [
        ([0, 70, 180], RAGGED, [0, 80, 180], [0, 90, 180]),  # a ragged stem turns towards the right angle
        ([0, 110, 180], RAGGED, [0, 90, 180], [0, 100, 180]),
        ([0, 250, 180], RAGGED, [0, 260, 180], [0, 270, 180]),
        ([0, 290, 180], RAGGED, [0, 270, 180], [0, 280, 180]),
        ([0, 70, 180], RAGGED | {"length": [80.0, 60.0, 80.0]}, [0, 70, 180], [0, 75, 180]),  # less: more is seen
        ([0, 70, 180], {}, [0, 69.9, 180], [0, 70.1, 180]),  # one that is well known keeps its direction
        (  # so does a branch that leads on straight
            [0, 70, 180, 250],
            {"length": [80, 20, 80, 20], "rms": [0.6, 2.0, 0.6, 2.0]},
            [0, 70, 180, 250],
            [0, 70, 180, 250],
        ),
        ([0, 70], {"length": [80, 20], "rms": [0.6, 2.0]}, [0, 75], [0, 90]),  # the road is not seen farther
        ([350, 70, 200], RAGGED, [350, 85, 200], [350, 95, 200]),  # the road bends: along 5 degrees less 180
        ([0, 70], {"length": 0.0}, [0, 70], [0, 70]),  # no direction is known
        ([], {}, [], []),
    ],
)
def test_ragged_stem_of_a_through_road_is_turned_towards_the_right_angle(
    angles: list[float], shape: dict[str, Any], minimum: list[float], maximum: list[float]
) -> None:
    found = np.array(squared(lines_at(*angles, **shape)))
    assert (found >= np.array(minimum) - 1e-9).all()
    assert (found <= np.array(maximum) + 1e-9).all()


def test_stem_far_from_the_right_angle_keeps_its_direction() -> None:
    shares = [(squared(lines_at(0, angle, 180, **RAGGED))[1] - angle) / (90 - angle) for angle in (70, 60, 46, 44)]
    assert shares[0] > shares[1] > shares[2] > shares[3] == pytest.approx(0)


@given(st.floats(0, 360), st.floats(50, 130), st.floats(2, 60), st.floats(0, 5))
def test_square_stems_do_not_depend_on_how_the_image_lies(turn: float, angle: float, length: float, rms: float) -> None:
    shape = {"length": [80.0, 80.0, length], "rms": [0.6, 0.6, rms]}
    plain = squared(lines_at(0, 180, angle, **shape))[2]
    turned = squared(lines_at(turn, turn + 180, turn + angle, **shape))[2]
    mirrored = squared(lines_at(0, 180, -angle, **shape))[2]
    assert math.remainder(turned - plain - turn, 360) == pytest.approx(0, abs=1e-6)
    assert math.remainder(mirrored + plain, 360) == pytest.approx(0, abs=1e-6)
    assert abs(plain - 90) <= abs(angle - 90) + 1e-6


# --- edges that were not seen ----------------------------------------------------------------------------------------

AXIS = 100.0  # row of the axis of a road from left to right, between rows 90 and 110
AT_EDGES = (80, 90), (111, 121)  # rows in which a sidewalk lies


def road_hidden_from(column: int, rows: int) -> UInt8Array:
    """Draw the road without its uppermost rows from a column on."""
    road = np.zeros((201, 201), np.uint8)
    road[90:111, 5:] = 1
    road[90 : 90 + rows, column:] = 0
    return road


def other_ground(*strips: tuple[int, int]) -> UInt8Array:
    ground = np.zeros((201, 201), np.uint8)
    for first, end in strips:
        ground[first:end] = 1
    return ground


def line_of_road(road: UInt8Array, other: UInt8Array | None, column: float = 20.0) -> StructuredArray:
    """Fit the line of a road that leaves a candidate to the right, or to both sides: then of one of them."""
    surface = binary_image(road)
    thinned = replace(surface, words=surface.words.copy())
    thin(thinned.words)
    line, place = Centerline.of(thinned, surface), np.array((AXIS, column))
    traced, is_main, pieces = trace_branches(
        line.rows, line.cols, line.neighbours, place, np.empty((0, 2)), 10.0, 150.0, 5.0
    )
    given = np.array((*place, 21.0, 10.0, 140.0, 75.0, 0.0, 99.0, RING_PX, SLACK_PX, *ANGLES_RAD), FIT)[()]
    against = NOWHERE if other is None else binary_image(other).words
    return fit_lines(given, line.pixels, traced, is_main, pieces, surface.words, against)[0]


def rows_of(line: StructuredArray) -> list[float]:
    """Return the rows of a line at the candidate and where its road leaves the image."""
    slope = line["direction"][0] / line["direction"][1]
    return [float(line["point"][0] + slope * (column - line["point"][1])) for column in (20, 200)]


def test_branch_that_lies_on_the_line_of_two_begins_beside_the_candidate() -> None:
    joined, alone = (line_of_road(road_hidden_from(0, rows=0), None, column) for column in (100.0, 20.0))
    np.testing.assert_allclose([joined["length"], joined["begin"]], [2 * 72.0, 0.0], atol=10.0)
    assert alone["begin"] < -0.4 * alone["length"]


@pytest.mark.parametrize("upside_down", [False, True])
def test_axis_lies_half_a_width_inside_the_edge_that_was_seen(upside_down: bool) -> None:
    step = -1 if upside_down else 1
    road = road_hidden_from(70, rows=6)[::step].copy()  # by a parked car; the sidewalk behind it was seen
    axis = 200 - AXIS if upside_down else AXIS
    assert max(abs(row - axis) for row in rows_of(line_of_road(road, None))) > 2.0
    np.testing.assert_allclose(rows_of(line_of_road(road, other_ground(*AT_EDGES)[::step].copy())), axis, atol=0.5)


@pytest.mark.parametrize(
    ("column", "rows", "is_narrower"),
    [(110, 6, True), (45, 6, False), (70, 14, False)],
    ids=["the road becomes narrower", "few places show both edges", "half a road is missing"],
)
def test_what_is_not_hidden_is_not_made_up(column: int, rows: int, is_narrower: bool) -> None:
    road, seen = road_hidden_from(column, rows), other_ground(*AT_EDGES)
    if is_narrower:
        seen[90 : 90 + rows, column:] = 1
    np.testing.assert_array_equal(line_of_road(road, seen), line_of_road(road, None))
