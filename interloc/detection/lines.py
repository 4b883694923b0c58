"""The straight lines that stand for branches, and how well each is known.

The paper lays a line through the start of a branch and its mean. But a centerline does not run straight into an
intersection: it is bent as far as the surfaces of its roads overlap, it leans where the road ends, leaves the window or
was seen in passing, and roads bend further out. So the preset `default` fits a line to the part that can be trusted:

1. Pixels near a dead end of the branch or near the border of the image are left out (`trim_m`), and so are those where
   the road is wider or narrower than the branch is: there a mouth opens, or an edge was not seen (`_keep_parallel`).
   Where other ground begins at one edge only, the other one was not seen: a parked car or the kerb of a median hid the
   road. There the axis lies half a width inside the edge that was seen, with the width between edges that both were
   (`_move_from_unseen_edges`). Of the two lines, with and without that, the one counts that is known better.
2. From where its sides are parallel the axis is followed inwards along the edge that goes on, half a width from it: at
   an acute mouth or a rounded corner one edge turns away long before the other (`_follow_edge`). A branch whose edges
   are too ragged to tell stays as it is.
3. The line begins there and takes in more of the branch, ring by ring, as long as the branch is straight
   (`straight_m`, `fit_length_m`); of these parts that one counts whose line is known best where the roads meet: a
   longer part would lean towards a bend. A line that nearer road of the same branch lies off has no weight: it is what
   follows a bend (`_is_beyond_bend`).
4. Two branches that together lie on one circle, and much better so than each on its line, are one road that bends
   through the intersection (the arms of a roundabout): their lines are its tangent there (`_join_bends`).
5. A line weighs the inverse of its variance where the roads meet, which grows with the distance from what it was
   fitted to (`_weigh`, and `interloc.detection.refinement`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, IntArray, Record, StructuredArray, UInt64Array
from interloc.config import BranchConfig
from interloc.detection.centerline import Centerline
from interloc.detection.image import BinaryImage
from interloc.kernels import compiled
from interloc.kernels.bits import nearest_clear

RING_M = 0.64  # a line grows by this much at a time
LEAST_RING_PX = 4.0  # and by no less, however coarse the grid is
GRID_PX = 0.4  # scatter that the grid gives to the centerline of an ideal road
PIXEL_PX = 0.1  # how well the line of an ideal road is known
INNER_RINGS = 40  # rings that an axis is followed inwards at most, within the inner circle

PARALLEL_SLACK = 0.08  # share of its half width that a branch may differ from it by between parallel sides
SLACK_M, LEAST_SLACK_PX = 0.24, 1.5  # at least; and what an edge may leave the place by where it belongs
ARM_QUANTILE, LINK_QUANTILE = 0.5, 0.25  # of the half widths along a branch: what its own half width is
MIN_PARALLEL, MIN_PARALLEL_RINGS = 0.5, 6  # a branch with less of it between parallel sides is taken as it is
REACH = 4  # rings before and behind one that show the direction of its road
AT_EDGE_PX = 1.0  # an edge was seen if other ground begins so near to it: rounding moves it by as much
MIN_SEEN_RINGS = 6  # of which both edges were seen: fewer do not tell how wide a branch is
MAX_UNSEEN = 0.6  # of a half width may not be seen: where more is missing, it may be another road
SIDE_BY_SIDE_COS = math.cos(math.radians(10.0))  # of two roads that do not meet there: two carriageways
LAG = 6  # rings behind that an axis followed inwards takes its direction from
MAX_MISSES = 4  # rings without an edge that it crosses straight on
MAX_SHIFT = 0.375  # what it may move sideways in a ring, as a share of the ring
LASTING_RAD = math.radians(110.0)  # a corner between two roads at this angle is short
MAX_TURN_COS = 0.5  # it does not turn by more than 60 degrees

BEND_SHARE = 0.6  # of the distances of two branches from their lines: what those from one circle must be below
BEND_RINGS = 6  # that each of the two must have


class Lines(NamedTuple):
    """A line for each branch.

    Attributes
    ----------
    points : (B, 2) float64
        Row and column of a point on each line, pixels.
    directions : (B, 2) float64
        Unit direction (row, column), away from the candidate.
    weights : (B,) float64
        How much each line counts: 1 in the paper, else the inverse of its variance at the candidate, 1 / m^2; 0 for a
        branch that is too short to show its direction.
    spans : (B,) float64
        Length of the part that each line was fitted to, pixels, around its point; infinite in the paper, where lines
        are as well known everywhere.
    bends : (B, 2) float64
        From where each line touches its road towards the centre of the circle that the road bends on: unit direction
        (row, column) over the radius, 1 / pixels; 0 for a straight one.
    """

    points: FloatArray
    directions: FloatArray
    weights: FloatArray
    spans: FloatArray
    bends: FloatArray


def through_start_and_mean(pieces: StructuredArray) -> Lines:
    """Lay a line through the start and the mean of each piece (paper, eq. 9); all count alike."""
    n = len(pieces)
    directions = _unit(pieces["mean"] - pieces["start"])
    return Lines(pieces["start"], directions, np.ones(n), np.full(n, np.inf), np.zeros((n, 2)))


def least_squares(
    centerline: Centerline,
    traced: Int32Array,
    pieces: StructuredArray,
    candidate: FloatArray,
    width: float,
    inner: float,
    resolution_m: float,
    config: BranchConfig,
    against: BinaryImage | None = None,
) -> Lines:
    """Fit a line to the part of each piece that can be trusted, and weigh it by its variance.

    Parameters
    ----------
    centerline
    traced, pieces
        All pieces around the candidate, see `interloc.kernels.skeleton.trace_branches`.
    candidate : (2,) float64
        Its row and column.
    width, inner : float
        Road width at the candidate, and radius of its inner circle; pixels.
    resolution_m : float
        Side of a pixel.
    config
    against
        Set where other ground was seen; None where that is not known: then every edge counts as seen.
    """
    limits_m = config.fit_length_m, config.fit_least_m, config.full_fit_m, config.straight_m, config.trim_m
    lengths = (limit_m / resolution_m for limit_m in limits_m)
    ring = max(RING_M / resolution_m, LEAST_RING_PX)
    slack = max(SLACK_M / resolution_m, LEAST_SLACK_PX)
    limits = np.array((width, inner, *lengths, centerline.max_width // 2, ring, slack), LIMITS)
    lines = fit_lines(
        centerline.occupancy.words,
        NOWHERE if against is None else against.words,
        centerline.rows,
        centerline.cols,
        centerline.border_distance,
        centerline.is_tip,
        traced,
        pieces,
        candidate,
        limits[()],
    )
    has_line = lines["length"] * resolution_m >= config.min_fit_m
    directions = np.where(has_line[:, None], lines["direction"], _unit(pieces["mean"] - candidate))
    weights = np.where(has_line, lines["weight"] / resolution_m**2, 0.0)
    return Lines(lines["point"], directions, weights, np.where(has_line, lines["length"], np.inf), lines["bend"])


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), 1e-9)[:, None]


LINE = np.dtype(
    [
        ("point", np.float64, (2,)),  # row and column
        ("direction", np.float64, (2,)),  # unit, away from the candidate
        ("start", np.float64),  # distance from the candidate at which the fitted part begins
        ("length", np.float64),  # of the fitted part; 0 where there is too little to fit
        ("rms", np.float64),  # root mean square distance of its pixels from the line
        ("weight", np.float64),  # inverse of the variance at the candidate, 1 / pixels^2
        ("bend", np.float64, (2,)),  # of the circle that it is a tangent of, see `Lines`
    ]
)
"""What `fit_lines` returns for each piece; pixels."""

_MOMENTS = np.dtype([(name, np.float64) for name in ("n", "r", "c", "rr", "rc", "cc")])
"""Sums over pixels: their number, rows, columns, and the products of these."""


# Named tuples would stand in the files of compiled code by the name of their class, which may change; these do not.
_LIMITS = ("width", "inner", "length", "shortest", "full", "straight", "trim", "half_width", "ring", "slack")
LIMITS = np.dtype([(name, np.float64) for name in _LIMITS])
"""Width and inner radius at the candidate, the settings of the fit from `BranchConfig`, and lengths above; pixels."""


NOWHERE = np.zeros((0, 0), np.uint64)
"""For `fit_lines`, where it is not known where other ground was seen."""


@compiled
def fit_lines(
    words: UInt64Array,
    against: UInt64Array,
    rows: Int32Array,
    cols: Int32Array,
    border_distance: Int32Array,
    is_tip: BoolArray,
    traced: Int32Array,
    pieces: StructuredArray,
    candidate: FloatArray,
    limits: Record,
) -> StructuredArray:
    """Fit and weigh a line for each piece; (P,) LINE.

    ``words`` are those of the road, ``against`` those of the other ground that was seen, or `NOWHERE`; for the other
    arrays see `Centerline` and `trace_branches`.
    """
    lines = np.zeros(pieces.size, LINE)
    n_rings = max(1, int(limits.length / limits.ring))
    samples = np.zeros((pieces.size, INNER_RINGS + n_rings), _MOMENTS)
    firsts = np.zeros(pieces.size, np.int64)
    halves = np.zeros(pieces.size)
    trial = np.zeros(1, LINE)
    for i in range(pieces.size):
        piece, is_link = traced[pieces[i].begin : pieces[i].end], pieces[i].at_candidate
        some = _sum_rings(samples[i, INNER_RINGS:], rows, cols, border_distance, is_tip, piece, candidate, limits)
        widths = _half_widths(some, words, rows, cols, limits)
        begin = int(max(_parting(pieces, i, candidate, limits.width) - limits.inner, 0.0) / limits.ring)
        begin = min(begin, n_rings - 1)
        moved, moved_some = samples[i].copy(), some.copy()
        halves[i] = _keep_parallel(samples[i, INNER_RINGS:], some, widths, is_link, limits)
        firsts[i], variance = _fit_straight_part(lines[i], samples[i], INNER_RINGS + begin, candidate, limits)
        if _move_from_unseen_edges(moved[INNER_RINGS:], widths, words, against, candidate, limits):
            half = _keep_parallel(moved[INNER_RINGS:], moved_some, widths, is_link, limits)
            trial[0].length = 0.0
            first, moved_variance = _fit_straight_part(trial[0], moved, INNER_RINGS + begin, candidate, limits)
            if half > 0.0 and moved_variance <= variance:
                lines[i], samples[i], some = trial[0], moved, moved_some
                halves[i], firsts[i] = half, first
        if lines[i].length > 0.0 and _is_beyond_bend(lines[i], some[begin:], rows, cols, halves[i]):
            lines[i].length = 0.0
    straight = lines.copy()
    surfaces = np.where(halves > 0.0, halves, 0.5 * limits.width)  # a ragged one as wide as the road at the candidate
    for i in range(pieces.size):
        if lines[i].length > 0.0 and halves[i] > 0.0:
            firsts[i] = _follow_edge(samples[i], firsts[i], straight, i, surfaces, words, against, candidate, limits)
            _fit_straight_part(lines[i], samples[i], firsts[i], candidate, limits)
    _weigh(lines, candidate, limits.full)
    _join_bends(lines, samples, firsts, candidate, limits)
    return lines


@compiled
def _sum_rings(
    rings: StructuredArray,
    rows: Int32Array,
    cols: Int32Array,
    border_distance: Int32Array,
    is_tip: BoolArray,
    piece: Int32Array,
    candidate: FloatArray,
    limits: Record,
) -> Int32Array:
    """Sum up the usable pixels of a piece in rings around the inner circle, from it outwards; return one of each."""
    some = np.full(rings.size, -1, np.int32)
    tips = piece[is_tip[piece]]
    for p in piece:
        dr, dc = rows[p] - candidate[0], cols[p] - candidate[1]
        ring = int((np.sqrt(dr * dr + dc * dc) - limits.inner) / limits.ring)
        usable = ring < rings.size and border_distance[p] >= limits.trim
        for t in tips:
            tr, tc = rows[p] - rows[t], cols[p] - cols[t]
            if tr * tr + tc * tc < limits.trim * limits.trim:
                usable = False
        if usable:
            _add(rings[ring], dr, dc, 1.0)
            some[ring] = p
    return some


@compiled
def _add(sums: Record, r: float, c: float, n: float) -> None:
    sums.n += n
    sums.r += n * r
    sums.c += n * c
    sums.rr += n * r * r
    sums.rc += n * r * c
    sums.cc += n * c * c


@compiled
def _half_widths(
    some: Int32Array, words: UInt64Array, rows: Int32Array, cols: Int32Array, limits: Record
) -> FloatArray:
    """Return the half width of the road at a pixel of each ring, pixels; 0 where there is none."""
    size = words.shape[0] - 2
    halves = np.zeros(some.size)
    for i in range(some.size):
        if some[i] >= 0:
            halves[i] = nearest_clear(words, rows[some[i]], cols[some[i]], size, size, int(limits.half_width))
    return halves


@compiled
def _move_from_unseen_edges(
    rings: StructuredArray,
    halves: FloatArray,
    words: UInt64Array,
    against: UInt64Array,
    candidate: FloatArray,
    limits: Record,
) -> bool:
    """Lay the rings of which one edge was not seen half a width inside the other, and enter that into ``halves``.

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
        r, c = candidate[0] + rings[i].r / rings[i].n, candidate[1] + rings[i].c / rings[i].n
        clear = max(halves[i] - limits.ring, 0.0)  # no edge is nearer: a pixel of the ring lies in its middle
        for side in range(2):
            d_row, d_col = (-u_col, u_row) if side == 0 else (u_col, -u_row)
            edge = clear + to_edge(words, r + clear * d_row, c + clear * d_col, d_row, d_col, limits.half_width)
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
        if seen[i, 0] != seen[i, 1] and limits.slack < unseen < MAX_UNSEEN * half:
            shift = edges[i, 0] - half if seen[i, 0] else half - edges[i, 1]
            _move(rings[i], shift * lefts[i, 0], shift * lefts[i, 1])
            halves[i] = half
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
def _keep_parallel(
    rings: StructuredArray, some: Int32Array, halves: FloatArray, is_link: bool, limits: Record
) -> float:
    """Empty the rings where the road is wider or narrower than the branch is, the wider ones in ``some`` too.

    Returns its half width, pixels; 0 where too little of it is between parallel sides, and nothing was emptied.
    """
    count = np.count_nonzero(some >= 0)
    known = np.sort(halves[halves > 0.0])
    if known.size == 0:
        return 0.0
    # Both ends of a road between two junctions open into mouths.
    half: float = known[int((LINK_QUANTILE if is_link else ARM_QUANTILE) * (known.size - 1))]
    slack = max(limits.slack, PARALLEL_SLACK * half)
    parallel = 0
    for i in range(rings.size):
        if some[i] >= 0 and abs(halves[i] - half) <= slack:
            parallel += 1
    if parallel < max(MIN_PARALLEL * count, MIN_PARALLEL_RINGS):
        return 0.0  # its edges are too ragged to tell
    for i in range(rings.size):
        if some[i] >= 0 and abs(halves[i] - half) > slack:
            rings[i].n = 0.0
            if halves[i] > half:
                some[i] = -1  # a mouth, in which the centerline is bent
    return half


