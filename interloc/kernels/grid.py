"""Counting points in cells of a grid anchored in W, and cutting the region of interest out of it.

The grid is made of square tiles of TILE x TILE cells in a pool; a table says which tile of the pool holds which part of
W. Cell (ix, iy) covers x in [ix r, (ix + 1) r) and y in [iy r, (iy + 1) r).
"""

import numpy as np

from interloc.arrays import Float32Array, FloatArray, Int32Array, IntArray, UInt64Array
from interloc.kernels import compiled

TILE = 256
_SHIFT = 8
_MASK = TILE - 1


@compiled
def cells_of(
    points: Float32Array, transform: FloatArray, resolution_m: float, max_range_m: float
) -> tuple[Int32Array, IntArray]:
    """Return the cells of points given in L, and the range of tiles that they fall into.

    Parameters
    ----------
    points : (N, 3) float32
        Metres, in L.
    transform : (4, 4) float64
        T_world_lidar.
    resolution_m : float
        Side of a cell.
    max_range_m : float
        Points farther from the sensor in x or y are left out, and those that are not finite.

    Returns
    -------
    cells : (M, 2) int32
        ix, iy of each point kept.
    tiles : (4,) int64
        First and last tile column, first and last tile row; last < first where no point was kept.
    """
    n = points.shape[0]
    cells = np.empty((n, 2), np.int32)
    scale = 1.0 / resolution_m
    r00, r01, r02, tx = (
        transform[0, 0] * scale,
        transform[0, 1] * scale,
        transform[0, 2] * scale,
        transform[0, 3] * scale,
    )
    r10, r11, r12, ty = (
        transform[1, 0] * scale,
        transform[1, 1] * scale,
        transform[1, 2] * scale,
        transform[1, 3] * scale,
    )
    big = np.int64(1) << 40
    x0, x1, y0, y1 = big, -big, big, -big
    m = 0
    for i in range(n):
        px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        if not (abs(px) <= max_range_m and abs(py) <= max_range_m and abs(pz) < np.inf):  # false for NaN too
            continue
        ix = np.int64(np.floor(r00 * px + r01 * py + r02 * pz + tx))
        iy = np.int64(np.floor(r10 * px + r11 * py + r12 * pz + ty))
        cells[m, 0] = ix
        cells[m, 1] = iy
        x0, x1, y0, y1 = min(x0, ix), max(x1, ix), min(y0, iy), max(y1, iy)
        m += 1
    return cells[:m], np.array([x0 >> _SHIFT, x1 >> _SHIFT, y0 >> _SHIFT, y1 >> _SHIFT])


@compiled
def add_cells(
    pool: Int32Array, table: Int32Array, first_x: int, first_y: int, cells: Int32Array, vote: int
) -> Int32Array:
    """Add a vote to the pool for each cell; return where, for `remove_cells`.

    Parameters
    ----------
    pool : (P, TILE * TILE) int32
    table : (rows, columns) int32
        Slot of the pool of each tile, from tile row ``first_y`` and column ``first_x`` on.
    cells : (M, 2) int32
        ix, iy.
    vote : int
        1 for road, -1 against it.

    Returns
    -------
    (M,) int32
        Flat positions in the pool.
    """
    flat = pool.reshape(-1)
    where = np.empty(cells.shape[0], np.int32)
    tile_x, tile_y = np.int64(first_x) - 1, np.int64(first_y) - 1  # none yet
    start = np.int64(0)
    for i in range(cells.shape[0]):
        ix, iy = np.int64(cells[i, 0]), np.int64(cells[i, 1])
        if ix >> _SHIFT != tile_x or iy >> _SHIFT != tile_y:  # seldom: neighbouring points lie in one tile
            tile_x, tile_y = ix >> _SHIFT, iy >> _SHIFT
            start = np.int64(table[tile_y - first_y, tile_x - first_x]) * TILE * TILE
        k = start + ((iy & _MASK) << _SHIFT) + (ix & _MASK)
        flat[k] += vote
        where[i] = k
    return where


@compiled
def remove_cells(pool: Int32Array, where: Int32Array, vote: int) -> None:
    """Take back the votes that `add_cells` gave."""
    flat = pool.reshape(-1)
    for i in range(where.size):
        flat[where[i]] -= vote


@compiled
def _sum_of_nine(pool: Int32Array, table: Int32Array, tile_x0: int, tile_y0: int, ix: int, iy: int) -> np.int64:
    """Add up a cell and the eight around it, as far as the table goes."""
    total = np.int64(0)
    r, c = iy & _MASK, ix & _MASK
    if 0 < r < _MASK and 0 < c < _MASK:  # all in one tile
        cells = pool[table[(iy >> _SHIFT) - tile_y0, (ix >> _SHIFT) - tile_x0]]
        for middle in range(((r - 1) << _SHIFT) + c, ((r + 2) << _SHIFT) + c, TILE):
            total += cells[middle - 1] + cells[middle] + cells[middle + 1]
        return total
    for y in range(iy - 1, iy + 2):
        row = (y >> _SHIFT) - tile_y0
        if row < 0 or row >= table.shape[0]:
            continue
        inside = (y & _MASK) << _SHIFT
        for x in range(ix - 1, ix + 2):
            column = (x >> _SHIFT) - tile_x0
            if 0 <= column < table.shape[1] and table[row, column] >= 0:
                total += pool[table[row, column], inside + (x & _MASK)]
    return total


