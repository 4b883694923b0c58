"""Counting points in cells of a grid anchored in W, and cutting the region of interest out of it.

The grid is made of square tiles of TILE x TILE cells in a pool; a table says which tile of the pool holds which part of
W. Cell (ix, iy) covers x in [ix r, (ix + 1) r) and y in [iy r, (iy + 1) r).
"""

import numpy as np

from interloc.arrays import Float32Array, FloatArray, Int32Array, IntArray, UInt64Array
from interloc.kernels import compiled
from interloc.kernels.bits import lowest_bit

TILE = 256
_SHIFT = 8
_MASK = TILE - 1
_WORD_SHIFT = 2  # of the words of a row of a tile
_WORD_MASK = TILE // 64 - 1


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
        Points farther from the sensor in x, y or z are left out, and those that are not finite.

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
    r00, r01, r02, tx = scale * transform[0]
    r10, r11, r12, ty = scale * transform[1]
    m = 0
    for i in range(n):
        px, py, pz = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        cells[m, 0] = np.int32(np.floor(r00 * px + r01 * py + r02 * pz + tx))
        cells[m, 1] = np.int32(np.floor(r10 * px + r11 * py + r12 * pz + ty))
        # Without a branch: one that is left out is overwritten by the next. False for NaN, too.
        m += int((abs(px) <= max_range_m) & (abs(py) <= max_range_m) & (abs(pz) <= max_range_m))
    big = np.int32(2**31 - 1)
    x0, x1, y0, y1 = big, -big, big, -big
    for i in range(m):  # apart from the other loop: several at once
        x0, x1, y0, y1 = min(x0, cells[i, 0]), max(x1, cells[i, 0]), min(y0, cells[i, 1]), max(y1, cells[i, 1])
    return cells[:m], np.array([x0 >> _SHIFT, x1 >> _SHIFT, y0 >> _SHIFT, y1 >> _SHIFT], np.int64)


@compiled
def places_of(table: Int32Array, first_x: int, first_y: int, cells: Int32Array) -> Int32Array:
    """Return where cells are in the pool; those that follow each other in one cell, as neighbouring points do, once.

    Parameters
    ----------
    table : (rows, columns) int32
        Slot of the pool of each tile, from tile row ``first_y`` and column ``first_x`` on.
    cells : (M, 2) int32
        ix, iy.

    Returns
    -------
    (K, 2) int32
        Flat position, and how many of the cells lie there or came before.
    """
    places, k = np.empty((cells.shape[0] + 1, 2), np.int32), np.uint64(0)
    tile_x, tile_y = np.int64(first_x) - 1, np.int64(first_y) - 1  # none yet
    start, last_x, last_y = np.int64(0), np.int64(1) << 32, np.int64(0)  # no cell
    for i in range(cells.shape[0]):
        ix, iy = np.int64(cells[i, 0]), np.int64(cells[i, 1])
        is_same = (ix == last_x) & (iy == last_y)
        last_x, last_y = ix, iy
        if is_same:
            continue
        if ix >> _SHIFT != tile_x or iy >> _SHIFT != tile_y:  # seldom: neighbouring points lie in one tile
            tile_x, tile_y = ix >> _SHIFT, iy >> _SHIFT
            start = np.int64(table[tile_y - first_y, tile_x - first_x]) * TILE * TILE
        places[k, 1] = i
        k += np.uint64(1)
        places[k, 0] = start + ((iy & _MASK) << _SHIFT) + (ix & _MASK)
    places[k, 1] = cells.shape[0]
    return places[1 : np.int64(k) + 1].copy()


@compiled
def cast_votes(
    pool: Int32Array, road: UInt64Array, other: UInt64Array, places: Int32Array, vote: int, minimum: int
) -> None:
    """Add the votes of points to cells of the pool, and to the packed images of its tiles what that changes.

    Parameters
    ----------
    pool : (P, TILE * TILE) int32
    road, other : (P, TILE * TILE / 64) uint64
        One bit per cell: where it has at least ``minimum`` votes, and where less than none.
    places : (K, 2) int32
        From `places_of`.
    vote : int
        Of each point: 1 or -1, which takes back what 1 gave.
    """
    counts, enough, negative = pool.reshape(-1), road.reshape(-1), other.reshape(-1)
    cast = np.int32(0)
    for i in range(places.shape[0]):
        k = np.uint64(places[i, 0])  # no place is counted from the end, which need not be looked at then
        before = counts[k]
        after = before + vote * (places[i, 1] - cast)
        cast = places[i, 1]
        counts[k] = after
        if (before >= minimum) != (after >= minimum):
            enough[k >> np.uint64(6)] ^= np.uint64(1) << (k & np.uint64(63))
        if (before < 0) != (after < 0):
            negative[k >> np.uint64(6)] ^= np.uint64(1) << (k & np.uint64(63))


