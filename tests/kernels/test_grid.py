"""Points in tiles: their cells and votes. Counts over whole drives: tests/detection/test_accumulation."""

import numpy as np
import pytest

from interloc.arrays import Int32Array, UInt64Array
from interloc.detection.image import BinaryImage
from interloc.kernels import grid
from interloc.kernels.grid import TILE
from tests.small_drives import level_poses

FIRST = -3  # the tile column and row where the pool of these tests begins
SIDE = 6  # tiles a side
EDGE = FIRST * TILE


def counts_of(pool: Int32Array, table: Int32Array) -> Int32Array:
    """Put the tiles of a pool side by side."""
    return np.block([[pool[slot].reshape(TILE, TILE) for slot in row] for row in table])


def shuffled_tiles(seed: int) -> tuple[Int32Array, Int32Array]:
    """Return an empty pool and a table that names its slots in no order."""
    slots = np.random.default_rng(seed).permutation(SIDE * SIDE).astype(np.int32)
    return np.zeros((SIDE * SIDE, TILE * TILE), np.int32), slots.reshape(SIDE, SIDE)


def window_of(table: Int32Array, left: int, top: int, size: int) -> Int32Array:
    """Return the part of a table that a window of cells touches."""
    columns = slice(left // TILE - FIRST, (left + size - 1) // TILE - FIRST + 1)
    return table[(top - size + 1) // TILE - FIRST : top // TILE - FIRST + 1, columns].copy()


def counts_in(counts: Int32Array, left: int, top: int, size: int) -> Int32Array:
    """Return the counts of the cells of a window, rows upwards."""
    return counts[top - size + 1 - EDGE : top + 1 - EDGE, left - EDGE : left + size - EDGE]


def test_cell_covers_from_its_lower_edge_to_the_next() -> None:
    points = np.array([[0, 0, 0], [0.49, 0.5, 0], [-0.01, -0.5, 0], [-0.51, 1.99, 0]], np.float32)
    cells, _ = grid.cells_of(points, np.eye(4), 0.5, 100.0)
    assert cells.tolist() == [[0, 0], [0, 1], [-1, -1], [-2, 3]]


def test_cells_are_those_of_the_points_in_the_world() -> None:
    points = np.random.default_rng(0).uniform(-60, 60, (5000, 3)).astype(np.float32)
    T = level_poses(-812.3, 455.1, 2.2)
    T[:3, :3] = T[:3, :3] @ np.array([[1, 0, 0], [0, np.cos(0.05), -np.sin(0.05)], [0, np.sin(0.05), np.cos(0.05)]])
    cells, tiles = grid.cells_of(points, T, 0.16, 150.0)
    world = points.astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_array_equal(cells, np.floor(world[:, :2] / 0.16))
    low, high = cells.min(axis=0) // TILE, cells.max(axis=0) // TILE
    assert tiles.tolist() == [low[0], high[0], low[1], high[1]]


def test_far_points_are_left_out() -> None:
    points = np.array([[1, 0, 0], [11, 0, 0], [0, -11, 0], [0, 0, 11], [-9, 9, 0]], np.float32)
    cells, _ = grid.cells_of(points, level_poses(100, 0), 1.0, 10.0)
    assert cells.tolist() == [[101, 0], [91, 9]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_points_that_are_not_finite_are_left_out(bad: float, axis: int) -> None:
    points = np.ones((3, 3), np.float32)
    points[1, axis] = bad
    cells, tiles = grid.cells_of(points, np.eye(4), 0.5, 100.0)
    assert cells.tolist() == [[2, 2], [2, 2]]
    assert tiles.tolist() == [0, 0, 0, 0]


def test_scan_without_points_falls_into_no_tile() -> None:
    cells, tiles = grid.cells_of(np.empty((0, 3), np.float32), np.eye(4), 0.16, 150.0)
    assert cells.shape == (0, 2)
    assert tiles[1] < tiles[0]
    assert tiles[3] < tiles[2]


def test_points_that_follow_each_other_in_a_cell_have_one_place() -> None:
    cells = np.array([[0, 0], [0, 0], [1, 0], [0, 0], [TILE, 2], [TILE, 2]], np.int32)
    places = grid.places_of(np.array([[5, 3]], np.int32), 0, 0, cells)
    assert places.tolist() == [[5 * TILE**2, 2], [5 * TILE**2 + 1, 3], [5 * TILE**2, 4], [3 * TILE**2 + 2 * TILE, 6]]
    assert grid.places_of(np.array([[5, 3]], np.int32), 0, 0, cells[:0]).shape == (0, 2)


def images_of(pool: Int32Array, minimum: int) -> tuple[UInt64Array, UInt64Array]:
    """Return the packed images of all tiles, from their counts."""
    packed = (np.packbits(each, axis=1, bitorder="little").view(np.uint64) for each in (pool >= minimum, pool < 0))
    return next(packed), next(packed)


@pytest.mark.parametrize("minimum", [1, 3])
def test_images_of_the_tiles_follow_the_votes(minimum: int) -> None:
    rng = np.random.default_rng(minimum)
    pool, _ = shuffled_tiles(0)
    tiles = pool, *images_of(pool, minimum)
    cast = [np.column_stack([rng.integers(0, 300, 2000), rng.integers(1, 4, 2000).cumsum()]) for _ in range(4)]
    cast = [places.astype(np.int32) for places in cast]
    for places, vote in [*((each, 1) for each in cast[:3]), (cast[3], -1), *((each, -1) for each in cast[:3])]:
        grid.cast_votes(*tiles, places, vote, minimum)
        for image, expected in zip(tiles[1:], images_of(pool, minimum), strict=True):
            np.testing.assert_array_equal(image, expected)
    grid.cast_votes(*tiles, cast[3], 1, minimum)
    assert not any(each.any() for each in tiles)


def test_road_is_marked_anew_where_other_counts_are_enough() -> None:
    pool, _ = shuffled_tiles(0)
    pool[:] = np.random.default_rng(0).integers(-2, 5, pool.shape)
    road, _ = images_of(pool, 1)
    grid.mark_road(pool, road, 3)
    np.testing.assert_array_equal(road, images_of(pool, 3)[0])


@pytest.mark.parametrize(("left", "top", "size"), [(0, 400, 300), (-300, 37, 64), (EDGE + 5, EDGE + 700, 257)])
def test_window_is_a_slice_of_the_tiles(left: int, top: int, size: int) -> None:
    pool, table = shuffled_tiles(0)
    pool[:] = np.random.default_rng(0).integers(-2, 3, pool.shape)
    window = window_of(table, left, top, size)
    counts = counts_in(counts_of(pool, table), left, top, size)[::-1]
    for tiles, expected in zip(images_of(pool, 1), (counts >= 1, counts < 0), strict=True):
        image = BinaryImage.empty(size, size, 1.0)
        grid.cut_window(tiles, window, left, top, size, image.words)
        np.testing.assert_array_equal(image.to_array(), expected)
        assert not image.words[[0, -1]].any()
        assert image.words[1:-1, -1].max() < 2 ** (size % 64)


def test_votes_are_pooled_across_tiles() -> None:
    pool = np.zeros((2, TILE * TILE), np.int32)
    table = np.array([[0, 1]], np.int32)
    for ix, votes in ((TILE - 1, 1), (TILE, -1), (TILE + 4, 2), (TILE + 5, -1)):
        pool[ix // TILE, 10 * TILE + ix % TILE] = votes
    image = BinaryImage.empty(20, 20, 1.0)
    grid.cut_window(images_of(pool, 1)[0], table, TILE - 10, 19, 20, image.words)
    np.testing.assert_array_equal(np.argwhere(image.to_array()), [[9, 9], [9, 14]])
    grid.drop_outvoted(pool, table, TILE - 10, 19, 1.0, image.words)
    np.testing.assert_array_equal(np.argwhere(image.to_array()), [[9, 14]])


@pytest.mark.parametrize(("left", "top"), [(0, 400), (-300, 37), (EDGE + 5, EDGE + SIDE * TILE - 1)])
def test_share_of_lone_road_is_that_of_the_plain_twin(left: int, top: int) -> None:
    pool, table = shuffled_tiles(0)
    pool[:] = np.random.default_rng(0).integers(-2, 2, pool.shape)
    size = 300
    window = window_of(table, left, top, size)
    counts = counts_in(counts_of(pool, table), left, top, size)[::4]
    inner = np.isin(np.arange(left + 1, left + size - 1) % TILE, (0, TILE - 1), invert=True)
    between = (counts[:, :-2] < 0) & (counts[:, 2:] < 0) & (counts[:, 1:-1] != 0) & inner
    share = (counts[:, 1:-1] > 0)[between].mean()
    assert grid.lone_road_share(pool, window, left, top, size) == pytest.approx(share)
    assert grid.lone_road_share(np.abs(pool), window, left, top, size) == 0