@compiled
def lone_road_share(pool: Int32Array, table: Int32Array, left: int, top: int, size: int) -> float:
    """Return the share of road among the cells whose left and right neighbours are not road, 0..1.

    Where labels are right, areas of other ground have next to none; where they err from point to point, road lies there
    one cell at a time. Cells without votes do not count, nor do their neighbours. Every fourth row is enough for a
    share; the first and last column of a tile are left out.

    Parameters
    ----------
    table, left, top, size
        As for `threshold_window`.
    """
    tile_x0 = left >> _SHIFT
    tile_y0 = (top - size + 1) >> _SHIFT
    total = np.int64(0)
    road = np.int64(0)
    for iy in range(top - size + 1, top + 1, 4):
        row = (iy >> _SHIFT) - tile_y0
        inside = (iy & _MASK) << _SHIFT
        for t in range(table.shape[1]):
            slot = table[row, t]
            start = (tile_x0 + t) << _SHIFT
            first = max(left, start)
            last = min(left + size, start + TILE)
            if slot < 0 or first >= last:
                continue
            counts = pool[slot, inside + first - start : inside + last - start]
            before, cells, after = counts[:-2], counts[1:-1], counts[2:]
            n = np.int32(0)
            m = np.int32(0)
            for k in range(cells.size):
                among_others = (before[k] & after[k]) < 0  # both negative
                n += np.int32(among_others & (cells[k] != 0))
                m += np.int32(among_others & (cells[k] > 0))
            total += n
            road += m
    return road / total if total > 0 else 0.0


@compiled
def threshold_window(
    pool: Int32Array,
    table: Int32Array,
    left: int,
    top: int,
    size: int,
    min_points: int,
    neighbour_weight: float,
    words: UInt64Array,
    against: UInt64Array,
) -> None:
    """Write a square of the grid as packed images: where a cell has at least ``min_points``, and where less than none.

    Parameters
    ----------
    table : (rows, columns) int32
        Slots of the tiles from the tile of (left, top - size + 1) on; -1 where there is no tile.
    left, top : int
        ix of the first column; iy of the first row. Rows go down, against +y (paper: R is turned about x).
    neighbour_weight : float
        The sum of the cell and, with this weight, of the eight cells around it must be positive too; 0: the cell alone
        decides.
    words : (size + 2, W) uint64
        Empty packed image.
    against : (size + 2, W) uint64
        Empty packed image, set where votes against road outnumber those for it; without rows it is left out.
    """
    tile_x0 = left >> _SHIFT
    tile_y0 = (top - size + 1) >> _SHIFT
    line = np.empty(words.shape[1] * 64, np.uint8)
    octets = line.view(np.uint64)
    least = np.int32(min_points)
    for r in range(size):
        iy = top - r
        row = (iy >> _SHIFT) - tile_y0
        inside = (iy & _MASK) << _SHIFT
        line[:] = 0
        for t in range(table.shape[1]):
            slot = table[row, t]
            start = (tile_x0 + t) << _SHIFT
            first = max(left, start)
            last = min(left + size, start + TILE)
            if slot < 0 or first >= last:
                continue
            counts = pool[slot, inside + first - start : inside + last - start]
            target = line[first - left : last - left]
            for k in range(target.size):
                target[k] = (counts[k] >= least) + 2 * (counts[k] < 0)  # two bits, for the two images
            if neighbour_weight > 0.0:
                for k in range(target.size):
                    if target[k] == 1:
                        around = _sum_of_nine(pool, table, tile_x0, tile_y0, first + k, iy) - counts[k]
                        target[k] = counts[k] + neighbour_weight * around > 0.0
        for w in range(words.shape[1]):
            words[r + 1, w] = _gather(octets[8 * w : 8 * w + 8], 0)
            if against.shape[0] > 0:
                against[r + 1, w] = _gather(octets[8 * w : 8 * w + 8], 1)


@compiled
def _gather(octets: UInt64Array, bit: int) -> np.uint64:
    """Return one bit of each of 64 bytes as a word."""
    word = np.uint64(0)
    for k in range(8):
        # The product brings the lowest bits of eight bytes together in the highest byte.
        bits = (octets[k] >> np.uint64(bit)) & np.uint64(0x0101010101010101)
        word |= ((bits * np.uint64(0x0102040810204080)) >> np.uint64(56)) << np.uint64(8 * k)
    return word
