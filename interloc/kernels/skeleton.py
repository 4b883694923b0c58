"""The centerline as a graph of pixels: neighbours, spurs, distances along it.

Two pixels are joined side by side, or diagonally where no third pixel joins them side by side. A corner of a staircase
then has two neighbours like any other pixel of a line, and a pixel with three or more is a junction. (Counting 8-
neighbours takes corners for junctions; the crossing number misses a junction of four lines at a block of 2 x 2 pixels.)
"""

from __future__ import annotations

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, UInt64Array
from interloc.kernels._compile import compiled
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
    n_rows, n_words = words.shape
    flat = words.reshape(-1)
    before = np.zeros(n_rows * n_words, np.int32)  # set pixels before each word: the position of a pixel in the list
    total = 0
    for w in range(flat.size):
        before[w] = total
        if flat[w] != 0:
            total += popcount(flat[w])
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
            length, count, last, here = 0.0, 0, -1, tip
            junction = -1
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


# Columns of what `follow_branches` returns for each branch; rows and columns of the image in pixels.
START_ROW, START_COL, MEAN_ROW, MEAN_COL, LENGTH, AT_CANDIDATE = range(6)
FIT_ROW, FIT_COL, FIT_D_ROW, FIT_D_COL, FIT_LENGTH, FIT_RMS, REACH, WEIGHT, FIT_START = range(6, 15)
BRANCH_COLUMNS = 15

RING_PX = 4.0  # a line grows by this much at a time
GRID_PX = 0.4  # scatter that the grid gives to the centerline of an ideal road
PIXEL_PX = 0.1  # how well its line is known


