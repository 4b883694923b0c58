"""The loops along streets, against SciPy."""

import numpy as np
from scipy.ndimage import percentile_filter
from scipy.spatial import cKDTree

from interloc.kernels.streets import nearest, ranked, solve_banded

RANDOM = np.random.default_rng(0)


def test_the_nearest_places_within_a_distance() -> None:
    points, others = RANDOM.uniform(0, 50, (200, 2)), RANDOM.uniform(0, (30, 80), (90, 2))
    distance, row = nearest(points, others, 8.0, 5)
    wanted = cKDTree(others).query(points, k=5, distance_upper_bound=8.0)
    np.testing.assert_array_equal((distance, np.where(np.isfinite(distance), row, 90)), wanted)


def test_values_around_stations() -> None:
    values = RANDOM.integers(0, 9, 40).astype(float)
    for size, percent in ((1, 50), (5, 50), (11, 85), (55, 20)):
        wanted = percentile_filter(values, percent, size, mode="nearest")
        np.testing.assert_array_equal(ranked(values, size, size * percent // 100), wanted)


def test_a_system_that_links_neighbours() -> None:
    bands, right = RANDOM.uniform((3, -1, -1), (5, 1, 1), (8, 3)), RANDOM.uniform(0, 10, (8, 2))
    upper = sum(np.diag(bands[: 8 - k, k], k) for k in (1, 2))
    wanted = np.linalg.solve(np.diag(bands[:, 0]) + upper + upper.T, right)
    np.testing.assert_allclose(solve_banded(bands, right), wanted)
