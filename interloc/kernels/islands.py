"""Small gaps enclosed by road, filled in a packed image.

A region of clear pixels is found as runs of each row, joined by union and find where runs of neighbouring rows touch
side by side: set pixels are joined diagonally too, so clear ones are not.
"""

import numpy as np

from interloc.arrays import Int32Array, UInt64Array
from interloc.kernels import compiled
from interloc.kernels.bits import lowest_bit, popcount


@compiled
def fill_islands(words: UInt64Array, height: int, width: int, limit: float) -> None:
    """Set the clear regions of at most ``limit`` pixels that set pixels enclose, in place; the border encloses none."""
    edges = np.empty((height, words.shape[1]), np.uint64)  # where clear runs begin and end, by turns
    total = 0
    for r in range(height):
        total += _edges_of(words[r + 1], width, edges[r])
    begins, ends = np.empty(total // 2, np.int32), np.empty(total // 2, np.int32)
    parent = np.arange(total // 2).astype(np.int32)
    area = np.zeros(total // 2, np.int64)
    is_open = np.zeros(total // 2, np.bool_)
    begin_of = np.empty(height + 1, np.int32)  # number of the first run of each row
    count, above = 0, 0
    for r in range(height):
        first = count
        begin_of[r] = first
        is_end = False
        for w in range(words.shape[1]):
            word = edges[r, w]
            while word != 0:
                col = w * 64 + lowest_bit(word)
                word &= word - np.uint64(1)
                if is_end:
                    ends[count] = col
                    count += 1
                else:
                    begins[count] = col
                is_end = not is_end
        upper = above
        for i in range(first, count):
            area[i] = ends[i] - begins[i]
            is_open[i] = r == 0 or r == height - 1 or begins[i] == 0 or ends[i] == width
            while upper < first and ends[upper] <= begins[i]:
                upper += 1
            touching = upper
            while touching < first and begins[touching] < ends[i]:
                a, b = _root(parent, touching), _root(parent, i)
                if a != b:
                    parent[b] = a
                    area[a] += area[b]
                    is_open[a] |= is_open[b]
                touching += 1
        above = first
    begin_of[height] = count
    for r in range(height):
        for i in range(begin_of[r], begin_of[r + 1]):
            root = _root(parent, i)
            if not is_open[root] and area[root] <= limit:
                for c in range(begins[i], ends[i]):
                    words[r + 1, c >> 6] |= np.uint64(1) << np.uint64(c & 63)


@compiled
def _edges_of(row: UInt64Array, width: int, edges: UInt64Array) -> int:
    """Mark the first pixel of each clear run of a row and the one behind its last; return how many that are."""
    one, before, count = np.uint64(1), np.uint64(0), 0
    for w in range(row.size):
        inside = ~np.uint64(0) if w < width >> 6 else (one << np.uint64(width & 63)) - one
        clear = ~row[w] & inside
        edges[w] = clear ^ ((clear << one) | before)
        before = clear >> np.uint64(63)
        if edges[w] != 0:
            count += popcount(edges[w])
    return count


@compiled
def _root(parent: Int32Array, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