@compiled
def _is_beyond_bend(line: Record, some: Int32Array, rows: Int32Array, cols: Int32Array, half: float) -> bool:
    """Return whether the nearest road of a branch that is no mouth lies beside its line, off by over half a width."""
    if half == 0.0:
        return False
    for p in some:
        if p >= 0:
            across = (rows[p] - line.point[0]) * line.direction[1] - (cols[p] - line.point[1]) * line.direction[0]
            return bool(abs(across) > half)
    return False


@compiled
def _follow_edge(
    samples: StructuredArray,
    first: int,
    lines: StructuredArray,
    which: int,
    surfaces: FloatArray,
    words: UInt64Array,
    against: UInt64Array,
    candidate: FloatArray,
    limits: Record,
) -> int:
    """Follow the axis of a branch inwards along the edge that stays half a width from it; return the new first ring.

    It ends where both edges have turned away, or where the axis comes upon the surface of another branch, whose half
    width is in ``surfaces``.
    """
    line, half = lines[which], surfaces[which]
    slack, step, max_shift = limits.slack, limits.ring, MAX_SHIFT * limits.ring
    toward = _lasting_side(lines, which)
    ring = samples[first]
    along = (candidate[0] + ring.r / ring.n - line.point[0]) * line.direction[0]
    along += (candidate[1] + ring.c / ring.n - line.point[1]) * line.direction[1]
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
        if -(u_row * line.direction[0] + u_col * line.direction[1]) < MAX_TURN_COS:
            break
        r, c = trail[at, 0] + step * u_row, trail[at, 1] + step * u_col
        if _is_on_other(r, c, lines, which, surfaces, candidate):
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
        samples[i].n = 0.0
        if misses:
            continue
        samples[i].r = samples[i].c = samples[i].rr = samples[i].rc = samples[i].cc = 0.0
        _add(samples[i], r - candidate[0], c - candidate[1], step)
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
def _is_on_other(
    r: float, c: float, lines: StructuredArray, which: int, halves: FloatArray, candidate: FloatArray
) -> bool:
    """Return whether a place lies on the surface of another branch, prolonged to the candidate."""
    for j in range(lines.size):
        if j == which or lines[j].length == 0.0:
            continue
        d_row, d_col = lines[j].direction
        across = (r - lines[j].point[0]) * d_col - (c - lines[j].point[1]) * d_row
        along = (r - candidate[0]) * d_row + (c - candidate[1]) * d_col
        if abs(across) < halves[j] and along > 0.0:
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