@compiled
def follow_branches(
    rows: Int32Array,
    cols: Int32Array,
    neighbours: Int32Array,
    candidate: FloatArray,
    others: FloatArray,
    width: float,
    inner: float,
    outer: float,
    stop: float,
    fit_length: float,
    least_fit: float,
    full_fit: float,
    straight: float,
    trim: float,
    size: int,
    border: int,
) -> FloatArray:
    """Find the pieces of centerline that leave the inner circle around a candidate, and measure each.

    Parameters
    ----------
    rows, cols, neighbours
        The centerline, see `neighbours_of`.
    candidate : (2,) float64
        Row and column of the candidate.
    others : (C, 2) float64
        Those before which a branch ends.
    width, inner, outer : float
        Road width and radii of the annulus, pixels.
    stop : float
        A branch ends this far before another candidate.
    fit_length, least_fit, full_fit, straight, trim : float
        The line is fitted to pixels within ``inner`` + ``fit_length`` of the candidate that lie at least ``trim`` from
        a tip of the branch and from the border of the image; beyond ``least_fit`` only as far as their root mean
        square distance from the line stays within ``straight``. Its weight is its length, as far as ``full_fit``
        counts, over its variance.
    size, border : int
        Pixels per side of the image; width of the margin that counts as its border.

    Returns
    -------
    (B, BRANCH_COLUMNS) float64
        See the names of the columns above. The fitted line is given by a point and a unit direction away from the
        candidate; its length and weight are 0 where there is too little to fit.
    """
    n = rows.size
    r0, c0 = candidate[0], candidate[1]
    distance = np.empty(n)
    for i in range(n):
        dr, dc = rows[i] - r0, cols[i] - c0
        distance[i] = np.sqrt(dr * dr + dc * dc)
    seen = np.zeros(n, np.bool_)
    stack = np.empty(n, np.int32)
    tips = np.empty(64, np.int32)
    branches = np.zeros((32, BRANCH_COLUMNS))
    n_rings = max(1, int(fit_length / RING_PX))
    rings = np.zeros((branches.shape[0], n_rings, 6))
    sums = np.empty(6)
    count = 0
    for s in range(n):
        if seen[s] or not (inner < distance[s] < outer) or count == branches.shape[0]:
            continue
        starts = False
        for k in range(4):
            q = neighbours[s, k]
            if q >= 0 and distance[q] <= inner:
                starts = True
        if not starts:
            continue
        # Collect the piece.
        top, end = 0, 1
        stack[0] = s
        seen[s] = True
        at_candidate = False
        n_tips = 0
        first = s
        sum_r, sum_c, reach = 0.0, 0.0, 0.0
        while top < end:
            p = stack[top]
            top += 1
            sum_r += rows[p]
            sum_c += cols[p]
            reach = max(reach, distance[p])
            if distance[p] < distance[first]:
                first = p
            onward = 0
            for k in range(4):
                q = neighbours[p, k]
                if q < 0:
                    continue
                if seen[q] or not (inner < distance[q] < outer):
                    onward += 1
                    continue
                blocked = False
                for o in range(others.shape[0]):
                    dr, dc = rows[q] - others[o, 0], cols[q] - others[o, 1]
                    if dr * dr + dc * dc < stop * stop:
                        blocked = True
                onward += 1
                if blocked:
                    at_candidate = True
                    continue
                seen[q] = True
                stack[end] = q
                end += 1
            near_border = min(rows[p], cols[p], size - 1 - rows[p], size - 1 - cols[p]) < border
            if onward <= 1 and not near_border and n_tips < tips.size:
                tips[n_tips] = p
                n_tips += 1
        row = branches[count]
        row[START_ROW], row[START_COL] = rows[first], cols[first]
        row[MEAN_ROW], row[MEAN_COL] = sum_r / end, sum_c / end
        row[LENGTH], row[AT_CANDIDATE], row[REACH] = end, at_candidate, reach
        # Moments of its trustworthy part, ring by ring from the inner circle outwards.
        for j in range(end):
            p = stack[j]
            ring = int((distance[p] - inner) / RING_PX)
            if ring >= n_rings:
                continue
            margin = min(rows[p], cols[p], size - 1 - rows[p], size - 1 - cols[p])
            usable = margin >= trim
            for t in range(n_tips):
                dr, dc = rows[p] - rows[tips[t]], cols[p] - cols[tips[t]]
                if dr * dr + dc * dc < trim * trim:
                    usable = False
            if not usable:
                continue
            dr, dc = rows[p] - r0, cols[p] - c0
            rings[count, ring, 0] += 1.0
            rings[count, ring, 1] += dr
            rings[count, ring, 2] += dc
            rings[count, ring, 3] += dr * dr
            rings[count, ring, 4] += dr * dc
            rings[count, ring, 5] += dc * dc
        count += 1

    # Lay a line through each branch, from where its neighbours do not bend it any more, as long as it is straight.
    for i in range(count):
        row = branches[i]
        start = int(max(_wedge(branches, i, count, r0, c0, width) - inner, 0.0) / RING_PX)
        sums[:] = 0.0
        first_ring = -1
        for ring in range(min(start, n_rings - 1), n_rings):
            if rings[i, ring, 0] == 0.0:
                continue
            if first_ring < 0:
                first_ring = ring
            for k in range(6):
                sums[k] += rings[i, ring, k]
            m = sums[0]
            if m < 2.0:
                continue
            ur, uc = sums[1] / m, sums[2] / m
            vrr, vrc, vcc = sums[3] / m - ur * ur, sums[4] / m - ur * uc, sums[5] / m - uc * uc
            angle = 0.5 * np.arctan2(2.0 * vrc, vrr - vcc)
            d_row, d_col = np.cos(angle), np.sin(angle)
            rms = np.sqrt(max(vrr * d_col * d_col - 2.0 * vrc * d_row * d_col + vcc * d_row * d_row, 0.0))
            length = (ring + 1 - first_ring) * RING_PX
            if rms > straight and length > least_fit:
                break
            if d_row * ur + d_col * uc < 0.0:
                d_row, d_col = -d_row, -d_col
            row[FIT_ROW], row[FIT_COL] = r0 + ur, c0 + uc
            row[FIT_D_ROW], row[FIT_D_COL] = d_row, d_col
            row[FIT_START], row[FIT_LENGTH], row[FIT_RMS] = inner + first_ring * RING_PX, length, rms

    # A short branch may look straight by chance: it is not better known than the others around it.
    common, total = 0.0, 0.0
    for i in range(count):
        scatter = max(branches[i, FIT_RMS] - GRID_PX, 0.0)
        common += branches[i, FIT_LENGTH] * scatter * scatter
        total += branches[i, FIT_LENGTH]
    for i in range(count):
        row = branches[i]
        if row[FIT_LENGTH] > 0.0:
            scatter = max(row[FIT_RMS] - GRID_PX, 0.0)
            variance = 0.5 * (scatter * scatter + common / total) + PIXEL_PX * PIXEL_PX
            variance *= _spread(row[FIT_START], row[FIT_LENGTH])
            row[WEIGHT] = min(row[FIT_LENGTH], full_fit) / full_fit / variance
    return branches[:count]


@compiled
def _spread(start: float, length: float) -> float:
    """Return by how much the variance of a fitted line grows where it is prolonged back to the candidate."""
    far = (start + 0.5 * length) / length
    return 1.0 + 12.0 * far * far


@compiled
def _wedge(branches: FloatArray, which: int, count: int, r0: float, c0: float, width: float) -> float:
    """Return how far from the candidate the surface of a branch parts from that of its nearest neighbour, pixels.

    Two roads of width w at an angle t part at (w / 2) / sin(t / 2); the centerline is bent until there.
    """
    least = np.pi
    r, c = branches[which, MEAN_ROW] - r0, branches[which, MEAN_COL] - c0
    for i in range(count):
        if i != which:
            ri, ci = branches[i, MEAN_ROW] - r0, branches[i, MEAN_COL] - c0
            least = min(least, abs(np.arctan2(r * ci - c * ri, r * ri + c * ci)))
    distance: float = 0.5 * width / max(np.sin(0.5 * least), 0.25)
    return distance
