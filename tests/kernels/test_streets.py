"""The loops along streets, against SciPy and NumPy."""

import numpy as np
from scipy.ndimage import percentile_filter
from scipy.spatial import cKDTree

from interloc.kernels.streets import nearest, ranked, solve_banded


def test_the_nearest_places_within_a_distance() -> None:
    points, others = np.random.default_rng(0).uniform(0, (30, 80), (2, 90, 2))
    distance, row = nearest(points, others, 8.0, 5)
    wanted = cKDTree(others).query(points, k=5, distance_upper_bound=8.0)
    np.testing.assert_array_equal((distance, np.where(np.isfinite(distance), row, 90)), wanted)


def test_quantiles_around_stations() -> None:
    values = np.random.default_rng(0).integers(0, 9, 40).astype(float)
    for size, rank in ((1, 0), (5, 2), (11, 9), (55, 11)):
        wanted = percentile_filter(values, 100 * (rank + 0.5) / size, size, mode="nearest")
        np.testing.assert_array_equal(ranked(values, size, rank), wanted)


def test_a_system_that_links_neighbours() -> None:
    matrix = np.diag(np.arange(5.0, 11.0)) + np.eye(6, k=1) - np.eye(6, k=2)
    bands = np.stack([np.pad(matrix.diagonal(k), (0, k)) for k in range(3)], axis=1)
    wanted = np.linalg.solve(np.triu(matrix) + np.triu(matrix, 1).T, np.ones((6, 2)))
    np.testing.assert_allclose(solve_banded(bands, np.ones((6, 2))), wanted)