@compiled
def _parting(pieces: StructuredArray, which: int, candidate: FloatArray, width: float) -> float:
    """Return how far from the candidate the surface of a branch parts from that of its nearest neighbour, pixels.

    Two roads of width w at an angle t part at (w / 2) / sin(t / 2); the centerline is bent until there. Roads side by
    side are apart from where they begin.
    """
    least = np.pi
    r, c = pieces[which].mean[0] - candidate[0], pieces[which].mean[1] - candidate[1]
    for i in range(pieces.size):
        if i != which and not _are_side_by_side(pieces[i], pieces[which]):
            ri, ci = pieces[i].mean[0] - candidate[0], pieces[i].mean[1] - candidate[1]
            least = min(least, abs(np.arctan2(r * ci - c * ri, r * ri + c * ci)))
    distance: float = 0.5 * width / max(np.sin(0.5 * least), 0.25)
    return distance


@compiled
def _are_side_by_side(piece: Record, other: Record) -> bool:
    """Return whether two branches lead the same way."""
    r, c = piece.mean[0] - piece.start[0], piece.mean[1] - piece.start[1]
    other_r, other_c = other.mean[0] - other.start[0], other.mean[1] - other.start[1]
    return bool(r * other_r + c * other_c > SIDE_BY_SIDE_COS * np.hypot(r, c) * np.hypot(other_r, other_c))


