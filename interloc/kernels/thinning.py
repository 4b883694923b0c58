"""Zhang-Suen thinning (Zhang and Suen 1984) that touches only what changes.

Each pixel carries the code of its eight neighbours. Deleting a pixel clears one bit in eight codes; a pixel whose code
says "deletable" is queued for the sub-iteration that may delete it. The work grows with the pixels deleted, not with
the image times the iterations, and the result is that of the definition: a sub-iteration decides on the codes from
before it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from interloc.kernels._compile import compiled
from interloc.kernels.bits import Words, lowest_bit


def _deletable() -> NDArray[np.uint8]:
    """Return for each neighbour code whether sub-iteration 1 (bit 0) and 2 (bit 1) delete the pixel.

    Bit i of a code is the neighbour P(i + 2) of the definition: P2 above, then clockwise.
    """
    table = np.zeros(256, np.uint8)
    for code in range(256):
        p2, p3, p4, p5, p6, p7, p8, p9 = ((code >> i) & 1 for i in range(8))
        ring = (p2, p3, p4, p5, p6, p7, p8, p9, p2)
        neighbours = sum(ring[:8])
        transitions = sum(a == 0 and b == 1 for a, b in zip(ring, ring[1:], strict=False))
        if 2 <= neighbours <= 6 and transitions == 1:
            first = p2 * p4 * p6 == 0 and p4 * p6 * p8 == 0
            second = p2 * p4 * p8 == 0 and p2 * p6 * p8 == 0
            table[code] = int(first) + 2 * int(second)
    return table


DELETABLE = _deletable()


@compiled
def thin(words: Words, deletable: NDArray[np.uint8]) -> None:
    """Thin a packed image to its centerline, in place; ``deletable`` is `DELETABLE`."""
    n_rows, n_words = words.shape
    stride = n_words * 64
    flat = words.reshape(-1)
    one, last = np.uint64(1), np.uint64(63)
    # Neighbour P(i + 2) lies at +offset[i]; seen from there, this pixel is its neighbour i + 4 (mod 8).
    offsets = np.array([-stride, -stride + 1, 1, stride + 1, stride, stride - 1, -1, -stride - 1], np.int64)
    codes = np.full(n_rows * stride, 255, np.uint8)

    n_border = 0
    border = np.empty(1024, np.int64)
    for r in range(1, n_rows - 1):
        for w in range(n_words):
            word = words[r, w]
            if word == 0:
                continue
            inner = ~np.uint64(0)
            for k in range(-1, 2):
                row = words[r + k, w]
                left = (row << one) | (words[r + k, w - 1] >> last if w > 0 else np.uint64(0))
                right = (row >> one) | (words[r + k, w + 1] << last if w + 1 < n_words else np.uint64(0))
                inner &= row & left & right
            edge = word & ~inner
            while edge != 0:
                if n_border == border.size:
                    border = np.concatenate((border, np.empty(border.size, np.int64)))
                border[n_border] = r * stride + w * 64 + lowest_bit(edge)
                edge &= edge - one
                n_border += 1

    queues = np.empty((2, max(4 * n_border, 1024)), np.int64)
    sizes = np.zeros(2, np.int64)
    queued = np.zeros(n_rows * stride, np.uint8)
    for b in range(n_border):
        p = border[b]
        code = 0
        for i in range(8):
            q = p + offsets[i]
            if (flat[q >> 6] >> np.uint64(q & 63)) & one:
                code |= 1 << i
        codes[p] = code
        which = deletable[code]
        for s in range(2):
            if (which >> s) & 1:
                queues[s, sizes[s]] = p
                sizes[s] += 1
        queued[p] = which

    doomed = np.empty(queues.shape[1], np.int64)
    sub = 0
    idle = 0
    while idle < 2:
        n_doomed = 0
        for k in range(sizes[sub]):
            p = queues[sub, k]
            queued[p] &= ~np.uint8(1 << sub)
            alive = (flat[p >> 6] >> np.uint64(p & 63)) & one
            if alive and (deletable[codes[p]] >> sub) & 1:
                doomed[n_doomed] = p
                n_doomed += 1
        sizes[sub] = 0
        for k in range(n_doomed):
            p = doomed[k]
            flat[p >> 6] &= ~(one << np.uint64(p & 63))
        for k in range(n_doomed):
            p = doomed[k]
            for i in range(8):
                q = p + offsets[i]
                if not (flat[q >> 6] >> np.uint64(q & 63)) & one:
                    continue
                codes[q] &= ~np.uint8(1 << ((i + 4) & 7))
                fresh = deletable[codes[q]] & ~queued[q]
                if fresh:
                    if max(sizes[0], sizes[1]) + 1 >= queues.shape[1]:
                        grown = np.empty((2, 2 * queues.shape[1]), np.int64)
                        grown[:, : queues.shape[1]] = queues
                        queues = grown
                        doomed = np.concatenate((doomed, np.empty(doomed.size, np.int64)))
                    for s in range(2):
                        if (fresh >> s) & 1:
                            queues[s, sizes[s]] = q
                            sizes[s] += 1
                    queued[q] |= fresh
        idle = 0 if n_doomed else idle + 1
        sub = 1 - sub
