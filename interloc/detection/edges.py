"""The edges of the road along a branch: whether they are parallel, whether both were seen, where they lead inwards.

A branch is sampled in rings around the intersection, each as the sums over its pixels of the centerline (`MOMENTS`).
Lines are those of `interloc.detection.lines.LINE`, a fit is `interloc.detection.lines.FIT`; places and lengths are
pixels, directions unit vectors (row, column).
"""

from __future__ import annotations

import math

import numpy as np

from interloc.arrays import FloatArray, Record, StructuredArray, UInt64Array
from interloc.kernels import compiled

PARALLEL_SLACK = 0.08  # share of its half width that a branch may differ from it by between parallel sides
ARM_QUANTILE, LINK_QUANTILE = 0.5, 0.25  # of the half widths along a branch: what its own half width is
MIN_PARALLEL, MIN_PARALLEL_RINGS = 0.5, 6  # a branch with less of it between parallel sides is taken as it is
REACH = 4  # rings before and behind one that show the direction of its road
AT_EDGE_PX = 1.0  # an edge was seen if other ground begins so near to it: rounding moves it by as much
MIN_SEEN_RINGS = 6  # of which both edges were seen: fewer do not tell how wide a branch is
LAG = 6  # rings behind that an axis followed inwards takes its direction from
MAX_MISSES = 4  # rings without an edge that it crosses straight on
MAX_SHIFT = 0.375  # what it may move sideways in a ring, as a share of the ring
LASTING_RAD = math.radians(110.0)  # a corner between two roads at this angle is short

MOMENTS = np.dtype([(name, np.float64) for name in ("n", "r", "c", "rr", "rc", "cc")])
"""Sums over pixels: their number, rows, columns, and the products of these."""


@compiled
def add(sums: Record, r: float, c: float, n: float) -> None:
    """Add a place to sums, as so many pixels."""
    sums.n += n
    sums.r += n * r
    sums.c += n * c
    sums.rr += n * r * r
    sums.rc += n * r * c
    sums.cc += n * c * c


@compiled
def move_from_unseen_edges(
    rings: StructuredArray, half_widths: FloatArray, words: UInt64Array, against: UInt64Array, fit: Record
) -> bool:
    """Lay the rings of which one edge was not seen half a width inside the other; enter that into ``half_widths``.

    Returns whether there are any, and so many of which both edges were seen that the width is known.
    """
    if against.size == 0:
        return False
    edges = np.zeros((rings.size, 2))  # distances to the edge on the left and on the right, seen outwards
    lefts = np.zeros((rings.size, 2))  # unit vectors
    seen = np.zeros((rings.size, 2), np.bool_)
    between, count = np.empty(rings.size), 0
    for i in range(rings.size):
        u_row, u_col = _direction_at(rings, i)
        if u_row == 0.0 and u_col == 0.0:
            continue
        lefts[i, 0], lefts[i, 1] = -u_col, u_row
        r, c = fit.row + rings[i].r / rings[i].n, fit.col + rings[i].c / rings[i].n
        clear = max(half_widths[i] - fit.ring, 0.0)  # no edge is nearer: a pixel of the ring lies in its middle
        for side in range(2):
            d_row, d_col = (-u_col, u_row) if side == 0 else (u_col, -u_row)
            edge = clear + to_edge(words, r + clear * d_row, c + clear * d_col, d_row, d_col, fit.max_half_width)
            edges[i, side] = edge
            seen[i, side] = _is_seen(against, r, c, d_row, d_col, edge)
        if seen[i, 0] and seen[i, 1]:
            between[count] = 0.5 * (edges[i, 0] + edges[i, 1])
            count += 1
    if count < MIN_SEEN_RINGS:
        return False
    half = np.median(between[:count])
    is_any = False
    for i in range(rings.size):
        unseen = 2.0 * half - edges[i, 0] - edges[i, 1]
        if seen[i, 0] != seen[i, 1] and fit.slack < unseen < fit.unseen * half:
            shift = edges[i, 0] - half if seen[i, 0] else half - edges[i, 1]
            _move(rings[i], shift * lefts[i, 0], shift * lefts[i, 1])
            half_widths[i] = half
            is_any = True
    return is_any


