"""The edges of the road along a branch: whether they are parallel, whether both were seen, where they lead inwards.

The axis of a branch is sampled in rings around the intersection (`PLACE`). Lines are those of
`interloc.detection.lines.LINE`, a fit is `interloc.detection.lines.FIT`; places and lengths are pixels, directions unit
vectors (row, column).
"""

import math

import numpy as np

from interloc.arrays import FloatArray, Record, StructuredArray, UInt64Array
from interloc.kernels import compiled

RING_M, RING_PX = 0.64, 4.0  # from one place of an axis to the next; and no less, however coarse the grid is
SLACK_M, SLACK_PX = 0.24, 1.5  # what an edge, an axis in a ring, or a straight branch (root mean square) may lie off by
SLACK_SHARE = 0.08  # of a half width: the same for wide roads
ARM_QUANTILE, LINK_QUANTILE = 0.5, 0.25  # of the half widths along a branch: what its own half width is
MIN_PARALLEL = 0.5  # a branch with less of it between parallel sides is taken as it is
SPAN = 6  # rings that tell a direction or a width
GAP = 4  # rings over which a road is taken for straight: before and behind one, and where no edge is found
UNSEEN_SHARE = 0.6  # of a half width that may be missing at an edge that was not seen
LASTING_RAD = math.radians(110.0)  # a corner between two roads at this angle is short

PLACE = np.dtype([(name, np.float64) for name in ("row", "col", "n", "rr", "rc", "cc", "half")])
"""A place on the axis of a branch: row and column, number of its pixels (0: not to be trusted), sums over them of the
products of what they lie off by, and the half width of the road."""


@compiled
def keep_parallel(axis: StructuredArray, is_link: bool, slack: float) -> tuple[float, bool]:
    """Keep the places of an axis where the road is as wide as the branch is; all of them where these are too few.

    Returns
    -------
    half : float
        Usual half width of the branch, pixels; 0 where none is known.
    is_parallel : bool
        Whether only places between parallel sides are left; else its edges are too ragged to tell.
    """
    known = np.sort(axis["half"][axis["half"] > 0.0])
    if known.size == 0:
        return 0.0, False
    # Both ends of a road between two junctions open into mouths.
    half: float = known[int((LINK_QUANTILE if is_link else ARM_QUANTILE) * (known.size - 1))]
    is_usual = (axis["half"] > 0.0) & (np.abs(axis["half"] - half) <= max(slack, SLACK_SHARE * half))
    if is_usual.sum() < max(MIN_PARALLEL * known.size, SPAN):
        return half, False
    axis["n"][:] *= is_usual
    return half, True


@compiled
def move_from_unseen_edges(axis: StructuredArray, words: UInt64Array, against: UInt64Array, fit: Record) -> bool:
    """Lay the places of which one edge was not seen half a width inside the other.

    Returns whether there are any, and so many of which both edges were seen that the width is known.
    """
    edges, lefts = np.zeros((axis.size, 2)), np.zeros((axis.size, 2))
    seen = np.zeros((axis.size, 2), np.bool_)
    for i in np.flatnonzero(axis["n"] > 0.0):
        u_row, u_col = _direction_at(axis, int(i))
        left, right = edges_across(words, axis[i].row, axis[i].col, u_row, u_col, fit.max_half_width)
        seen[i] = are_seen(against, axis[i].row, axis[i].col, u_row, u_col, left, right)
        edges[i], lefts[i] = (left, right), (-u_col, u_row)
    both = seen[:, 0] & seen[:, 1]
    if both.sum() < SPAN:
        return False
    half = np.median(0.5 * (edges[both, 0] + edges[both, 1]))
    missing = 2.0 * half - edges[:, 0] - edges[:, 1]
    hidden = (seen[:, 0] != seen[:, 1]) & (missing > fit.slack) & (missing < UNSEEN_SHARE * half)
    for i in np.flatnonzero(hidden):
        shift = edges[i, 0] - half if seen[i, 0] else half - edges[i, 1]
        axis[i].row += shift * lefts[i, 0]
        axis[i].col += shift * lefts[i, 1]
        axis[i].half = half
    return bool(hidden.any())


@compiled
def _direction_at(axis: StructuredArray, i: int) -> tuple[float, float]:
    """Return the direction of an axis at one of its places, outwards, by those around it."""
    first, last = i, i
    for k in range(max(i - GAP, 0), min(i + GAP + 1, axis.size)):
        if axis[k].n > 0.0:
            first, last = min(first, k), k
    row, col = axis[last].row - axis[first].row, axis[last].col - axis[first].col
    length = max(math.hypot(row, col), 1e-9)
    return row / length, col / length


