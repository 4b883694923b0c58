"""The centerline as a graph of pixels: neighbours, spurs, distances along it.

Two pixels are joined side by side, or diagonally where no third pixel joins them side by side. A corner of a staircase
then has two neighbours like any other pixel of a line, and a pixel with three or more is a junction. (Counting 8-
neighbours takes corners for junctions; the crossing number misses a junction of four lines at a block of 2 x 2 pixels.)
"""

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, StructuredArray, UInt64Array
from interloc.kernels import compiled
from interloc.kernels.bits import nearest_clear, popcount


@compiled
def neighbours_of(words: UInt64Array, rows: Int32Array, cols: Int32Array) -> Int32Array:
    """Return the joined pixels of each pixel of a packed centerline.

    Parameters
    ----------
    rows, cols : (P,) int32
        All set pixels in row-major order.

    Returns
    -------
    (P, 4) int32
        Positions in ``rows``; -1 behind the last one. More than four are impossible.
    """
    n_words, flat = words.shape[1], words.reshape(-1)
    before = np.empty(flat.size, np.int32)  # of each word with set pixels: the position of its first one in the list
    for i in range(rows.size - 1, -1, -1):
        before[(rows[i] + 1) * n_words + (cols[i] >> 6)] = i
    stride = n_words * 64
    one = np.uint64(1)
    steps = np.array([-stride, 1, stride, -1, -stride + 1, stride + 1, stride - 1, -stride - 1], np.int64)
    result = np.full((rows.size, 4), -1, np.int32)
    side = np.zeros(5, np.bool_)
    for i in range(rows.size):
        p = (np.int64(rows[i]) + 1) * stride + cols[i]
        n = 0
        for k in range(8):
            q = p + steps[k]
            word = flat[q >> 6]
            is_set = ((word >> np.uint64(q & 63)) & one) != 0
            if k < 4:
                side[k] = is_set
                if k == 0:
                    side[4] = is_set
            elif side[k - 4] or side[k - 3]:
                continue
            if is_set:
                result[i, n] = before[q >> 6] + popcount(word & ((one << np.uint64(q & 63)) - one))
                n += 1
    return result


@compiled
def degrees_of(neighbours: Int32Array) -> Int32Array:
    """Return how many pixels each one is joined to, (P,) int32."""
    degree = np.zeros(neighbours.shape[0], np.int32)
    for i in range(neighbours.shape[0]):
        for k in range(neighbours.shape[1]):
            if neighbours[i, k] >= 0:
                degree[i] += 1
    return degree


@compiled
def prune_spurs(
    rows: Int32Array,
    cols: Int32Array,
    neighbours: Int32Array,
    occupancy: UInt64Array,
    size: int,
    widths: float,
    limit: int,
    border: int,
) -> BoolArray:
    """Find the dead ends that are shorter than a multiple of the road width where they leave the road.

    Parameters
    ----------
    rows, cols, neighbours
        The centerline, see `neighbours_of`.
    occupancy
        Packed image of the road; gives the width.
    size : int
        Pixels per side of the image.
    widths : float
        Longest spur in local road widths.
    limit : int
        Greatest half width of a road that is measured, pixels.
    border : int
        A tip nearer than this to the image's border is where the window cuts the road: it is kept.

    Returns
    -------
    (P,) bool
        True for the pixels to keep.
    """
    n = rows.size
    keep = np.ones(n, np.bool_)
    degree = degrees_of(neighbours)
    path = np.empty(n, np.int32)
    changed = True
    while changed:
        changed = False
        for tip in range(n):
            if not keep[tip] or degree[tip] != 1:
                continue
            r, c = rows[tip], cols[tip]
            if r < border or c < border or r >= size - border or c >= size - border:
                continue
            # Walk from the tip to the junction where the dead end begins.
            length, count, last, here, junction = 0.0, 0, -1, tip, -1
            while True:
                path[count] = here
                count += 1
                onward = -1
                for k in range(4):
                    q = neighbours[here, k]
                    if q >= 0 and q != last and keep[q]:
                        onward = q
                        break
                if onward < 0:
                    break
                dr, dc = rows[onward] - rows[here], cols[onward] - cols[here]
                length += np.sqrt(dr * dr + dc * dc)
                last, here = here, onward
                if degree[here] >= 3:
                    junction = here
                    break
                if degree[here] == 1:
                    break
            if junction < 0:
                continue
            width = 2.0 * nearest_clear(occupancy, rows[junction], cols[junction], size, size, limit)
            if length >= widths * width:
                continue
            for k in range(count):
                keep[path[k]] = False
            degree[junction] -= 1
            changed = True
    return keep