@compiled
def _direction_at(rings: StructuredArray, i: int) -> tuple[float, float]:
    """Return the unit direction of a branch at one of its rings, outwards; 0 where it is not known."""
    if rings[i].n == 0.0:
        return 0.0, 0.0
    before, behind = i, i
    for k in range(max(i - REACH, 0), i):
        if rings[k].n > 0.0:
            before = k
            break
    for k in range(min(i + REACH, rings.size - 1), i, -1):
        if rings[k].n > 0.0:
            behind = k
            break
    row = rings[behind].r / rings[behind].n - rings[before].r / rings[before].n
    col = rings[behind].c / rings[behind].n - rings[before].c / rings[before].n
    length = np.sqrt(row * row + col * col)
    if length == 0.0:
        return 0.0, 0.0
    return row / length, col / length


@compiled
def _is_seen(against: UInt64Array, r: float, c: float, d_row: float, d_col: float, edge: float) -> bool:
    """Return whether other ground begins at the edge that lies so far from a place in a direction."""
    size = against.shape[0] - 2
    distance = edge - AT_EDGE_PX
    while distance <= edge + AT_EDGE_PX:
        row, col = round(r + distance * d_row), round(c + distance * d_col)
        if row < 0 or col < 0 or row >= size or col >= size:
            return False
        if (against[row + 1, col >> 6] >> np.uint64(col & 63)) & np.uint64(1) != 0:
            return True
        distance += 0.5
    return False


@compiled
def _move(sums: Record, row: float, col: float) -> None:
    """Move the pixels that were summed up by so many rows and columns."""
    sums.rr += 2.0 * row * sums.r + sums.n * row * row
    sums.rc += row * sums.c + col * sums.r + sums.n * row * col
    sums.cc += 2.0 * col * sums.c + sums.n * col * col
    sums.r += sums.n * row
    sums.c += sums.n * col


@compiled
def usual_half_width(half_widths: FloatArray, is_link: bool) -> float:
    """Return the half width that a branch has along most of it, pixels; 0 where none is known."""
    known = np.sort(half_widths[half_widths > 0.0])
    if known.size == 0:
        return 0.0
    # Both ends of a road between two junctions open into mouths.
    half: float = known[int((LINK_QUANTILE if is_link else ARM_QUANTILE) * (known.size - 1))]
    return half


@compiled
def keep_parallel(rings: StructuredArray, half_widths: FloatArray, is_link: bool, fit: Record) -> float:
    """Empty the rings where the road is wider or narrower than the branch is.

    Returns its half width, pixels; 0 where too little of it is between parallel sides, and nothing was emptied.
    """
    half = usual_half_width(half_widths, is_link)
    slack = max(fit.slack, PARALLEL_SLACK * half)
    is_parallel = (half_widths > 0.0) & (np.abs(half_widths - half) <= slack)
    if is_parallel.sum() < max(MIN_PARALLEL * np.count_nonzero(half_widths), MIN_PARALLEL_RINGS):
        return 0.0  # its edges are too ragged to tell
    for i in range(rings.size):
        if not is_parallel[i]:
            rings[i].n = 0.0
    return half


@compiled
def follow_edge(
    rings: StructuredArray,
    lines: StructuredArray,
    which: int,
    words: UInt64Array,
    against: UInt64Array,
    fit: Record,
) -> int:
    """Follow the axis of a branch inwards along the edge that stays half a width from it; return the new first ring.

    It ends where both edges have turned away, or where the axis comes upon the surface of another branch.
    """
    line = lines[which]
    first: int = line.first
    half, slack, step, max_shift = line.parallel, fit.slack, fit.ring, MAX_SHIFT * fit.ring
    toward = _lasting_side(lines, which)
    ring = rings[first]
    along = (fit.row + ring.r / ring.n - line.point[0]) * line.direction[0]
    along += (fit.col + ring.c / ring.n - line.point[1]) * line.direction[1]
    trail = np.empty((first + LAG + 1, 2))
    for k in range(LAG + 1):
        ahead = along + (LAG - k) * step
        trail[k, 0] = line.point[0] + ahead * line.direction[0]
        trail[k, 1] = line.point[1] + ahead * line.direction[1]
    half = _half_width_along(words, against, line, trail[: LAG + 1], half, slack)
    at, misses, shift = LAG, 0, 0.0
    for i in range(first - 1, -1, -1):
        u_row, u_col = trail[at, 0] - trail[at - LAG, 0], trail[at, 1] - trail[at - LAG, 1]
        norm = np.sqrt(u_row * u_row + u_col * u_col)
        u_row, u_col = u_row / norm, u_col / norm
        if -(u_row * line.direction[0] + u_col * line.direction[1]) < fit.follow_cos:
            break
        r, c = trail[at, 0] + step * u_row, trail[at, 1] + step * u_col
        if _is_on_other(r, c, lines, which, fit):
            break
        reach = half + slack + 1.0
        left = to_edge(words, r, c, -u_col, u_row, reach)
        right = to_edge(words, r, c, u_col, -u_row, reach)
        misses += 1
        if left + right <= 2.0 * half + slack:
            shift, misses = 0.5 * (left - right), 0
        elif toward != 0.0:
            # An edge that comes nearer bends with its road; one that draws away opens into a mouth, or has a gap.
            shift = toward * ((left if toward > 0.0 else right) - half)
            if toward * shift <= slack:
                misses = 0
        if misses > MAX_MISSES:
            break
        shift = 0.0 if misses else min(max(shift, -max_shift), max_shift)
        r, c = r - shift * u_col, c + shift * u_row
        at += 1
        trail[at, 0], trail[at, 1] = r, c
        rings[i].n = 0.0
        if misses:
            continue
        rings[i].r = rings[i].c = rings[i].rr = rings[i].rc = rings[i].cc = 0.0
        add(rings[i], r - fit.row, c - fit.col, step)
        first = i
    return first


