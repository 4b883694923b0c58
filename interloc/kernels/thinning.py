"""Zhang-Suen thinning (Zhang and Suen 1984) that touches only what changes.

Each pixel carries the code of its eight neighbours. Deleting a pixel clears one bit in eight codes; a pixel whose code
says "deletable" is queued for the sub-iteration that may delete it, as often as that happens. The work grows with the
pixels deleted, not with the image times the iterations, and the result is that of the definition: a sub-iteration
decides on the codes from before it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from interloc.arrays import Int32Array, UInt8Array, UInt64Array
from interloc.kernels import compiled
from interloc.kernels.bits import lowest_bit


def _deletable() -> UInt8Array:
    """Return for each neighbour code whether sub-iteration 1 (bit 0) and 2 (bit 1) delete the pixel.

    Bit i of a code is the neighbour P(i + 2) of the definition: P2 above, then clockwise.
    """
    table = np.zeros(256, np.uint8)
    for code in range(256):
        p2, p3, p4, p5, p6, p7, p8, p9 = ((code >> i) & 1 for i in range(8))
        ring = (p2, p3, p4, p5, p6, p7, p8, p9, p2)
        neighbours = sum(ring[:8])
        transitions = sum(a == 0 and b == 1 for a, b in pairwise(ring))
        if 2 <= neighbours <= 6 and transitions == 1:
            first = p2 * p4 * p6 == 0 and p4 * p6 * p8 == 0
            second = p2 * p4 * p8 == 0 and p2 * p6 * p8 == 0
            table[code] = int(first) + 2 * int(second)
    return table


DELETABLE = _deletable()


@compiled
def _with_room(queue: Int32Array, size: int) -> Int32Array:
    """Return a queue, or a longer copy of it, that has room for a number of entries."""
    if size <= queue.size:
        return queue
    longer = np.empty(2 * size, np.int32)
    longer[: queue.size] = queue
    return longer


@compiled
def _neighbour_codes(words: UInt64Array) -> tuple[UInt8Array, Int32Array]:
    """Return the code of every pixel, 0 for clear ones, and the flat indices of the pixels on a border."""
    n_words = words.shape[1]
    flat = np.append(words, np.uint64(0))  # the last word, too, has one to its right
    one, last = np.uint64(1), np.uint64(63)
    codes = np.zeros(words.size * 64, np.uint8)
    border = np.empty(4096, np.int32)
    n_border = 0
    for k in range(n_words, words.size - n_words):
        word = flat[k]
        if word == 0:
            continue
        # The neighbours P2 to P9 of all 64 pixels. An empty column ends each row: nothing comes from the row before.
        up, down = k - n_words, k + n_words
        p2, p6 = flat[up], flat[down]
        p3 = (flat[up] >> one) | (flat[up + 1] << last)
        p4 = (flat[k] >> one) | (flat[k + 1] << last)
        p5 = (flat[down] >> one) | (flat[down + 1] << last)
        p7 = (flat[down] << one) | (flat[down - 1] >> last)
        p8 = (flat[k] << one) | (flat[k - 1] >> last)
        p9 = (flat[up] << one) | (flat[up - 1] >> last)
        inner = word & p2 & p3 & p4 & p5 & p6 & p7 & p8 & p9
        if inner != 0:
            for i in range(64):
                codes[64 * k + i] = 255 * ((inner >> np.uint64(i)) & one)
        edge = word & ~inner
        while edge != 0:
            i = lowest_bit(edge)
            edge &= edge - one
            code = 0
            for place, neighbour in enumerate((p2, p3, p4, p5, p6, p7, p8, p9)):
                code |= int((neighbour >> np.uint64(i)) & one) << place
            codes[64 * k + i] = code
            if n_border == border.size:
                border = np.concatenate((border, np.empty(border.size, np.int32)))
            border[n_border] = 64 * k + i
            n_border += 1
    return codes, border[:n_border]


@compiled
def _delete(words: UInt64Array, codes: UInt8Array, deletable: UInt8Array, queue: Int32Array, which: int) -> Int32Array:
    """Delete the pixels of a queue that a sub-iteration deletes, 1 or 2; return them, each once."""
    flat = words.reshape(-1)
    n_doomed = 0
    for p in queue:  # no branch: which pixels are doomed is hard to foresee
        queue[n_doomed] = p
        n_doomed += (deletable[codes[p]] & which) != 0
    n_deleted = 0
    for p in queue[:n_doomed]:
        if codes[p] != 0:
            codes[p] = 0
            flat[p >> 6] &= ~(np.uint64(1) << np.uint64(p & 63))
            queue[n_deleted] = p
            n_deleted += 1
    return queue[:n_deleted].copy()


@compiled
def thin(words: UInt64Array, deletable: UInt8Array) -> None:
    """Thin a packed image to its centerline, in place; ``deletable`` is `DELETABLE`."""
    stride = words.shape[1] * 64
    # Neighbour P(i + 2) lies at +offset[i]; seen from there, this pixel is its neighbour i + 4 (mod 8).
    offsets = np.array([-stride, -stride + 1, 1, stride + 1, stride, stride - 1, -1, -stride - 1], np.int64)
    kept = np.array([255 - (1 << ((i + 4) & 7)) for i in range(8)], np.uint8)
    codes, border = _neighbour_codes(words)
    # The pixels that sub-iterations 1 and 2 may delete, some of them several times.
    first, second = np.empty(border.size, np.int32), np.empty(border.size, np.int32)
    n_first, n_second = 0, 0
    for p in border:
        which = deletable[codes[p]]
        if which & 1:
            first[n_first] = p
            n_first += 1
        if which & 2:
            second[n_second] = p
            n_second += 1
    sub = 0
    idle = 0
    while idle < 2:
        if sub == 0:
            deleted = _delete(words, codes, deletable, first[:n_first], 1)
            n_first = 0
        else:
            deleted = _delete(words, codes, deletable, second[:n_second], 2)
            n_second = 0
        first, second = _with_room(first, n_first + 8 * deleted.size), _with_room(second, n_second + 8 * deleted.size)
        for p in deleted:
            for i in range(8):
                q = p + offsets[i]
                code = codes[q]
                if code != 0:  # clear pixels have code 0, which is not deletable: they are never queued
                    code &= kept[i]
                    codes[q] = code
                    which = deletable[code]
                    if which & 1:
                        first[n_first] = q
                        n_first += 1
                    if which & 2:
                        second[n_second] = q
                        n_second += 1
        idle = 0 if deleted.size else idle + 1
        sub = 1 - sub