@compiled
def clear_pixels(words: UInt64Array, rows: Int32Array, cols: Int32Array) -> None:
    """Clear some pixels of a packed image in place."""
    for i in range(rows.size):
        words[rows[i] + 1, cols[i] >> 6] &= ~(np.uint64(1) << np.uint64(cols[i] & 63))


@compiled
def widths_at(occupancy: UInt64Array, rows: Int32Array, cols: Int32Array, size: int, limit: int) -> FloatArray:
    """Return the local road width in pixels at some pixels of the centerline, (N,) float64."""
    widths = np.empty(rows.size)
    for i in range(rows.size):
        widths[i] = 2.0 * nearest_clear(occupancy, rows[i], cols[i], size, size, limit)
    return widths


@compiled
def have_surface(
    occupancy: UInt64Array,
    rows: Int32Array,
    cols: Int32Array,
    traced: Int32Array,
    pieces: StructuredArray,
    asked: BoolArray,
    step: int,
    size: int,
    limit: int,
    minimum: float,
) -> BoolArray:
    """Return which of the pieces of centerline asked about have enough road around them, (P,) bool.

    Parameters
    ----------
    occupancy, rows, cols, size, limit
        See `widths_at`.
    traced, pieces
        See `trace_branches`.
    asked : (P,) bool
    step : int
        The road around a piece are its pixels times the mean width of every step-th.
    minimum : float
        Pixels.
    """
    enough = np.zeros(pieces.size, np.bool_)
    for i in np.flatnonzero(asked):
        begin, end, total = pieces[i].begin, pieces[i].end, 0.0
        needed = minimum / (end - begin) * ((end - begin + step - 1) // step)  # of the sum of widths
        for p in traced[begin:end:step]:
            total += 2.0 * nearest_clear(occupancy, rows[p], cols[p], size, size, limit)
            if total >= needed:  # the others add to it
                enough[i] = True
                break
    return enough


@compiled
def label_pieces(neighbours: Int32Array, allowed: BoolArray, starts: Int32Array) -> tuple[Int32Array, int]:
    """Label the connected pieces of allowed pixels that hold one of some starts.

    Returns
    -------
    labels : (P,) int32
        Number of the piece from 0 on, in the order of the starts; -1 elsewhere.
    count : int
        Number of pieces.
    """
    labels = np.full(neighbours.shape[0], -1, np.int32)
    stack = np.empty(neighbours.shape[0], np.int32)
    count = 0
    for i in range(starts.size):
        s = starts[i]
        if labels[s] >= 0 or not allowed[s]:
            continue
        labels[s] = count
        stack[0] = s
        top = 1
        while top > 0:
            top -= 1
            p = stack[top]
            for k in range(4):
                q = neighbours[p, k]
                if q >= 0 and allowed[q] and labels[q] < 0:
                    labels[q] = count
                    stack[top] = q
                    top += 1
        count += 1
    return labels, count


@compiled
def grow_from(
    rows: Int32Array, cols: Int32Array, neighbours: Int32Array, sources: Int32Array, reach: FloatArray
) -> BoolArray:
    """Return which pixels lie within the reach of a source along the centerline, (P,) bool.

    Parameters
    ----------
    sources : (S,) int32
    reach : (S,) float64
        Pixels along the centerline, one for each source.
    """
    left = np.full(rows.size, -1.0)
    stack = np.empty(rows.size, np.int32)
    for s in range(sources.size):
        if reach[s] <= left[sources[s]]:
            continue
        left[sources[s]] = reach[s]
        stack[0] = sources[s]
        top = 1
        while top > 0:
            top -= 1
            p = stack[top]
            for k in range(4):
                q = neighbours[p, k]
                if q < 0:
                    continue
                step = 1.0 if rows[p] == rows[q] or cols[p] == cols[q] else np.sqrt(2.0)
                rest = left[p] - step
                if rest > left[q] and rest >= 0.0 and top < stack.size:
                    left[q] = rest
                    stack[top] = q
                    top += 1
    return left >= 0.0


PIECE = np.dtype(
    [
        ("begin", np.int64),  # its pixels are traced[begin:end]
        ("end", np.int64),
        ("start", np.float64, (2,)),  # row and column of its pixel nearest to the candidate
        ("mean", np.float64, (2,)),  # row and column
        ("reach", np.float64),  # greatest distance from the candidate, pixels
        ("at_candidate", np.bool_),  # it ends before another candidate
    ]
)
"""What `trace_branches` returns for each piece."""


@compiled
def trace_branches(
    rows: Int32Array,
    cols: Int32Array,
    neighbours: Int32Array,
    candidate: FloatArray,
    blockers: FloatArray,
    inner: float,
    outer: float,
    stop: float,
) -> tuple[Int32Array, BoolArray, StructuredArray]:
    """Find the connected pieces of centerline between two circles around a candidate that start at the inner one.

    Parameters
    ----------
    rows, cols, neighbours
        The centerline, see `neighbours_of`.
    candidate : (2,) float64
        Row and column of the candidate.
    blockers : (C, 2) float64
        The candidates before which a piece ends.
    inner, outer : float
        Radii of the circles, pixels.
    stop : float
        A piece ends this far before another candidate.

    Returns
    -------
    traced : (N,) int32
        Pixels of all pieces, as positions in ``rows``: piece by piece, each from the inner circle outwards.
    is_main : (N,) bool
        Which of them are on the way to the pixel of their piece that is farthest from the candidate; the others lead
        aside.
    pieces : (P,) PIECE
        In the order of their first pixels in the image.
    """
    n = rows.size
    distance = np.empty(n)
    for i in range(n):
        dr, dc = rows[i] - candidate[0], cols[i] - candidate[1]
        distance[i] = np.sqrt(dr * dr + dc * dc)
    starts = np.empty(n, np.int32)
    n_starts = 0
    for i in range(n):
        if inner < distance[i] < outer:
            for k in range(4):
                q = neighbours[i, k]
                if q >= 0 and distance[q] <= inner:
                    starts[n_starts] = i
                    n_starts += 1
                    break

    seen = np.zeros(n, np.bool_)
    traced = np.empty(n, np.int32)
    came_from = np.empty(n, np.int32)
    is_main = np.zeros(n, np.bool_)
    pieces = np.zeros(n_starts, PIECE)
    count, end = 0, 0
    for s in starts[:n_starts]:
        if seen[s]:
            continue
        here = end
        piece = pieces[count]
        count += 1
        piece.begin = here
        traced[end] = s
        came_from[end] = -1
        end += 1
        seen[s] = True
        first = s
        farthest = here
        while here < end:
            p = traced[here]
            here += 1
            piece.mean[0] += rows[p]
            piece.mean[1] += cols[p]
            if distance[p] > piece.reach:
                piece.reach = distance[p]
                farthest = here - 1
            if distance[p] < distance[first]:
                first = p
            for k in range(4):
                q = neighbours[p, k]
                if q < 0 or seen[q] or not (inner < distance[q] < outer):
                    continue
                blocked = False
                for b in range(blockers.shape[0]):
                    dr, dc = rows[q] - blockers[b, 0], cols[q] - blockers[b, 1]
                    if dr * dr + dc * dc < stop * stop:
                        blocked = True
                if blocked:
                    piece.at_candidate = True
                    continue
                seen[q] = True
                traced[end] = q
                came_from[end] = here - 1
                end += 1
        piece.end = end
        while farthest >= 0:
            is_main[farthest] = True
            farthest = came_from[farthest]
        piece.start[0], piece.start[1] = rows[first], cols[first]
        piece.mean[0] /= end - piece.begin
        piece.mean[1] /= end - piece.begin
    return traced[:end], is_main[:end], pieces[:count]


# Zhang-Suen thinning (Zhang and Suen 1984) of blocks of 16 rows of a word each, and only where pixels change.
#
# A sub-iteration looks at a block again only if a pixel in it or next to it was deleted in the last two: else nothing
# that it decides on has changed since it looked there last. The work grows with the length of the border that is
# peeled off, not with the image, and the result is that of the definition.
#
# The words stand column by column, so that those of a block follow each other, and the compiler does several at once.
# Empty rows above and below each column, and empty columns at the sides, give each block neighbours.

_BLOCK = 16
_SIZE, _ONE, _LAST = np.uint64(_BLOCK), np.uint64(1), np.uint64(63)


@compiled
def _doom(words: UInt64Array, stride: np.uint64, active: UInt64Array, doomed: UInt64Array, is_first: bool) -> None:
    """Write which pixels of some blocks a sub-iteration, the first or the second, deletes.

    ``stride`` leads from a word to the one at its right, and ``active`` holds where the blocks begin.
    """
    for i in range(active.size):
        begin, to = active[i], np.uint64(i) * _SIZE
        for j in range(_BLOCK):
            k = begin + np.uint64(j)
            left, right = k - stride, k + stride
            # The neighbours P2 to P9 of all 64 pixels of a word.
            p1, p2, p6 = words[k], words[k - _ONE], words[k + _ONE]
            p3, p9 = (p2 >> _ONE) | (words[right - _ONE] << _LAST), (p2 << _ONE) | (words[left - _ONE] >> _LAST)
            p4, p8 = (p1 >> _ONE) | (words[right] << _LAST), (p1 << _ONE) | (words[left] >> _LAST)
            p5, p7 = (p6 >> _ONE) | (words[right + _ONE] << _LAST), (p6 << _ONE) | (words[left + _ONE] >> _LAST)
            # A(P1) = 1: exactly one step from clear to set on the way round. Two in a row are never both such steps.
            a = (~p2 & p3) | (~p3 & p4)
            b = (~p4 & p5) | (~p5 & p6)
            c = (~p6 & p7) | (~p7 & p8)
            d = (~p8 & p9) | (~p9 & p2)
            one_step = ((a ^ b) & ~(c | d)) | ((c ^ d) & ~(a | b))
            # B(P1) >= 2: with one step the set neighbours are in a row, so two of them lie side by side.
            two_set = (p2 & (p3 | p9)) | (p4 & (p3 | p5)) | (p6 & (p5 | p7)) | (p8 & (p7 | p9))
            # The products of the sub-iteration; and B(P1) <= 6, which seven miss where the clear one makes both
            # products 0.
            if is_first:
                kept = (p4 & p6 & (p2 | p8)) | (~p4 & p3 & p5) | (~p6 & p5 & p7)
            else:
                kept = (p2 & p8 & (p4 | p6)) | (~p2 & p9 & p3) | (~p8 & p7 & p9)
            doomed[to + np.uint64(j)] = p1 & one_step & two_set & ~kept


@compiled
def thin(words: UInt64Array) -> None:
    """Thin a packed image to its centerline, in place."""
    height, n_words = words.shape[0] - 2, words.shape[1]
    down = (height + _BLOCK - 1) // _BLOCK + 1  # blocks per column, the first one empty
    per_column, beside = down * _BLOCK, np.uint64(down)
    columns = np.zeros((n_words + 2) * per_column + _BLOCK, np.uint64)
    has_pixels = np.zeros(columns.size // _BLOCK, np.bool_)
    for r in range(height):
        for w in range(n_words):
            if words[r + 1, w] != 0:
                k = (w + 1) * per_column + _BLOCK + r
                columns[k] = words[r + 1, w]
                has_pixels[k // _BLOCK] = True
    active = np.empty(has_pixels.size, np.uint64)  # the blocks to look at, each once
    until = np.zeros(has_pixels.size, np.int64)  # the last sub-iteration, counted from 1, that looks at each block
    n_active = 0
    for k in np.flatnonzero(has_pixels):
        active[n_active], until[k] = k, 2
        n_active += 1
    doomed, number = np.empty(n_active * _BLOCK, np.uint64), 0
    while n_active > 0:
        number += 1
        _doom(columns, np.uint64(per_column), active[:n_active] * _SIZE, doomed, number % 2 == 1)  # all at once
        n_known = n_active
        for i in range(n_known):
            k, to = active[i], np.uint64(i) * _SIZE
            gone, rest, begin = np.uint64(0), np.uint64(0), k * _SIZE
            for j in range(_BLOCK):
                lost = doomed[to + np.uint64(j)]
                gone |= lost
                columns[begin + np.uint64(j)] ^= lost
                rest |= columns[begin + np.uint64(j)]
            if gone == 0:
                continue
            has_pixels[k] = rest != 0
            # Only the pixels at its sides have neighbours in the blocks beside.
            top, bottom = k - np.uint64(doomed[to] != 0), k + np.uint64(doomed[to + _SIZE - _ONE] != 0)
            near, last = top - beside * (gone & _ONE), bottom + beside * (gone >> _LAST)
            while near <= last:
                for other in range(near, near + bottom - top + _ONE):
                    active[n_active] = other
                    n_active += (until[other] < number) & has_pixels[other]
                    until[other] = number + 2
                near += beside
        n_known, n_active = n_active, 0
        for k in active[:n_known]:
            active[n_active] = k
            n_active += until[k] > number
    for r in range(height):
        for w in range(n_words):
            if words[r + 1, w] != 0:
                words[r + 1, w] = columns[(w + 1) * per_column + _BLOCK + r]