@compiled
def _fit_straight_part(
    line: Record, rings: StructuredArray, begin: int, candidate: FloatArray, limits: Record
) -> tuple[int, float]:
    """Fit a line by total least squares to the rings from ``begin`` on, as far as the branch is straight.

    Of the parts that are long enough it takes the one whose line is known best at the candidate. Returns the first ring
    that was used, and the variance there by which lines compare; infinite where there is too little to fit.
    """
    first, least = -1, np.inf
    m, sr, sc, srr, src, scc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, rings.size):
        ring = rings[i]
        if ring.n == 0.0:
            continue
        if first < 0:
            first = i
        m += ring.n
        sr += ring.r
        sc += ring.c
        srr += ring.rr
        src += ring.rc
        scc += ring.cc
        if m < 2.0:
            continue
        ur, uc = sr / m, sc / m
        vrr, vrc, vcc = srr / m - ur * ur, src / m - ur * uc, scc / m - uc * uc
        angle = 0.5 * np.arctan2(2.0 * vrc, vrr - vcc)
        d_row, d_col = np.cos(angle), np.sin(angle)
        rms = np.sqrt(max(vrr * d_col * d_col - 2.0 * vrc * d_row * d_col + vcc * d_row * d_row, 0.0))
        length = (i + 1 - first) * limits.ring
        if rms > limits.straight and length > limits.shortest:
            break
        variance = _variance(max(rms - GRID_PX, 0.0) ** 2, ur * d_row + uc * d_col, length) / min(length, limits.full)
        if length > limits.shortest and variance > least:
            continue
        least = variance
        # Away from where the branch begins: the candidate may lie beyond the place that it comes from.
        sense = d_row * (ur - rings[first].r / rings[first].n) + d_col * (uc - rings[first].c / rings[first].n)
        if i == first:
            sense = d_row * ur + d_col * uc
        if sense < 0.0:
            d_row, d_col = -d_row, -d_col
        line.point[0], line.point[1] = candidate[0] + ur, candidate[1] + uc
        line.direction[0], line.direction[1] = d_row, d_col
        line.start, line.length, line.rms = limits.inner + (first - INNER_RINGS) * limits.ring, length, rms
    return max(first, begin), least


