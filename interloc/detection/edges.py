"""The axis of a branch between the edges of its road: where these are parallel, and where it leads inwards.

The axis is sampled in steps, from the inner circle of the candidate outwards (`PLACE`). Lines are those of
`interloc.detection.lines.LINE`, a fit is `interloc.detection.lines.FIT`; places and lengths are pixels, directions unit
vectors (row, column).
"""

from __future__ import annotations

import math

import numpy as np

from interloc.arrays import Record, StructuredArray, UInt64Array
from interloc.kernels import compiled

STEP_PX = 4.0  # from one place to the next
SLACK_PX = 1.5  # what an edge, or the axis, may leave the place by where it belongs
SPAN = 6  # steps that tell a direction or a width; an axis is followed over no longer a gap
LASTING_RAD = math.radians(110.0)  # a corner between two roads at this angle is short

PLACE = np.dtype([(name, np.float64) for name in ("row", "col", "n", "half")])
"""A place on the axis of a branch: row and column, number of its pixels (0: not to be trusted), half width there."""


@compiled
def keep_parallel(axis: StructuredArray, words: UInt64Array, reach: float) -> tuple[float, bool]:
    """Keep the places of an axis where the road is as wide as usual; leave it as it is if these are too few.

    Where the road is wider or narrower a mouth opens, or the far edge was not seen. Edges are looked for within
    ``reach`` pixels.

    Returns
    -------
    half : float
        Usual half width of the road, pixels; 0 where none is known.
    is_parallel : bool
        Whether only places between parallel sides are left.
    """
    known = np.flatnonzero(axis["n"] > 0.0)
    if known.size == 0:
        return 0.0, False
    for i in known:
        d_row, d_col = _direction_at(axis, int(i))
        left = to_edge(words, axis[i].row, axis[i].col, -d_col, d_row, reach)
        right = to_edge(words, axis[i].row, axis[i].col, d_col, -d_row, reach)
        axis[i].half = 0.5 * (left + right)
    half: float = np.median(axis["half"][known])
    is_usual = np.abs(axis["half"] - half) <= SLACK_PX
    if half == 0.0 or is_usual[known].sum() < max(0.5 * known.size, SPAN):
        return half, False
    axis["n"][:] *= is_usual
    return half, True


@compiled
def _direction_at(axis: StructuredArray, i: int) -> tuple[float, float]:
    """Return the direction of an axis at one of its places, by those around it."""
    first, last = i, i
    for k in range(max(i - SPAN // 2, 0), min(i + SPAN // 2 + 1, axis.size)):
        if axis[k].n > 0.0:
            first, last = min(first, k), k
    row, col = axis[last].row - axis[first].row, axis[last].col - axis[first].col
    length = max(math.hypot(row, col), 1e-9)
    return row / length, col / length


@compiled
def follow_edge(axis: StructuredArray, lines: StructuredArray, which: int, words: UInt64Array, fit: Record) -> int:
    """Follow the axis of a branch inwards along the edge that stays half a width from it; return its new first place.

    It ends where both edges have turned away, where it has turned back, or where it comes upon the surface of another
    branch.
    """
    line = lines[which]
    first: int = line.first
    half, toward = line.half_width, _lasting_side(lines, which)
    (row, col), (d_row, d_col) = line.point, line.direction
    along = (axis[first].row - row) * d_row + (axis[first].col - col) * d_col
    trail = np.empty((first + SPAN + 1, 2))
    for i in range(first, first + SPAN + 1):
        away = along + (i - first) * STEP_PX
        trail[i, 0], trail[i, 1] = row + away * d_row, col + away * d_col
    misses, shift = 0, 0.0
    for i in range(first - 1, -1, -1):
        u_row, u_col = trail[i + 1, 0] - trail[i + 1 + SPAN, 0], trail[i + 1, 1] - trail[i + 1 + SPAN, 1]
        norm = math.hypot(u_row, u_col)
        u_row, u_col = u_row / norm, u_col / norm
        r, c = trail[i + 1, 0] + STEP_PX * u_row, trail[i + 1, 1] + STEP_PX * u_col
        if u_row * d_row + u_col * d_col > 0.0 or _is_on_other(r, c, lines, which, fit):
            break
        reach = half + SLACK_PX + 1.0
        left = to_edge(words, r, c, -u_col, u_row, reach)
        right = to_edge(words, r, c, u_col, -u_row, reach)
        misses += 1
        if left + right <= 2.0 * half + SLACK_PX:
            shift, misses = 0.5 * (left - right), 0
        elif toward != 0.0:
            # An edge that comes nearer bends with its road; one that draws away opens into a mouth, or has a gap.
            shift = toward * ((left if toward > 0.0 else right) - half)
            if toward * shift <= SLACK_PX:
                misses = 0
        if misses > SPAN:
            break
        shift = 0.0 if misses else min(max(shift, -0.5 * STEP_PX), 0.5 * STEP_PX)
        trail[i, 0], trail[i, 1] = r - shift * u_col, c + shift * u_row
        axis[i].n = 0.0
        if misses == 0:
            axis[i].row, axis[i].col, axis[i].n = trail[i, 0], trail[i, 1], STEP_PX
            first = i
    return first


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
        half = lines[j].half_width if lines[j].is_parallel else 0.5 * fit.width  # a ragged one as the candidate
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
