"""Zhang-Suen thinning (Zhang and Suen 1984) that touches only what changes.

Each pixel carries the code of its eight neighbours. Deleting a pixel clears one bit in eight codes; a pixel whose code
says "deletable" is queued for the sub-iteration that may delete it. The work grows with the pixels deleted, not with
the image times the iterations, and the result is that of the definition: a sub-iteration decides on the codes from
before it.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from interloc.arrays import Int32Array, IntArray, UInt8Array, UInt64Array
from interloc.kernels import compiled
from interloc.kernels.bits import lowest_bit, popcount


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
def _neighbour_codes(words: UInt64Array, offsets: IntArray) -> tuple[UInt8Array, Int32Array]:
    """Return the code of every pixel, 0 for clear ones, and the flat indices of the pixels on a border."""
    n_rows, n_words = words.shape
    stride = n_words * 64
    flat = words.reshape(-1)
    one, last, full = np.uint64(1), np.uint64(63), ~np.uint64(0)
    codes = np.zeros(n_rows * stride, np.uint8)
    border = np.empty(4096, np.int32)
    n_border = 0
    for r in range(1, n_rows - 1):
        for w in range(n_words):
            word = words[r, w]
            if word == 0:
                continue
            inner = full
            for k in range(-1, 2):
                row = words[r + k, w]
                left = (row << one) | (words[r + k, w - 1] >> last if w > 0 else np.uint64(0))
                right = (row >> one) | (words[r + k, w + 1] << last if w + 1 < n_words else np.uint64(0))
                inner &= row & left & right
            first = r * stride + w * 64
            if inner == full:
                codes[first : first + 64] = 255
                continue
            while inner != 0:
                codes[first + lowest_bit(inner)] = 255
                inner &= inner - one
            edge = word
            while edge != 0:
                p = first + lowest_bit(edge)
                edge &= edge - one
                if codes[p] == 255:
                    continue
                code = 0
                for i in range(8):
                    q = p + offsets[i]
                    code |= int((flat[q >> 6] >> np.uint64(q & 63)) & one) << i
                codes[p] = code
                if n_border == border.size:
                    border = np.concatenate((border, np.empty(border.size, np.int32)))
                border[n_border] = p
                n_border += 1
    return codes, border[:n_border]


@compiled
def thin(words: UInt64Array, deletable: UInt8Array) -> None:
    """Thin a packed image to its centerline, in place; ``deletable`` is `DELETABLE`."""
    stride = words.shape[1] * 64
    flat = words.reshape(-1)
    # Neighbour P(i + 2) lies at +offset[i]; seen from there, this pixel is its neighbour i + 4 (mod 8).
    offsets = np.array([-stride, -stride + 1, 1, stride + 1, stride, stride - 1, -1, -stride - 1], np.int64)
    kept = np.array([255 - (1 << ((i + 4) & 7)) for i in range(8)], np.uint8)
    codes, border = _neighbour_codes(words, offsets)

    # A pixel stands at most once in each queue, so neither can outgrow the number of set pixels.
    capacity = 0
    for w in range(flat.size):
        if flat[w] != 0:
            capacity += popcount(flat[w])
    queues = np.empty((2, capacity), np.int32)
    sizes = np.zeros(2, np.int64)
    queued = np.zeros(codes.size, np.uint8)
    for b in range(border.size):
        p = border[b]
        which = deletable[codes[p]]
        queued[p] = which
        for s in range(2):
            if (which >> s) & 1:
                queues[s, sizes[s]] = p
                sizes[s] += 1

    doomed = np.empty(capacity, np.int32)
    sub = 0
    idle = 0
    while idle < 2:
        this = np.uint8(1 << sub)
        n_doomed = 0
        for k in range(sizes[sub]):
            p = queues[sub, k]
            queued[p] &= 255 - this
            if deletable[codes[p]] & this:
                doomed[n_doomed] = p
                n_doomed += 1
        sizes[sub] = 0
        for k in range(n_doomed):
            p = doomed[k]
            codes[p] = 0  # clear pixels have code 0, which is not deletable: they are never queued again
            flat[p >> 6] &= ~(np.uint64(1) << np.uint64(p & 63))
        for k in range(n_doomed):
            p = doomed[k]
            for i in range(8):
                q = p + offsets[i]
                code = codes[q] & kept[i]
                codes[q] = code
                fresh = deletable[code] & (255 - queued[q])
                if fresh:
                    queued[q] |= fresh
                    if fresh & 1:
                        queues[0, sizes[0]] = q
                        sizes[0] += 1
                    if fresh & 2:
                        queues[1, sizes[1]] = q
                        sizes[1] += 1
        idle = 0 if n_doomed else idle + 1
        sub = 1 - sub
