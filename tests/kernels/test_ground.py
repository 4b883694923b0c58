"""The kernels that find the ground of a scan, against plain twins."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import Float32Array, FloatArray, IntArray, UInt8Array
from interloc.drives.scans.raw import select_plainly
from interloc.kernels import ground

NEAR_M, FAR_M, CONE, ABOVE_M, CELL_M, REACH, STIFFNESS_M = 2.0, 20.0, (0.3, 0.05), 0.4, 0.2, 2, 0.15
T = np.eye(3, 4)
T[2, 3] = 1.7


def scattered(count: int, seed: int = 0) -> Float32Array:
    generator = np.random.default_rng(seed)
    x, y = generator.uniform(-8, 8, (2, count))
    z = -1.7 + 0.05 * x + generator.normal(0, 0.2, count)
    points = np.column_stack([x, y, z, generator.uniform(0, 1, count)]).astype(np.float32)
    points[::50, 2] = np.nan
    points[::70, 3] = np.nan
    return points


def test_lowest_points_are_those_of_a_plain_search() -> None:
    points = scattered(2000)
    squared = points[:, 0] ** 2 + points[:, 1] ** 2
    usable = points[(squared >= 9) & (squared < 36) & np.isfinite(points[:, 2])]
    cells = np.floor((usable[:, 1::-1] + np.float32(6.0)) / 1.0).astype(int)
    expected = []
    for cell in np.unique(cells, axis=0):
        here = usable[(cells == cell).all(axis=1)]
        expected.append(here[here[:, 2].argmin(), :3])
    np.testing.assert_allclose(ground.lowest_points(points, 3.0, 6.0, 1.0), np.array(expected))


def test_best_plane_is_that_of_a_plain_search() -> None:
    points = scattered(300)[:, :3].astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    points[:250, 2] = -1.7 + 0.05 * points[:250, 0]
    triples = np.random.default_rng(1).integers(len(points), size=(60, 3))
    found = ground.best_plane(points, triples, 0.1, np.cos(0.6))
    np.testing.assert_allclose(found, plain_best_plane(points, triples, 0.1, np.cos(0.6)))
    np.testing.assert_allclose(found[3], 1.7, atol=0.01)


def plain_best_plane(points: FloatArray, triples: IntArray, near_m: float, min_up: float) -> FloatArray:
    best, maximum = np.zeros(4), 0
    for a, b, c in points[triples]:
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1.0 or abs(normal[2]) < min_up * length:
            continue
        normal *= np.sign(normal[2]) / length
        height = -normal @ a
        count = np.count_nonzero(np.abs(points @ normal + height) < near_m)
        if height >= near_m and count > maximum:
            best, maximum = np.append(normal, height), count
    return best


def test_no_plane_is_found_among_walls_or_above_the_sensor() -> None:
    wall = np.array([[5, 0, 0], [5, 3, 0], [5, 0, 3], [5, 3, 3]], np.float64)
    ceiling = np.array([[5, 0, 2], [5, 3, 2], [9, 0, 2], [9, 3, 2]], np.float64)
    triples = np.array([[0, 1, 2], [1, 2, 3]])
    assert not ground.best_plane(wall, triples, 0.1, 0.7).any()
    assert not ground.best_plane(ceiling, triples, 0.1, 0.7).any()


def test_ground_cells_are_those_of_a_plain_search() -> None:
    points = scattered(6000, seed=2)
    np.testing.assert_allclose(ground_cells(points), plain_ground_cells(points), rtol=2e-4, atol=2e-5)


def ground_cells(points: Float32Array) -> Float32Array:
    return ground.ground_cells(points, T, NEAR_M, FAR_M, CONE, ABOVE_M, CELL_M, REACH, STIFFNESS_M)


def plain_ground_cells(points: Float32Array) -> FloatArray:
    xyz = points[:, :3] @ T[:, :3].T + T[:, 3]
    distance = np.hypot(xyz[:, 0], xyz[:, 1])
    kept = (distance >= NEAR_M) & (distance < FAR_M) & (np.abs(xyz[:, 2]) < CONE[0] + CONE[1] * distance)
    points, xyz = points[kept], xyz[kept]
    coarse = np.floor((xyz[:, :2] + FAR_M) / 0.5).astype(int)
    lowest = {tuple(cell): xyz[(coarse == cell).all(axis=1), 2].min() for cell in coarse}
    kept = xyz[:, 2] <= np.array([lowest[tuple(cell)] for cell in coarse]) + ABOVE_M
    points, xyz = points[kept], xyz[kept]
    beam = np.floor((np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])) + np.pi / 2) / ground.BEAM_RAD)
    cells = np.floor((xyz[:, :2] + FAR_M) / CELL_M).astype(int)
    rows = []
    for cell in dict.fromkeys(map(tuple, cells.tolist())):
        here = (cells == cell).all(axis=1)
        first = beam[here][0]
        around = xyz[(np.abs(cells - cell) <= REACH).all(axis=1)]
        rough = slope = np.nan
        if len(around) >= 5:
            centred = around - around.mean(axis=0)
            covariance = centred.T @ centred / len(around)
            tilt = np.linalg.solve(covariance[:2, :2] + STIFFNESS_M**2 * np.eye(2), covariance[:2, 2])
            rough, slope = np.sqrt(((centred[:, 2] - centred[:, :2] @ tilt) ** 2).mean()), np.linalg.norm(tilt)
        remission = np.nan_to_num(points[here & (beam == first), 3]).mean()
        rows.append([*xyz[here].mean(axis=0), here.sum(), remission, first, rough, slope])
    return np.array(rows)


def test_a_kerb_is_rougher_than_the_road_beside_it() -> None:
    x, y = (each.ravel() for each in np.meshgrid(np.arange(5, 8, 0.07), np.arange(-3, 3, 0.07)))
    points = np.column_stack([x, y, np.where(y > 1.0, 0.1, 0.0) - 1.7, np.full_like(x, 0.2)]).astype(np.float32)
    cells = ground_cells(points)
    at_kerb, on_road = np.abs(cells[:, 1] - 1.0) < 0.2, cells[:, 1] < 0.2
    assert cells[at_kerb, ground.ROUGHNESS].min() > 0.02
    assert cells[on_road, ground.ROUGHNESS].max() < 1e-4
    assert cells[on_road, ground.SLOPE].max() < 1e-4
    assert cells[:, ground.COUNT].sum() == len(points)
    assert cells[:, ground.REMISSION] == pytest.approx(0.2)
    assert (cells[:, ground.BEAM] < 360).all()  # below the horizon


both = pytest.mark.parametrize("select", [ground.select_points, select_plainly])


def groups(first: set[int], second: set[int]) -> UInt8Array:
    table = np.zeros(65536, np.uint8)
    table[sorted(second)] = 2
    table[sorted(first)] = 1
    return table


@both
def test_first_bad_point_among_the_kept_is_reported(select: Callable) -> None:
    points = np.ones((4, 4), np.float32)
    points[0, 0] = np.nan  # not kept
    points[2, 1] = np.inf
    points[3, 2] = np.nan
    labels = np.array([70, 40, 48, 40], np.uint32)
    assert select(points, labels, groups({40}, {48}))[2] == 2


@both
def test_remission_may_be_anything(select: Callable) -> None:
    points = np.ones((1, 4), np.float32)
    points[0, 3] = np.nan
    assert select(points, np.array([40], np.uint32), groups({40}, set()))[2] == -1


@given(
    st.lists(st.integers(0, 2**32 - 1) | st.sampled_from([40, 48, 60, 65535]), max_size=50), st.integers(0, 2**32 - 1)
)
@settings(deadline=None)  # the first call compiles
def test_equals_the_plain_twin(ids: list[int], seed: int) -> None:
    labels = np.array(ids, np.uint32)
    points = np.random.default_rng(seed).normal(size=(len(ids), 4)).astype(np.float32)
    table = groups({40, 60, 65535}, {48})
    xyz, road, bad = ground.select_points(points, labels, table)
    expected, *counts = select_plainly(points, labels, table)
    np.testing.assert_array_equal(xyz, expected)
    assert [road, bad] == counts
