"""From road cells to road, and how wide it is."""

import cv2
import numpy as np
import pytest

from interloc.arrays import FloatArray, UInt8Array
from interloc.config import OccupancyConfig
from interloc.detection.image import BinaryImage
from interloc.detection.islands import close_islands, place_on_rings
from interloc.detection.lines import LINE
from interloc.detection.occupancy import branch_widths, infer_occupancy, odd_pixels
from interloc.kernels.morphology import fill_islands
from tests.images import binary_image


def infer(image: UInt8Array, **metres: float) -> UInt8Array:
    """Take 10 cm pixels."""
    return infer_occupancy(binary_image(image, 0.1), OccupancyConfig(**metres)).to_array()


@pytest.mark.parametrize(
    ("length_m", "pixels"),
    [(0, 1), (0.1, 1), (0.16, 1), (0.17, 1), (0.33, 3), (0.48, 3), (0.8, 5), (2.4, 15), (4.0, 25), (20, 125)],
)
def test_length_is_the_nearest_odd_number_of_pixels(length_m: float, pixels: int) -> None:
    assert odd_pixels(length_m, 0.16) == pixels


def test_road_reaches_the_border_of_the_window() -> None:
    road = np.zeros((100, 100), np.uint8)
    road[40:60, :] = 1
    np.testing.assert_array_equal(infer(road, closing_m=1.5, opening_m=1.5), road)


@pytest.mark.parametrize("diagonal", [False, True])
def test_islands_of_any_shape_are_what_labelling_says(diagonal: bool) -> None:
    rng = np.random.default_rng(1)
    for size in ((64, 128), (130, 63)):
        road = (rng.random(size) < (0.75 if diagonal else 0.6)).astype(np.uint8)
        _, labels, facts, _ = cv2.connectedComponentsWithStats(1 - road, connectivity=8 if diagonal else 4)
        border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        small = (facts[:, cv2.CC_STAT_AREA] <= 10) & ~np.isin(np.arange(len(facts)), border)
        expected = road | (small[labels] & (road == 0))
        filled = binary_image(road)
        fill_islands(filled.words, *size, 10.0, diagonal)
        np.testing.assert_array_equal(filled.to_array(), expected)
        if not diagonal:
            np.testing.assert_array_equal(infer(road, closing_m=0, opening_m=0, island_m2=0.105), expected)


KERB_PX = 20  # of a road of 8 m, in pixels of 10 cm


def test_road_is_taken_back_to_other_ground_that_was_seen() -> None:
    road, other = np.zeros((140, 200), np.uint8), np.zeros((140, 200), np.uint8)
    road[KERB_PX:100, :] = 1
    other[100:110, :] = 1
    smeared = road.copy()
    smeared[100:106, 50:90] = 1  # labels that wavered for six metres
    bev, against = binary_image(smeared, 0.1), binary_image(other, 0.1)
    config = OccupancyConfig(closing_m=0, opening_m=1.1, edge_m=1.2)
    found = infer_occupancy(bev, config, against).to_array()
    np.testing.assert_array_equal(found[:, 20:-20], road[:, 20:-20])
    assert infer_occupancy(bev, config).to_array()[100:106, 55:85].all()  # where nobody can tell
    assert infer_occupancy(bev, OccupancyConfig(closing_m=0, opening_m=1.1), against).to_array()[100:106, 55:85].all()


def test_lone_other_ground_takes_no_road_and_none_cuts_it() -> None:
    road, other = np.zeros((140, 200), np.uint8), np.zeros((140, 200), np.uint8)
    road[KERB_PX:100, :] = 1
    other[98, ::9] = 1  # errors of single points
    other[:, 100:120] = 1  # and a strip across
    config = OccupancyConfig(closing_m=0, opening_m=1.1, edge_m=1.2)
    found = infer_occupancy(binary_image(road, 0.1), config, binary_image(other, 0.1)).to_array()
    np.testing.assert_array_equal(found[:, 20:80], road[:, 20:80])
    assert found[40:80, :].all()


@pytest.mark.parametrize(("length", "is_road"), [(600, False), (150, True)])
@pytest.mark.parametrize("column", [0, 100])
def test_a_median_is_no_gap_and_a_lay_by_has_one(column: int, length: int, is_road: bool) -> None:
    other = np.zeros((260, 1000), np.uint8)
    other[118:142, column : column + length] = 1  # 2.4 m: the closing would fill it; it may reach the border
    road = 1 - other
    road[118:142, 760:] = 0  # beyond a crossing less is seen
    other[118:142, 760:] = np.arange(240) % 24 < 12
    road[[0, -1]] = 0
    config = OccupancyConfig(closing_m=4.0, opening_m=2.4, island_m2=5.0, edge_m=0.8)
    found = infer_occupancy(binary_image(road, 0.1), config, binary_image(other, 0.1)).to_array()
    assert (found[125:135, column + 30 : column + length - 30] == is_road).all()
    assert (found[125:135, 790:970] == is_road).all()
    assert found[20:100, 20:-20].all()