@compiled
def _weigh(lines: StructuredArray, candidate: FloatArray, full: float) -> None:
    """Weigh each line by its length, as far as ``full`` counts, over its variance at the candidate.

    The scatter of a short branch may be small by chance, so half of its variance is that of all branches around.
    """
    common, total = 0.0, 0.0
    for i in range(lines.size):
        scatter = max(lines[i].rms - GRID_PX, 0.0)
        common += lines[i].length * scatter * scatter
        total += lines[i].length
    for i in range(lines.size):
        line = lines[i]
        if line.length > 0.0:
            scatter = max(line.rms - GRID_PX, 0.0)
            off = (candidate[0] - line.point[0]) * line.direction[0] + (candidate[1] - line.point[1]) * line.direction[
                1
            ]
            variance = _variance(0.5 * (scatter * scatter + common / total), off, line.length)
            line.weight = min(line.length, full) / full / variance


@compiled
def _join_bends(
    lines: StructuredArray, samples: StructuredArray, firsts: IntArray, candidate: FloatArray, limits: Record
) -> None:
    """Replace the lines of two branches that are one bend by its tangent where it comes nearest to the candidate.

    A line says of a bend what its road is like farther out: prolonged to the intersection it leaves the road.
    """
    joined = np.zeros(lines.size, np.bool_)
    for i in range(lines.size):
        for j in range(i):
            if joined[i] or joined[j] or lines[i].length == 0.0 or lines[j].length == 0.0:
                continue
            one = _places(samples[i], firsts[i], limits)
            other = _places(samples[j], firsts[j], limits)
            if min(len(one), len(other)) < BEND_RINGS or _meet_in_corner(one, other):
                continue
            both = np.concatenate((one, other))
            row, col, radius, rms = _fit_circle(both)
            from_lines = np.sqrt((_squares_off_line(one) + _squares_off_line(other)) / len(both))
            away = np.hypot(row, col)
            if not rms < BEND_SHARE * from_lines or away == 0.0:
                continue
            d_row, d_col = col / away, -row / away
            p_row, p_col = row - radius * row / away, col - radius * col / away
            ahead = (one[:, 0].mean() - p_row) * d_row + (one[:, 1].mean() - p_col) * d_col
            behind = (other[:, 0].mean() - p_row) * d_row + (other[:, 1].mean() - p_col) * d_col
            if ahead * behind >= 0.0:
                continue
            joined[i] = joined[j] = True
            for k, sense in ((i, np.sign(ahead)), (j, np.sign(behind))):
                line = lines[k]
                line.point[0], line.point[1] = candidate[0] + p_row, candidate[1] + p_col
                line.direction[0], line.direction[1] = sense * d_row, sense * d_col
                line.bend[0], line.bend[1] = row / away / radius, col / away / radius
                line.length, line.rms = len(both) * limits.ring, rms
                line.weight = min(line.length, limits.full) / limits.full
                line.weight /= _variance(max(rms - GRID_PX, 0.0) ** 2, 0.0, line.length)