@compiled
def follow_edge(
    axis: StructuredArray,
    line: Record,
    lines: StructuredArray,
    which: int,
    words: UInt64Array,
    against: UInt64Array,
    fit: Record,
) -> int:
    """Follow the axis of a branch inwards along the edge that stays half a width from it; return its new first place.

    ``line`` is that of the branch, bent where it bends; ``lines`` are the straight ones of all branches. A bend goes on
    inwards. The axis ends where both edges have turned away, where it has turned back, or where it comes upon the
    surface of another branch.
    """
    first: int = line.first
    (row, col), (d_row, d_col) = line.point, line.direction
    toward, step, slack = _lasting_side(lines, which, d_row, d_col), fit.ring, fit.slack
    along = (axis[first].row - row) * d_row + (axis[first].col - col) * d_col
    trail = np.empty((first + 2 * SPAN + 1, 2))
    for i in range(first, first + 2 * SPAN + 1):
        away = along + (i - first) * step
        aside = line.bend * away * away
        trail[i] = row + away * d_row + aside * d_col, col + away * d_col - aside * d_row
    half = _half_width_along(words, against, line, trail[first : first + SPAN + 1], slack)
    misses, shift = 0, 0.0
    for i in range(first - 1, -1, -1):
        u_row, u_col = trail[i + 1] - trail[i + 1 + SPAN]
        norm = math.hypot(u_row, u_col)
        u_row, u_col = u_row / norm, u_col / norm
        if line.bend != 0.0:  # it turns on as between the middles of the last two spans
            v_row, v_col = trail[i + 1 + SPAN] - trail[i + 1 + 2 * SPAN]
            turn = math.atan2(v_row * u_col - v_col * u_row, v_row * u_row + v_col * u_col) * (0.5 + 0.5 / SPAN)
            cos, sin = math.cos(turn), math.sin(turn)
            u_row, u_col = u_row * cos - u_col * sin, u_row * sin + u_col * cos
            toward = _lasting_side(lines, which, -u_row, -u_col)
        r, c = trail[i + 1, 0] + step * u_row, trail[i + 1, 1] + step * u_col
        if u_row * d_row + u_col * d_col > 0.0 or _is_on_other(r, c, lines, which, fit):
            break
        left, right = edges_across(words, r, c, u_row, u_col, half + slack + 1.0)
        misses += 1
        if left + right <= 2.0 * half + slack:
            shift, misses = 0.5 * (left - right), 0
        elif toward != 0.0:
            # An edge that comes nearer bends with its road; one that draws away opens into a mouth, or has a gap.
            shift = toward * ((left if toward > 0.0 else right) - half)
            if toward * shift <= slack:
                misses = 0
        if misses > GAP:
            break
        shift = 0.0 if misses else min(max(shift, -slack), slack)
        trail[i] = r - shift * u_col, c + shift * u_row
        axis[i].n = 0.0
        if misses == 0:
            axis[i].row, axis[i].col, axis[i].n = trail[i, 0], trail[i, 1], step
            axis[i].rr = axis[i].rc = axis[i].cc = 0.0
            first = i
    return first


@compiled
def _half_width_along(
    words: UInt64Array, against: UInt64Array, line: Record, places: FloatArray, slack: float
) -> float:
    """Return the half width between the edges at some places of a line; its usual one where few of them were seen."""
    half, (d_row, d_col) = line.half_width, line.direction
    limit = max(2.0 * slack, SLACK_SHARE * half)
    total, count = 0.0, 0
    for r, c in places:
        left, right = edges_across(words, r, c, d_row, d_col, half + limit + 1.0)
        is_left, is_right = are_seen(against, r, c, d_row, d_col, left, right)
        if is_left and is_right and abs(left + right - 2.0 * half) <= limit:
            total += 0.5 * (left + right)
            count += 1
    return total / count if count >= SPAN // 2 else half


@compiled
def _lasting_side(lines: StructuredArray, which: int, d_row: float, d_col: float) -> float:
    """Return on which side of a branch, seen inwards, its edge lasts the longest: 1 left, -1 right, 0 on neither.

    The direction is the one in which it leads outwards there.

    A corner between two roads is rounded over r / tan(t / 2), with the angle t between them: the edge lasts on the side
    where the next branch is far round.
    """
    left, right = 2.0 * np.pi, 2.0 * np.pi
    for j in range(lines.size):
        if j != which and lines[j].length > 0.0:
            o_row, o_col = lines[j].direction
            angle = math.atan2(d_col * o_row - d_row * o_col, d_row * o_row + d_col * o_col) % (2.0 * np.pi)
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
def edges_across(
    words: UInt64Array, r: float, c: float, u_row: float, u_col: float, reach: float
) -> tuple[float, float]:
    """Return how far the left and the right edge of a road are from a place, seen in a direction; at most ``reach``."""
    left = first_along(words, r, c, -u_col, u_row, 0.0, reach, False)
    return left, first_along(words, r, c, u_col, -u_row, 0.0, reach, False)


@compiled
def are_seen(
    against: UInt64Array, r: float, c: float, u_row: float, u_col: float, left: float, right: float
) -> tuple[bool, bool]:
    """Return whether other ground begins at these edges, give or take a pixel of rounding: then they were seen."""
    if against.size == 0:
        return True, True
    is_left = first_along(against, r, c, -u_col, u_row, left - 1.0, left + 1.5, True) < left + 1.5
    return is_left, first_along(against, r, c, u_col, -u_row, right - 1.0, right + 1.5, True) < right + 1.5


@compiled
def first_along(
    words: UInt64Array, r: float, c: float, d_row: float, d_col: float, begin: float, end: float, is_set: bool
) -> float:
    """Return where along a direction the first pixel is set, or clear; ``end`` where none is, or the image ends."""
    size = words.shape[0] - 2
    distance = begin
    while distance < end:
        row, col = round(r + distance * d_row), round(c + distance * d_col)
        if row < 0 or col < 0 or row >= size or col >= size:
            return end
        if ((words[row + 1, col >> 6] >> np.uint64(col & 63)) & np.uint64(1) != 0) == is_set:
            return distance
        distance += 0.5
    return end
