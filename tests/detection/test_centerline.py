"""The axis of the road and what of it is kept."""

import numpy as np
import pytest

from interloc.arrays import UInt8Array
from interloc.config import CenterlineConfig
from interloc.detection.centerline import Centerline, extract_centerline
from tests.images import binary_image

ALL = CenterlineConfig(spur_widths=0)
PRUNED = CenterlineConfig(spur_widths=1)


def road_with_driveway(length: int) -> UInt8Array:
    """Draw a road 21 pixels wide across an image, with a driveway 9 pixels wide upwards from its edge."""
    road = np.zeros((200, 200), np.uint8)
    road[90:111, :] = 1
    road[90 - length : 90, 96:105] = 1
    return road


def extract(road: UInt8Array, config: CenterlineConfig) -> Centerline:
    return extract_centerline(binary_image(road), config)


def test_ends_have_one_neighbour_and_junctions_three() -> None:
    line = extract(road_with_driveway(60), ALL)
    (junction,) = np.flatnonzero(line.degrees >= 3)
    assert abs(line.rows[junction] - 100) <= 6
    assert abs(line.cols[junction] - 100) <= 1
    tips = np.flatnonzero(line.degrees == 1)
    assert len(tips) == 3


@pytest.mark.parametrize(("length", "config", "junctions"), [(9, PRUNED, 0), (60, PRUNED, 1), (9, ALL, 1)])
def test_short_driveway_is_dropped_and_long_one_kept(length: int, config: CenterlineConfig, junctions: int) -> None:
    assert np.count_nonzero(extract(road_with_driveway(length), config).degrees >= 3) == junctions


def test_pixels_are_those_of_the_image_after_pruning_too() -> None:
    line = extract(road_with_driveway(9), PRUNED)
    np.testing.assert_array_equal(np.column_stack([line.rows, line.cols]), np.argwhere(line.image.to_array()))
    assert line.neighbours.max() < line.rows.size


def test_occupancy_is_left_as_it_was() -> None:
    occupancy = binary_image(road_with_driveway(9))
    before = occupancy.words.copy()
    line = extract_centerline(occupancy, PRUNED)
    np.testing.assert_array_equal(occupancy.words, before)
    assert line.occupancy is occupancy


def test_no_road_no_line() -> None:
    line = extract(np.zeros((100, 100), np.uint8), PRUNED)
    assert line.rows.size == line.cols.size == line.degrees.size == 0
    assert line.neighbours.shape == (0, 4)
