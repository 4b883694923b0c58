"""Zhang-Suen thinning (Zhang and Suen 1984) of packed images, 64 pixels at a time, and only where pixels change.

A sub-iteration looks at a word again only if a pixel in it or next to it was deleted in the last two: else nothing that
it decides on has changed since it looked there last. The work grows with the length of the border that is peeled off,
not with the image, and the result is that of the definition.
"""

import numpy as np

from interloc.arrays import UInt64Array
from interloc.kernels import compiled


@compiled
def _doomed(flat: UInt64Array, k: np.uint64, stride: np.uint64, is_first: bool) -> np.uint64:
    """Return the pixels of word ``k`` that the first or the second sub-iteration deletes; ``stride`` words per row."""
    one, last = np.uint64(1), np.uint64(63)
    up, down = k - stride, k + stride
    # The neighbours P2 to P9 of all 64 pixels. An empty column ends each row: nothing comes from the row before.
    p1, p2, p6 = flat[k], flat[up], flat[down]
    p3 = (p2 >> one) | (flat[up + one] << last)
    p4 = (p1 >> one) | (flat[k + one] << last)
    p5 = (p6 >> one) | (flat[down + one] << last)
    p7 = (p6 << one) | (flat[down - one] >> last)
    p8 = (p1 << one) | (flat[k - one] >> last)
    p9 = (p2 << one) | (flat[up - one] >> last)
    # A(P1) = 1: exactly one step from clear to set on the way round. Two in a row are never both such steps.
    a = (~p2 & p3) | (~p3 & p4)
    b = (~p4 & p5) | (~p5 & p6)
    c = (~p6 & p7) | (~p7 & p8)
    d = (~p8 & p9) | (~p9 & p2)
    one_step = ((a ^ b) & ~(c | d)) | ((c ^ d) & ~(a | b))
    # B(P1) >= 2: with one step the set neighbours are in a row, so two of them lie side by side.
    two_set = (p2 & (p3 | p9)) | (p4 & (p3 | p5)) | (p6 & (p5 | p7)) | (p8 & (p7 | p9))
    # The products of the sub-iteration; and B(P1) <= 6, which seven miss where the clear one makes both products 0.
    if is_first:
        kept = (p4 & p6 & (p2 | p8)) | (~p4 & p3 & p5) | (~p6 & p5 & p7)
    else:
        kept = (p2 & p8 & (p4 | p6)) | (~p2 & p9 & p3) | (~p8 & p7 & p9)
    deleted: np.uint64 = p1 & one_step & two_set & ~kept
    return deleted


@compiled
def thin(words: UInt64Array) -> None:
    """Thin a packed image to its centerline, in place."""
    one, last = np.uint64(1), np.uint64(63)
    stride = np.uint64(words.shape[1])
    flat = np.zeros(words.size + 2, np.uint64)  # the first word has one to its left, the last one to its right
    flat[1:-1] = words.reshape(-1)
    active = np.empty(flat.size, np.uint64)  # the words to look at, each once
    until = np.zeros(flat.size, np.int64)  # the last sub-iteration, counted from 1, that looks at each word
    n_active = 0
    for k in range(1 + words.shape[1], flat.size - 1 - words.shape[1]):
        if flat[k] != 0:
            active[n_active] = k
            until[k] = 2
            n_active += 1
    changed, doomed = np.empty(n_active, np.uint64), np.empty(n_active, np.uint64)
    number = 0
    while n_active > 0:
        number += 1
        n_changed = 0
        for k in active[:n_active]:  # all decide on the pixels from before; no branch: what changes is hard to foresee
            changed[n_changed] = k
            doomed[n_changed] = _doomed(flat, k, stride, number % 2 == 1)
            n_changed += doomed[n_changed] != 0
        for i in range(n_changed):
            k = changed[i]
            flat[k] &= ~doomed[i]
            leftmost = k - (doomed[i] & one)  # only the pixels at its ends have neighbours in the words beside
            rightmost = k + (doomed[i] >> last)
            near = leftmost
            while near <= rightmost:
                for word in (near - stride, near, near + stride):
                    active[n_active] = word
                    n_active += (until[word] < number) & (flat[word] != 0)
                    until[word] = number + 2
                near += one
        n_known, n_active = n_active, 0
        for k in active[:n_known]:
            active[n_active] = k
            n_active += until[k] > number
    words.reshape(-1)[:] = flat[1:-1]