@compiled
def _half_width_along(
    words: UInt64Array, against: UInt64Array, line: Record, places: FloatArray, half: float, slack: float
) -> float:
    """Return the half width between the edges at some places of a line; ``half`` where they are ragged or not seen."""
    slack = max(2.0 * slack, PARALLEL_SLACK * half)
    reach = half + slack + 1.0
    d_row, d_col = line.direction[1], -line.direction[0]
    total, count = 0.0, 0
    for r, c in places:
        left, right = to_edge(words, r, c, d_row, d_col, reach), to_edge(words, r, c, -d_row, -d_col, reach)
        if abs(left + right - 2.0 * half) > slack:
            continue
        if against.size > 0 and not (
            _is_seen(against, r, c, d_row, d_col, left) and _is_seen(against, r, c, -d_row, -d_col, right)
        ):
            continue
        total += 0.5 * (left + right)
        count += 1
    return total / count if count >= LAG // 2 else half


@compiled
def _lasting_side(lines: StructuredArray, which: int) -> float:
    """Return on which side of a branch, seen inwards, its edge lasts the longest: 1 left, -1 right, 0 on neither.

    A corner between two roads is rounded over r / tan(t / 2), with the angle t between them: the edge lasts on the side
    where the next branch is far round.
    """
    d_row, d_col = lines[which].direction
    left, right = 2.0 * np.pi, 2.0 * np.pi
    for j in range(lines.size):
        if j != which and lines[j].length > 0.0:
            o_row, o_col = lines[j].direction
            angle = np.arctan2(d_col * o_row - d_row * o_col, d_row * o_row + d_col * o_col) % (2.0 * np.pi)
            left, right = min(left, angle), min(right, 2.0 * np.pi - angle)
    if max(left, right) < LASTING_RAD:
        return 0.0
    return 1.0 if left > right else -1.0


@compiled
def _is_on_other(r: float, c: float, lines: StructuredArray, which: int, fit: Record) -> bool:
    """Return whether a place lies on the surface of another branch, prolonged to the candidate."""
    for j in range(lines.size):
        if j == which or lines[j].length == 0.0:
            continue
        d_row, d_col = lines[j].direction
        across = (r - lines[j].point[0]) * d_col - (c - lines[j].point[1]) * d_row
        along = (r - fit.row) * d_row + (c - fit.col) * d_col
        half = lines[j].parallel if lines[j].parallel > 0.0 else 0.5 * fit.width  # a ragged one as the candidate
        if abs(across) < half and along > 0.0:
            return True
    return False


@compiled
def to_edge(words: UInt64Array, r: float, c: float, d_row: float, d_col: float, reach: float) -> float:
    """Return the distance from a place to the edge of the road in a direction, pixels; ``reach`` at most."""
    size = words.shape[0] - 2
    distance = 0.0
    while distance < reach:
        row, col = round(r + distance * d_row), round(c + distance * d_col)
        if row < 0 or col < 0 or row >= size or col >= size:
            return reach
        if (words[row + 1, col >> 6] >> np.uint64(col & 63)) & np.uint64(1) == 0:
            return distance
        distance += 0.5
    return reach