def island(is_round: bool) -> UInt8Array:
    """Draw an island of 40 to 50 m2, in pixels of 10 cm."""
    image, triangle = np.zeros((400, 400), np.uint8), np.array([[170, 160], [270, 160], [170, 260]])
    return cv2.circle(image, (200, 200), 36, 1, -1) if is_round else cv2.fillPoly(image, [triangle], 1)


@pytest.mark.parametrize(
    ("is_round", "is_seen", "limit_m2", "stays"),
    [(False, True, 80.0, True), (True, True, 80.0, False), (True, True, 38.0, True), (False, False, 80.0, False)],
)
def test_an_island_stays_where_it_was_seen(is_round: bool, is_seen: bool, limit_m2: float, stays: bool) -> None:
    gap = island(is_round)
    seen = cv2.circle(gap * is_seen, (198, 190), 22, 0, -1)  # but for its middle, 15 m2
    road = binary_image(1 - cv2.erode(gap, np.ones((7, 7))), 0.1)  # the closing took the rest
    close_islands(road, binary_image(seen).words, limit_m2)
    np.testing.assert_array_equal(road.to_array(), 1 - gap * stays)


def test_roads_meet_on_the_axis_of_a_ring() -> None:
    road = np.zeros((400, 400), np.uint8)
    for arm in (400, 200), (90, 390), (90, 10):
        cv2.line(road, (200, 200), arm, 1, 60)
    cv2.circle(cv2.circle(road, (200, 200), 140, 1, -1), (200, 200), 80, 0, -1)  # axis at 11 m
    found = place_on_rings(np.array([[200.0, 325.0], [200.0, 345.0]]), binary_image(road, 0.1))
    np.testing.assert_allclose(found, [[200.0, 310.0], [200.0, 345.0]], atol=1.0)  # the other one lies beyond it


def test_discs_of_no_size_change_nothing() -> None:
    road = np.random.default_rng(0).integers(0, 2, (70, 70), np.uint8)
    np.testing.assert_array_equal(infer(road, closing_m=0, opening_m=0), road)


def test_input_is_left_as_it_was() -> None:
    bev = binary_image(np.random.default_rng(0).integers(0, 2, (70, 70), np.uint8), 0.1)
    before = bev.words.copy()
    infer_occupancy(bev, OccupancyConfig())
    np.testing.assert_array_equal(bev.words, before)


RESOLUTION_M = 0.16
MIDDLE = np.array([200.0, 200.0])
ROWS, COLS = np.mgrid[:401, :401]


def ray(angle_deg: float) -> FloatArray:
    """Row and column of a direction, counter-clockwise from the columns."""
    return np.array([-np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))])


def widths_of(roads: dict[float, float], branches: tuple[float, ...]) -> FloatArray:
    """Draw roads of some angles and widths, and measure branches of some angles."""
    image = np.zeros(ROWS.shape, np.uint8)
    for angle_deg, width_m in roads.items():
        dr, dc = ray(angle_deg)
        along, across = (ROWS - 200) * dr + (COLS - 200) * dc, (ROWS - 200) * dc - (COLS - 200) * dr
        image |= ((along >= 0) & (np.abs(across) * RESOLUTION_M <= width_m / 2)).astype(np.uint8)
    lines = np.zeros(len(branches), LINE)
    lines["direction"] = [ray(angle_deg) for angle_deg in branches]
    return branch_widths(MIDDLE, lines, binary_image(image, RESOLUTION_M))


@pytest.mark.parametrize("angle_deg", [30, 45, 90, 140])
def test_the_road_of_the_next_branch_does_not_count(angle_deg: float) -> None:
    roads = {0: 8.0, angle_deg: 6.0, 200: 10.0}
    assert widths_of(roads, tuple(roads)) == pytest.approx(list(roads.values()), abs=0.3)


def test_where_roads_have_not_parted_yet_no_width_is_said() -> None:
    widths = widths_of({0: 8.0, 15: 8.0, 180: 8.0}, (0, 15, 180))
    assert np.isnan(widths[:2]).all()
    assert widths[2] == pytest.approx(8.0, abs=0.3)


def test_branches_side_by_side_share_a_road() -> None:
    assert widths_of({0: 8.0, 180: 8.0}, (0, 5, 180)) == pytest.approx(8.0, abs=0.3)


def test_no_branches_have_no_widths() -> None:
    assert branch_widths(MIDDLE, np.zeros(0, LINE), BinaryImage.empty(401, 401, RESOLUTION_M)).shape == (0,)
