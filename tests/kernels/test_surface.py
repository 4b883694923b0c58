"""The kernels that lay scans on one grid, against plain twins."""

import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray
from interloc.geometry import rotation_from_rpy
from interloc.kernels.surface import FEATURES, add_brightness, add_features, label_points, scan_minima, tilt_against

X0, Y0, CELL_M, TIMES = -6.0, -4.2, 0.2, 3
ROWS, COLUMNS = 42, 60


def placement() -> FloatArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_from_rpy(0.01, -0.02, 0.4), (0.5, -0.3, 0.1)
    return T[:3]


def cells_of_scan(count: int = 1500) -> Float32Array:
    generator = np.random.default_rng(0)
    x, y = generator.uniform(-7, 7, (2, count))
    columns = [x, y, generator.normal(0, 0.1, count), generator.integers(1, 5, count)]
    columns += [generator.uniform(0, 1, count), generator.integers(0, 6, count), *generator.uniform(0, 0.1, (2, count))]
    cells = np.column_stack(columns).astype(np.float32)
    cells[::9, 6:] = np.nan
    return cells


def places(
    points: Float32Array, T: FloatArray, cell_m: float, shape: tuple[int, int]
) -> tuple[FloatArray, IntArray, BoolArray]:
    xyz = points[:, :3].astype(np.float64) @ T[:, :3].T + T[:, 3]
    at = np.floor((xyz[:, 1::-1] - (Y0, X0)) / cell_m)
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    return xyz, np.where(inside[:, None], at, 0).astype(int), inside


def rough_surface() -> Float32Array:
    surface = np.random.default_rng(1).normal(0.1, 0.05, (ROWS // TIMES, COLUMNS // TIMES)).astype(np.float32)
    surface[2:4, 3:6] = np.nan
    return surface


def test_minima_are_those_of_a_plain_loop() -> None:
    cells, T, shape = cells_of_scan(), placement(), (14, 20)
    lowest = np.empty(shape, np.float32)
    scan_minima(cells, T, X0, Y0, CELL_M * TIMES, lowest)
    expected = np.full(shape, np.inf)
    xyz, at, inside = places(cells, T, CELL_M * TIMES, shape)
    np.minimum.at(expected, tuple(at[inside].T), xyz[inside, 2])
    np.testing.assert_allclose(lowest, expected, rtol=1e-6)


def test_a_tilted_scan_is_laid_on_the_surface() -> None:
    generator = np.random.default_rng(3)
    points = np.column_stack([*generator.uniform(-20, 20, (2, 4000)), np.zeros(4000)]).astype(np.float32)
    points[:600, 2] = 1.5  # what is no ground
    surface = np.zeros((80, 80), np.float32)
    T = np.eye(4)[:3]
    T[:3, :3], T[2, 3] = rotation_from_rpy(0.01, -0.02, 0.0), 0.15
    raised, along_x, along_y = tilt_against(
        points, T, surface, -24.0, -24.0, 0.6, np.array([0.3, 0.2, 0.1, 0.1]), (0.3, 0.02)
    )
    np.testing.assert_allclose([raised, along_x, along_y], [-0.15, -0.02, -0.01], atol=2e-3)


def test_a_scan_that_sees_no_surface_stays_where_it_is() -> None:
    surface = np.full((14, 20), np.nan, np.float32)
    found = tilt_against(cells_of_scan(), placement(), surface, X0, Y0, 0.6, np.array([0.3]), (0.3, 0.02))
    np.testing.assert_array_equal(found, 0.0)


def test_brightness_is_summed_as_by_a_plain_loop() -> None:
    cells, T, shape = cells_of_scan(), placement(), (ROWS, COLUMNS)
    strip = np.random.default_rng(2).uniform(size=shape) < 0.5
    table = np.zeros((6, 3))
    add_brightness(cells, T, X0, Y0, CELL_M, strip, table)
    _, at, inside = places(cells, T, CELL_M, shape)
    driven = inside & strip[tuple(at.T)]
    for beam in range(6):
        values = cells[driven & (cells[:, 5] == beam), 4].astype(np.float64)
        np.testing.assert_allclose(table[beam], [len(values), values.sum(), (values**2).sum()])


def test_features_are_summed_as_by_a_plain_loop() -> None:
    cells, T, surface, shape = cells_of_scan(), placement(), rough_surface(), (ROWS, COLUMNS)
    brightness = np.random.default_rng(4).uniform(0.5, 1.0, (6, 3))
    sums = np.zeros((*shape, FEATURES), np.float32)
    add_features(cells, T, X0, Y0, CELL_M, surface, 0.3, brightness, sums)
    expected = np.zeros((*shape, FEATURES))
    xyz, at, inside = places(cells, T, CELL_M, shape)
    for (x, y, z), (r, c), cell in zip(xyz[inside], at[inside], cells[inside].astype(np.float64), strict=True):
        if not abs(z - surface[r // TIMES, c // TIMES]) < 0.3:
            continue
        weight = min(2.0, cell[3]) / (1 + ((x - T[0, 3]) ** 2 + (y - T[1, 3]) ** 2) / 400)
        minus, over, plus = brightness[int(cell[5])]
        added = weight * np.array([1, (cell[4] - minus) / over + plus, z, 1, cell[6], cell[7]])
        expected[r, c] += added if np.isfinite(cell[6]) else np.append(added[:3], [0, 0, 0])
    np.testing.assert_allclose(sums, expected, rtol=1e-4, atol=1e-5)


def test_labels_are_those_of_a_plain_loop() -> None:
    points, T, surface = cells_of_scan()[:, :4], placement(), rough_surface()
    points[:3] = np.nan
    classes = np.random.default_rng(5).choice(np.array([40, 48], np.uint8), (ROWS, COLUMNS))
    labels = label_points(points, T, X0, Y0, CELL_M, surface, classes, 40, (0.1, 0.2), (1.0, 5.0))
    xyz, at, inside = places(np.nan_to_num(points, nan=99.0), T, CELL_M, (ROWS, COLUMNS))
    distance = np.hypot(*(xyz[:, :2] - T[:2, 3]).T)
    off = np.abs(xyz[:, 2] - surface[tuple(at.T // TIMES)]) / (1 + distance / 40)
    found = classes[tuple(at.T)]
    near = inside & (distance >= 1) & (distance < 5) & (off < np.where(found == 40, 0.1, 0.2))
    np.testing.assert_array_equal(labels, np.where(near, found, 0))
