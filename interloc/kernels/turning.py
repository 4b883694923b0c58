"""Turning packed images by three shears.

Paeth, "A fast algorithm for general raster rotation", Graphics Interface, 1986. A shear moves whole rows or columns by
whole pixels: none is lost or doubled, and 64 move at once.
"""

import math

import numpy as np

from interloc.arrays import UInt64Array
from interloc.kernels import compiled


@compiled
def _nearest(x: float) -> np.int64:
    return np.int64(math.floor(x + 0.5))


@compiled
def _shift(line: UInt64Array, begin: int, shifted: UInt64Array) -> None:
    """Write the bits of a line of words from one of its bits on; the line must hold a word more."""
    w, within = np.uint64(begin >> 6), np.uint64(begin & 63)
    for k in range(shifted.size):
        shifted[k] = (line[w] >> within) | ((line[w + np.uint64(1)] << np.uint64(1)) << (np.uint64(63) - within))
        w += np.uint64(1)


@compiled
def turn(source: UInt64Array, size: int, angle_rad: float, words: UInt64Array) -> None:
    """Write a square image as it looks along axes that are turned about its middle.

    Parameters
    ----------
    source : (size + 2, V) uint64
        Packed image; outside of it nothing is set.
    size : int
        Pixels per side, even where that of the result is, odd where it is odd.
    angle_rad : float
        By how much the axes of the result are turned, counter-clockwise with rows that go down; -pi/4 .. pi/4.
    words : (N + 2, W) uint64
        Empty packed image of N pixels per side, with the same middle. A pixel is off by less than one.
    """
    n = words.shape[0] - 2
    along_rows, along_columns = math.tan(0.5 * angle_rad), -math.sin(angle_rad)
    middle, source_middle, pad = 0.5 * (n - 1), 0.5 * (size - 1), (size - n) // 2
    margin = math.ceil(0.5 * n * abs(along_rows))  # of the sheared images, left and right
    n_words = ((n + 2 * margin) >> 6) + 1
    # Words before and behind a row that a shear may reach.
    farthest = (abs(pad) + margin + _nearest(abs(along_rows) * source_middle) >> 6) + 1
    padded = np.zeros(max(source.shape[1], n_words) + 2 * farthest + 1, np.uint64)
    line = np.empty(n_words, np.uint64)
    sheared = np.empty((n_words, size), np.uint64)  # by columns of words: the loop over rows below runs along memory
    for r in range(size):
        padded[farthest : farthest + source.shape[1]] = source[r + 1]
        _shift(padded, 64 * farthest + pad - margin - _nearest(along_rows * (source_middle - r)), line)
        sheared[:, r] = line
    moved = np.zeros((n_words, n), np.uint64)
    for w in range(n_words):
        c = 64 * w
        while c < 64 * w + 64:
            shift = _nearest(along_columns * (c - margin - middle))
            mask = np.uint64(0)  # the columns that move as far as this one
            while c < 64 * w + 64 and _nearest(along_columns * (c - margin - middle)) == shift:
                mask |= np.uint64(1) << np.uint64(c & 63)
                c += 1
            first, last = max(0, -pad - shift), min(n, size - pad - shift)
            target, column = moved[w, first:last], sheared[w, first + pad + shift : last + pad + shift]
            for k in range(target.size):
                target[k] |= column[k] & mask
    padded[:] = 0
    inside = (np.uint64(1) << np.uint64(n & 63)) - np.uint64(1)
    for r in range(n):
        padded[farthest : farthest + n_words] = moved[:, r]
        _shift(padded, 64 * farthest + margin - _nearest(along_rows * (middle - r)), words[r + 1])
        words[r + 1, -1] &= inside