@compiled
def _places(rings: StructuredArray, first: int, limits: Record) -> FloatArray:
    """Return where a branch passes its rings, from the first on as far as length counts; rows and columns from here."""
    places = np.empty((int(limits.full / limits.ring) + 1, 2))
    count = 0
    for ring in rings[first : first + len(places)]:
        if ring.n > 0.0:
            places[count, 0], places[count, 1] = ring.r / ring.n, ring.c / ring.n
            count += 1
    return places[:count]


@compiled
def _meet_in_corner(one: FloatArray, other: FloatArray) -> bool:
    """Return whether two branches are too near to each other in direction to be one road."""
    a, b, c, d = one[:, 0].mean(), one[:, 1].mean(), other[:, 0].mean(), other[:, 1].mean()
    return bool(a * c + b * d > math.cos(LASTING_RAD) * np.hypot(a, b) * np.hypot(c, d))


@compiled
def _squares_off_line(places: FloatArray) -> float:
    """Return the sum of squared distances of places from the line that fits them best."""
    y, x = places[:, 0] - places[:, 0].mean(), places[:, 1] - places[:, 1].mean()
    yy, yx, xx = (y * y).sum(), (y * x).sum(), (x * x).sum()
    smallest: float = 0.5 * (yy + xx) - np.hypot(0.5 * (yy - xx), yx)
    return max(smallest, 0.0)


