"""Images of the region of interest and where they lie in W."""

import numpy as np

from interloc.detection.image import Roi


def test_columns_go_with_x_and_rows_against_y() -> None:
    roi = Roi(left=-10, top=9, size=20, resolution_m=0.5)
    corners = roi.world(np.array([0.0, 0.0, 19.0]), np.array([0.0, 19.0, 0.0]))
    assert corners.tolist() == [[-4.75, 4.75], [4.75, 4.75], [-4.75, -4.75]]


def test_image_undoes_world() -> None:
    roi = Roi(left=-4321, top=77, size=750, resolution_m=0.16)
    positions = np.random.default_rng(2).uniform(0, 749, (50, 2))
    np.testing.assert_allclose(roi.image(roi.world(positions[:, 0], positions[:, 1])), positions, atol=1e-9)
