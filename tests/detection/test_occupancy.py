"""From road cells to road."""

import cv2
import numpy as np
import pytest

from interloc.arrays import UInt8Array
from interloc.config import OccupancyConfig
from interloc.detection.occupancy import infer_occupancy, odd_pixels
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


def test_islands_of_any_shape_are_what_labelling_says() -> None:
    rng = np.random.default_rng(1)
    for size in ((64, 128), (130, 63)):
        road = (rng.random(size) < 0.6).astype(np.uint8)
        _, labels, facts, _ = cv2.connectedComponentsWithStats(1 - road, connectivity=4)
        border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        small = (facts[:, cv2.CC_STAT_AREA] <= 10) & ~np.isin(np.arange(len(facts)), border)
        expected = road | (small[labels] & (road == 0))
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


def test_discs_of_no_size_change_nothing() -> None:
    road = np.random.default_rng(0).integers(0, 2, (70, 70), np.uint8)
    np.testing.assert_array_equal(infer(road, closing_m=0, opening_m=0), road)


def test_input_is_left_as_it_was() -> None:
    bev = binary_image(np.random.default_rng(0).integers(0, 2, (70, 70), np.uint8), 0.1)
    before = bev.words.copy()
    infer_occupancy(bev, OccupancyConfig())
    np.testing.assert_array_equal(bev.words, before)


def test_closing_then_opening_as_opencv_does() -> None:
    bev = (np.random.default_rng(4).random((300, 300)) < 0.15).astype(np.uint8)
    offset = np.arange(-7, 8)
    disc = (4 * (offset[:, None] ** 2 + offset**2) <= 15**2).astype(np.uint8)
    expected = cv2.morphologyEx(cv2.morphologyEx(bev, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
    np.testing.assert_array_equal(infer(bev, closing_m=1.5, opening_m=1.5), expected)
