"""Images of the region of interest and where they lie in W."""

from __future__ import annotations

import numpy as np
import pytest

from interloc.detection.image import Roi
from tests.images import binary_image


@pytest.mark.parametrize("shape", [(1, 1), (3, 63), (2, 64), (5, 65), (7, 750)])
def test_array_survives_packing(shape: tuple[int, int]) -> None:
    array = np.random.default_rng(1).integers(0, 2, shape, np.uint8)
    image = binary_image(array)
    assert (image.height, image.width) == shape
    np.testing.assert_array_equal(image.to_array(), array)
    np.testing.assert_array_equal(np.column_stack(image.pixels()), np.argwhere(array))


def test_array_need_not_be_contiguous_or_binary() -> None:
    array = np.array([[0, 9, 0], [255, 0, 0]], np.uint8)
    np.testing.assert_array_equal(binary_image(array.T).to_array(), [[0, 1], [1, 0], [0, 0]])
    np.testing.assert_array_equal(binary_image(array > 0).to_array(), [[0, 1, 0], [1, 0, 0]])


def test_columns_go_with_x_and_rows_against_y() -> None:
    roi = Roi(left=-10, top=9, size=20, resolution_m=0.5)
    corners = roi.world(np.array([0.0, 0.0, 19.0]), np.array([0.0, 19.0, 0.0]))
    assert corners.tolist() == [[-4.75, 4.75], [4.75, 4.75], [-4.75, -4.75]]


def test_image_undoes_world() -> None:
    roi = Roi(left=-4321, top=77, size=750, resolution_m=0.16)
    positions = np.random.default_rng(2).uniform(0, 749, (50, 2))
    np.testing.assert_allclose(roi.image(roi.world(positions[:, 0], positions[:, 1])), positions, atol=1e-9)