@compiled
def _fit_circle(places: FloatArray) -> tuple[float, float, float, float]:
    """Fit a circle by the least squares of Kasa; return row and column of its centre, its radius, and what is left.

    I. Kasa, "A circle fitting procedure and its error analysis", 1976. What is left is the root mean square distance;
    infinite for places on one line.
    """
    mean_row, mean_col = places[:, 0].mean(), places[:, 1].mean()
    y, x = places[:, 0] - mean_row, places[:, 1] - mean_col
    z = y * y + x * x
    yy, yx, xx, yz, xz = (y * y).mean(), (y * x).mean(), (x * x).mean(), (y * z).mean(), (x * z).mean()
    determinant = yy * xx - yx * yx
    if determinant <= 0.0:
        return 0.0, 0.0, 0.0, np.inf
    row, col = 0.5 * (xx * yz - yx * xz) / determinant, 0.5 * (yy * xz - yx * yz) / determinant
    radius = np.sqrt(row * row + col * col + z.mean())
    off = np.sqrt((y - row) ** 2 + (x - col) ** 2) - radius
    return row + mean_row, col + mean_col, radius, np.sqrt((off * off).mean())


@compiled
def _variance(scatter: float, off: float, length: float) -> float:
    """Return the variance of a line so far from the middle of what it was fitted to, pixels^2.

    A line that is prolonged back to the candidate is known there the worse the farther off it was fitted.
    """
    far = off / length
    variance: float = (scatter + PIXEL_PX * PIXEL_PX) * (1.0 + 12.0 * far * far)
    return variance
