"""Dilation and erosion of packed images by a disc, 64 pixels at a time.

A disc is a stack of horizontal spans: each row is widened once by every half-width that the disc has, then the
widened rows are joined vertically. What lies outside of the image never decides: neither road nor gap.
"""

from __future__ import annotations

import math

import numpy as np

from interloc.arrays import IntArray, UInt64Array
from interloc.kernels import compiled


def disc_half_widths(diameter_px: int) -> IntArray:
    """Return the half-widths of the rows 0..R of a disc, R = (d - 1) / 2, for an odd diameter in pixels.

    The disc is the set of pixels whose centres lie within d / 2 of its centre: dx^2 + dy^2 <= (d / 2)^2.
    """
    if diameter_px < 1 or diameter_px % 2 == 0:
        raise ValueError(f"the diameter of a disc is an odd number of pixels, not {diameter_px}")
    radius = diameter_px / 2
    return np.array([math.isqrt(int(radius * radius - dy * dy)) for dy in range(diameter_px // 2 + 1)], np.int64)


@compiled
def _column_masks(n_words: int, width: int) -> UInt64Array:
    """Return the words of a row whose pixels inside of the image are all set."""
    masks = np.zeros(n_words, np.uint64)
    for c in range(width):
        masks[c >> 6] |= np.uint64(1) << np.uint64(c & 63)
    return masks


@compiled
def _combine(source: UInt64Array, half_widths: IntArray, width: int, invert: bool) -> UInt64Array:
    """Dilate by the disc; with ``invert``, dilate the complement and complement the result: an erosion."""
    n_rows, n_words = source.shape
    radius = half_widths.size - 1
    masks = _column_masks(n_words, width)
    one, last = np.uint64(1), np.uint64(63)
    target = np.zeros((n_rows, n_words), np.uint64)
    wide = np.empty(n_words, np.uint64)
    wider = np.empty(n_words, np.uint64)
    full = np.zeros(n_rows, np.bool_)  # rows of the target that are set throughout: no need to look at them again
    for r in range(1, n_rows - 1):
        empty, whole = True, True
        for w in range(n_words):
            wide[w] = (~source[r, w] & masks[w]) if invert else source[r, w]
            if wide[w] != 0:
                empty = False
            if wide[w] != masks[w]:
                whole = False
        if empty:
            continue
        if whole:
            full[max(r - radius, 1) : min(r + radius, n_rows - 2) + 1] = True
            continue
        grown = 0
        # The rows far from the disc's middle are its narrowest, so one row is widened step by step.
        for dy in range(radius, -1, -1):
            while grown < half_widths[dy]:
                for w in range(n_words):
                    word = wide[w] | (wide[w] << one) | (wide[w] >> one)
                    if w > 0:
                        word |= wide[w - 1] >> last
                    if w + 1 < n_words:
                        word |= wide[w + 1] << last
                    wider[w] = word & masks[w]
                wide, wider = wider, wide
                grown += 1
            if r - dy >= 1 and not full[r - dy]:
                for w in range(n_words):
                    target[r - dy, w] |= wide[w]
            if dy > 0 and r + dy < n_rows - 1 and not full[r + dy]:
                for w in range(n_words):
                    target[r + dy, w] |= wide[w]
    for r in range(1, n_rows - 1):
        for w in range(n_words):
            if full[r]:
                target[r, w] = masks[w]
            if invert:
                target[r, w] = ~target[r, w] & masks[w]
    return target


@compiled
def dilate(source: UInt64Array, half_widths: IntArray, width: int) -> UInt64Array:
    """Dilate a packed image of ``width`` columns by a disc (see `disc_half_widths`)."""
    return _combine(source, half_widths, width, False)


@compiled
def erode(source: UInt64Array, half_widths: IntArray, width: int) -> UInt64Array:
    """Erode a packed image of ``width`` columns by a disc (see `disc_half_widths`)."""
    return _combine(source, half_widths, width, True)