@compiled
def mark_road(pool: Int32Array, road: UInt64Array, minimum: int) -> None:
    """Write the packed images of all tiles anew: where a cell has at least ``minimum`` votes."""
    counts, enough = pool.reshape(-1), road.reshape(-1)
    for w in range(enough.size):
        word = np.uint64(0)
        for k in range(64):
            word |= np.uint64(counts[64 * w + k] >= minimum) << np.uint64(k)
        enough[w] = word


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
        As for `cut_window`.
    """
    tile_x0, tile_y0 = left >> _SHIFT, (top - size + 1) >> _SHIFT
    total, road = np.int64(0), np.int64(0)
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
            n, m = np.int32(0), np.int32(0)
            for k in range(cells.size):
                among_others = (before[k] & after[k]) < 0  # both negative
                n += np.int32(among_others & (cells[k] != 0))
                m += np.int32(among_others & (cells[k] > 0))
            total += n
            road += m
    return road / total if total > 0 else 0.0


@compiled
def cut_window(tiles: UInt64Array, table: Int32Array, left: int, top: int, size: int, words: UInt64Array) -> None:
    """Write a square of the packed images of tiles as one packed image.

    Parameters
    ----------
    tiles : (P, TILE * TILE / 64) uint64
    table : (rows, columns) int32
        Slots of the tiles from the tile of (left, top - size + 1) on; -1 where there is no tile.
    left, top : int
        ix of the first column; iy of the first row. Rows go down, against +y (paper: R is turned about x).
    words : (size + 2, W) uint64
        Empty packed image.
    """
    first, shift = left >> 6, np.uint64(left & 63)
    tile_x0, tile_y0 = left >> _SHIFT, (top - size + 1) >> _SHIFT
    line = np.zeros(words.shape[1] + 1, np.uint64)  # the words that the row lies in
    inside = (np.uint64(1) << np.uint64(size & 63)) - np.uint64(1)
    for r in range(size):
        iy = top - r
        slots, start = table[(iy >> _SHIFT) - tile_y0], (iy & _MASK) << _WORD_SHIFT
        for w in range(line.size):
            column = ((first + w) >> _WORD_SHIFT) - tile_x0
            slot = slots[column] if column < slots.size else -1
            line[w] = tiles[slot, start + ((first + w) & _WORD_MASK)] if slot >= 0 else np.uint64(0)
        for w in range(words.shape[1]):
            words[r + 1, w] = (line[w] >> shift) | ((line[w + 1] << np.uint64(1)) << (np.uint64(63) - shift))
        words[r + 1, -1] &= inside


@compiled
def drop_outvoted(pool: Int32Array, table: Int32Array, left: int, top: int, weight: float, words: UInt64Array) -> None:
    """Clear the cells of an image of `cut_window` whose votes, with those around them, are not for road.

    The votes of the eight cells around count with a weight beside those of the cell itself.
    """
    size = words.shape[0] - 2
    tile_x0, tile_y0 = left >> _SHIFT, (top - size + 1) >> _SHIFT
    for r in range(size):
        iy = top - r
        slots, start = table[(iy >> _SHIFT) - tile_y0], (iy & _MASK) << _SHIFT
        for w in range(words.shape[1]):
            word = words[r + 1, w]
            while word != 0:
                lowest = word & (~word + np.uint64(1))
                ix = left + w * 64 + lowest_bit(word)
                votes = pool[slots[(ix >> _SHIFT) - tile_x0], start + (ix & _MASK)]
                around = _sum_of_nine(pool, table, tile_x0, tile_y0, ix, iy) - votes
                if not votes + weight * around > 0.0:
                    words[r + 1, w] ^= lowest
                word ^= lowest
