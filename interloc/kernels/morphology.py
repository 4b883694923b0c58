"""Dilation and erosion of packed images by a disc, 64 pixels at a time, and small gaps in them, filled.

A disc is a stack of horizontal spans: the rows are widened once by every half-width that the disc has, then the widened
rows are joined vertically. What lies outside of the image never decides: neither road nor gap.
"""

import math
from functools import cache

import numpy as np

from interloc.arrays import Int32Array, IntArray, UInt64Array
from interloc.kernels import compiled
from interloc.kernels.bits import count_pixels, lowest_bit


@cache
def disc_half_widths(diameter_px: int) -> IntArray:
    """Return the half-widths of the rows 0..R of a disc, R = (d - 1) / 2, for an odd diameter in pixels.

    The disc is the set of pixels whose centres lie within d / 2 of its centre: dx^2 + dy^2 <= (d / 2)^2.
    """
    if diameter_px < 1 or diameter_px % 2 == 0:
        raise ValueError(f"the diameter of a disc is an odd number of pixels, not {diameter_px}")
    radius = diameter_px / 2
    return np.array([math.isqrt(int(radius * radius - dy * dy)) for dy in range(diameter_px // 2 + 1)], np.int64)


@compiled
def _combine(source: UInt64Array, half_widths: IntArray, width: int, invert: bool) -> UInt64Array:
    """Dilate by the disc; with ``invert``, dilate the complement and complement the result: an erosion.

    The loops run over all words of the image at once: the empty columns at the end of each row keep the rows apart.
    They are over slices of equal length, which the compiler does several words at a time.
    """
    n_words = source.shape[1]
    radius = half_widths.size - 1
    empty = 64 - width % 64  # columns at the end of each row
    inside = ~np.uint64(0) >> np.uint64(empty)  # the others of its last word
    target = np.zeros_like(source)
    first, last = 1, source.shape[0] - 2
    while first < last and not source[first].any():
        first += 1
    while first < last and not source[last].any():
        last -= 1
    rows = slice(max(first - radius, 1), min(last + radius, source.shape[0] - 2) + 1)  # nothing comes of the others
    given, result = source[rows].reshape(-1), target[rows].reshape(-1)
    above = (radius + 1) * n_words  # empty words above and below, so that the disc may reach beyond the image
    wide, wider = np.empty(given.size + 2 * above, np.uint64), np.empty(given.size + 2 * above, np.uint64)
    for each in (wide, wider):
        each[:above] = each[above + given.size :] = 0
    here = wide[above : above + given.size]
    for k in range(given.size):
        here[k] = ~given[k] if invert else given[k]
    for k in range(n_words - 1, given.size, n_words):
        here[k] &= inside
    grown = 0
    # The rows far from the disc's middle are its narrowest, so the image is widened step by step.
    for dy in range(radius, -1, -1):
        while grown < half_widths[dy]:
            step = min(half_widths[dy] - grown, 2 * grown + 1, empty)  # so that no gap is left, and no row reached
            near, far = np.uint64(step), np.uint64(64 - step)
            here = wide[above : above + given.size]
            left = wide[above - 1 : above - 1 + given.size]
            right = wide[above + 1 : above + 1 + given.size]
            widened = wider[above : above + given.size]
            for k in range(given.size):
                widened[k] = here[k] | (here[k] << near) | (here[k] >> near) | (left[k] >> far) | (right[k] << far)
            for k in range(n_words - 1, given.size, n_words):
                widened[k] &= inside
            wide, wider = wider, wide
            grown += step
        up = wide[above - dy * n_words : above - dy * n_words + given.size]
        down = wide[above + dy * n_words : above + dy * n_words + given.size]
        for k in range(given.size):
            result[k] |= up[k] | down[k]
    if invert:
        for k in range(given.size):
            result[k] = ~result[k]
        for k in range(n_words - 1, given.size, n_words):
            result[k] &= inside
    return target


@compiled
def dilate(source: UInt64Array, half_widths: IntArray, width: int) -> UInt64Array:
    """Dilate a packed image of ``width`` columns by a disc (see `disc_half_widths`)."""
    return _combine(source, half_widths, width, False)


@compiled
def erode(source: UInt64Array, half_widths: IntArray, width: int) -> UInt64Array:
    """Erode a packed image of ``width`` columns by a disc (see `disc_half_widths`)."""
    return _combine(source, half_widths, width, True)


# Small gaps enclosed by road. A region of clear pixels is found as runs of each row, joined by union and find where
# runs of neighbouring rows touch side by side: set pixels are joined diagonally too, so clear ones are not, unless
# told otherwise.


@compiled
def fill_islands(words: UInt64Array, height: int, width: int, limit: float, diagonal: bool) -> Int32Array:
    """Set the clear regions of at most ``limit`` pixels that set pixels enclose, in place; the border encloses none.

    With ``diagonal``, clear pixels that touch at a corner are of one region. Returns row, first column, column behind
    the last, and a number of its region for each run of pixels that was set, (N, 4).
    """
    reach = 1 if diagonal else 0
    edges = _edges_of(words, width)
    total = count_pixels(edges) // 2
    begins, ends = np.empty(total, np.int32), np.empty(total, np.int32)
    parent = np.arange(total).astype(np.int32)
    area = np.zeros(total, np.int64)
    is_open = np.zeros(total, np.bool_)
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
            while upper < first and ends[upper] + reach <= begins[i]:
                upper += 1
            touching = upper
            while touching < first and begins[touching] < ends[i] + reach:
                a, b = _root(parent, touching), _root(parent, i)
                if a != b:
                    parent[b] = a
                    area[a] += area[b]
                    is_open[a] |= is_open[b]
                touching += 1
        above = first
    begin_of[height] = count
    runs, filled = np.empty((count, 4), np.int32), 0
    for r in range(height):
        for i in range(begin_of[r], begin_of[r + 1]):
            root = _root(parent, i)
            if not is_open[root] and area[root] <= limit:
                runs[filled, 0], runs[filled, 1], runs[filled, 2], runs[filled, 3] = r, begins[i], ends[i], root
                filled += 1
    set_runs(words, runs[:filled])
    return runs[:filled]


@compiled
def set_runs(words: UInt64Array, runs: Int32Array) -> None:
    """Set runs of pixels, as `fill_islands` returns them, in place."""
    for i in range(len(runs)):
        for c in range(runs[i, 1], runs[i, 2]):
            words[runs[i, 0] + 1, c >> 6] |= np.uint64(1) << np.uint64(c & 63)


@compiled
def _edges_of(words: UInt64Array, width: int) -> UInt64Array:
    """Mark the first pixel of each clear run of each row, and the one behind its last, in as many words."""
    flat, n_words, one = words[1:-1].reshape(-1), words.shape[1], np.uint64(1)
    clear, edges = np.empty_like(flat), np.empty_like(flat)
    for k in range(flat.size):
        clear[k] = ~flat[k]
    for k in range(n_words - 1, flat.size, n_words):
        clear[k] &= (one << np.uint64(width & 63)) - one
    edges[0] = clear[0] ^ (clear[0] << one)
    here, before, marked = clear[1:], clear[:-1], edges[1:]  # the last bit of a row is never set
    for k in range(marked.size):
        marked[k] = here[k] ^ ((here[k] << one) | (before[k] >> np.uint64(63)))
    return edges.reshape(-1, n_words)


@compiled
def _root(parent: Int32Array, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
