"""Roads from the middle of an image, measured across."""

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.detection.image import BinaryImage
from interloc.detection.lines import LINE
from interloc.detection.occupancy import branch_widths
from tests.images import binary_image

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
