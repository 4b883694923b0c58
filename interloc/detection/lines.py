"""The straight lines that stand for branches, and how well each is known.

The paper lays a line through the start of a branch and its mean. But a centerline does not run straight into an
intersection: it is bent as far as the surfaces of its roads overlap, it leans where the road ends, leaves the window or
was seen in passing, and roads bend further out. So the preset `default` fits a line to the part that can be trusted:

1. Pixels near a dead end of the branch or near the border of the image are left out (`trim_m`), and so are those where
   the road is wider or narrower than the branch is: there a mouth opens, or an edge was not seen (`keep_parallel`;
   for edges see `interloc.detection.edges`).
   Where other ground begins at one edge only, the other one was not seen: a parked car or the kerb of a median hid the
   road. There the axis lies half a width inside the edge that was seen, with the width between edges that both were
   (`move_from_unseen_edges`). Of the two lines, with and without that, the one counts that is known better.
2. From where its sides are parallel the axis is followed inwards along the edge that goes on, half a width from it: at
   an acute mouth or a rounded corner one edge turns away long before the other (`follow_edge`). A branch whose edges
   are too ragged to tell stays as it is.
3. The line begins there and takes in more of the branch, ring by ring, as long as the branch is straight
   (`straight_m`, `fit_length_m`); of these parts that one counts whose line is known best where the roads meet: a
   longer part would lean towards a bend.
4. A branch that ends at a through road is turned towards the right angle, by how badly its direction is known: of a
   side road that is passed only ten ragged metres are seen (`_square_stems`).
5. A line weighs the inverse of its variance where the roads meet, which grows with the distance from what it was
   fitted to (`_weigh`, and `interloc.detection.refinement`).
"""

from __future__ import annotations

import math

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, Record, StructuredArray, UInt64Array
from interloc.config import BranchConfig
from interloc.detection.centerline import Centerline, Pieces
from interloc.detection.edges import (
    MOMENTS,
    add,
    follow_edge,
    keep_parallel,
    move_from_unseen_edges,
    usual_half_width,
)
from interloc.detection.image import BinaryImage
from interloc.kernels import compiled
from interloc.kernels.bits import NOWHERE, nearest_clear

RING_M = 0.64  # a line grows by this much at a time
MIN_RING_PX = 4.0  # and by no less, however coarse the grid is
GRID_PX = 0.4  # scatter that the grid gives to the centerline of an ideal road
PIXEL_PX = 0.1  # how well the line of an ideal road is known
INNER_RINGS = 40  # rings that an axis is followed inwards at most, within the inner circle

SLACK_M, MIN_SLACK_PX = 0.24, 1.5  # what an edge may leave the place by where it belongs
SIDE_BY_SIDE_COS = math.cos(math.radians(10.0))  # of two roads that do not meet there: two carriageways
PARTING_SIN = 0.25  # of half an angle between roads: below 29 degrees they part no farther out

LEAN = 4.0  # by how much a line errs in direction more than its scatter tells
THROUGH_COS, STRAIGHT_ON_COS = math.cos(math.radians(140.0)), math.cos(math.radians(155.0))  # branches of one road
SQUARE_SCALE_RAD = math.radians(25.0)  # beyond which an angle is the less likely to be meant as a right one


LINE = np.dtype(
    [
        ("point", np.float64, (2,)),
        ("direction", np.float64, (2,)),
        ("length", np.float64),
        ("rms", np.float64),
        ("weight", np.float64),
        ("first", np.int64),
        ("parallel", np.float64),
        ("half_width", np.float64),
    ]
)
"""The line of a branch. A branch of which too little can be trusted has none: its length and its weight are 0, and its
point and direction only say where it leads, from the candidate through its mean.

Attributes
----------
point : (2,) float64
    Row and column of a point on it, pixels: the middle of what it was fitted to, or the mean of the branch.
direction : (2,) float64
    Unit direction (row, column), away from the candidate.
length : float64
    Of the part that it was fitted to, pixels; infinite in the paper, where lines are as well known everywhere.
rms : float64
    Root mean square distance of that part from it, pixels.
weight : float64
    How much it counts: 1 in the paper, else the inverse of its variance at the candidate, 1 / m^2.
first : int64
    Ring at which that part begins.
parallel : float64
    Half width of the road between parallel sides, pixels; 0 where its edges are too ragged to tell.
half_width : float64
    Usual half width of the road, pixels; 0 where none is known, and in the paper, which does not measure it.
"""

# Named tuples would stand in the files of compiled code by the name of their class, which may change; these do not.
_FIT = "row col width inner length shortest full straight trim max_half_width ring slack unseen follow_cos square"
FIT = np.dtype([(name, np.float64) for name in _FIT.split()])
"""Row and column of a candidate, width and inner radius there, the settings of the fit from `BranchConfig`, half of the
widest road that is measured, and lengths above; pixels."""


def through_start_and_mean(pieces: Pieces) -> StructuredArray:
    """Lay a line through the start and the mean of each piece, (P,) LINE (paper, eq. 9); all count alike."""
    lines = np.zeros(len(pieces.table), LINE)
    lines["point"] = pieces.table["start"]
    lines["direction"] = _unit(pieces.table["mean"] - pieces.table["start"])
    lines["length"], lines["weight"] = np.inf, 1.0
    return lines


def least_squares(
    pieces: Pieces,
    centerline: Centerline,
    candidate: FloatArray,
    width: float,
    inner: float,
    config: BranchConfig,
    against: BinaryImage | None = None,
) -> StructuredArray:
    """Fit a line to the part of each piece that can be trusted, and weigh it by its variance; (P,) LINE.

    Parameters
    ----------
    pieces
        All around the candidate.
    centerline
    candidate : (2,) float64
        Its row and column.
    width, inner : float
        Road width at the candidate, and radius of its inner circle; pixels.
    config
    against
        Set where other ground was seen; None where that is not known: then every edge counts as seen.
    """
    resolution_m = centerline.resolution_m
    limits_m = config.fit_length_m, config.fit_least_m, config.full_fit_m, config.straight_m, config.trim_m
    lengths = (limit_m / resolution_m for limit_m in limits_m)
    ring = max(RING_M / resolution_m, MIN_RING_PX)
    slack = max(SLACK_M / resolution_m, MIN_SLACK_PX)
    rules = (
        config.unseen_share,
        2.0 if config.follow_deg is None else math.cos(math.radians(config.follow_deg)),
        0.0 if config.square_std_deg is None else math.radians(config.square_std_deg),
    )
    fit = np.array((*candidate, width, inner, *lengths, centerline.max_half_width, ring, slack, *rules), FIT)
    lines = fit_lines(
        fit[()],
        centerline.pixels,
        pieces.traced,
        pieces.is_main,
        pieces.table,
        centerline.occupancy.words,
        NOWHERE if against is None else against.words,
    )
    is_short = (lines["length"] == 0.0) | (lines["length"] * resolution_m < config.min_fit_m)
    mean = pieces.table["mean"][is_short]
    lines["point"][is_short], lines["direction"][is_short] = mean, _unit(mean - candidate)
    lines["length"][is_short] = lines["weight"][is_short] = 0.0
    lines["weight"] /= resolution_m**2
    return lines


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), 1e-9)[:, None]


@compiled
def fit_lines(
    fit: Record,
    pixels: StructuredArray,
    traced: Int32Array,
    is_main: BoolArray,
    pieces: StructuredArray,
    words: UInt64Array,
    against: UInt64Array,
) -> StructuredArray:
    """Fit and weigh a line for each piece; (P,) LINE, but with the weight per square pixel.

    Parameters
    ----------
    fit : FIT
    pixels : (N,) PIXEL
        Of the centerline.
    traced, is_main, pieces
        See `interloc.kernels.skeleton.trace_branches`.
    words, against
        Of the road, and of the other ground that was seen, or `NOWHERE`.
    """
    lines = np.zeros(pieces.size, LINE)
    n_rings = max(1, int(fit.length / fit.ring))
    samples = np.zeros((pieces.size, INNER_RINGS + n_rings), MOMENTS)
    trial = np.zeros(1, LINE)
    for i in range(pieces.size):
        piece, line, is_link = pieces[i], lines[i], pieces[i].at_candidate
        main = traced[piece.begin : piece.end][is_main[piece.begin : piece.end]]
        half_widths = _sum_rings(samples[i, INNER_RINGS:], pixels, main, words, fit)
        parting = int(max(_parting(pieces, i, fit) - fit.inner, 0.0) / fit.ring)
        parting = min(parting, n_rings - 1)
        moved = samples[i].copy()
        line.parallel = keep_parallel(samples[i, INNER_RINGS:], half_widths, is_link, fit)
        variance = _fit_straight_part(line, samples[i], INNER_RINGS + parting, fit)
        if fit.unseen > 0.0 and move_from_unseen_edges(moved[INNER_RINGS:], half_widths, words, against, fit):
            trial[0].length = 0.0
            trial[0].parallel = keep_parallel(moved[INNER_RINGS:], half_widths, is_link, fit)
            moved_variance = _fit_straight_part(trial[0], moved, INNER_RINGS + parting, fit)
            if trial[0].parallel > 0.0 and moved_variance <= variance:
                lines[i], samples[i] = trial[0], moved
        line.half_width = usual_half_width(half_widths, is_link)
    straight = lines.copy()
    for i in range(pieces.size):
        if fit.follow_cos <= 1.0 and lines[i].length > 0.0 and lines[i].parallel > 0.0:
            first = follow_edge(samples[i], straight, i, words, against, fit)
            _fit_straight_part(lines[i], samples[i], first, fit)
    _weigh(lines, fit)
    if fit.square > 0.0:
        _square_stems(lines, fit.square)
    return lines


@compiled
def _sum_rings(
    rings: StructuredArray, pixels: StructuredArray, piece: Int32Array, words: UInt64Array, fit: Record
) -> FloatArray:
    """Sum up the usable pixels of a piece in rings around the inner circle, from it outwards.

    Returns the half width of the road at the last pixel of each ring; 0 in a ring without pixels.
    """
    size, last = words.shape[0] - 2, np.full(rings.size, -1, np.int32)
    tips = piece[pixels["is_tip"][piece]]
    for p in piece:
        pixel = pixels[p]
        dr, dc = pixel.row - fit.row, pixel.col - fit.col
        ring = int((np.sqrt(dr * dr + dc * dc) - fit.inner) / fit.ring)
        usable = ring < rings.size and pixel.border_distance >= fit.trim
        for t in tips:
            tr, tc = pixel.row - pixels[t].row, pixel.col - pixels[t].col
            if tr * tr + tc * tc < fit.trim * fit.trim:
                usable = False
        if usable:
            add(rings[ring], dr, dc, 1.0)
            last[ring] = p
    half_widths = np.zeros(rings.size)
    for i in np.flatnonzero(last >= 0):
        row, col = pixels[last[i]].row, pixels[last[i]].col
        half_widths[i] = nearest_clear(words, row, col, size, size, int(fit.max_half_width))
    return half_widths


@compiled
def _parting(pieces: StructuredArray, which: int, fit: Record) -> float:
    """Return how far from the candidate the surface of a branch parts from that of its nearest neighbour, pixels.

    Two roads of width w at an angle t part at (w / 2) / sin(t / 2); the centerline is bent until there. Roads side by
    side are apart from where they begin.
    """
    least = np.pi
    r, c = pieces[which].mean[0] - fit.row, pieces[which].mean[1] - fit.col
    for i in range(pieces.size):
        if i != which and not _are_side_by_side(pieces[i], pieces[which]):
            ri, ci = pieces[i].mean[0] - fit.row, pieces[i].mean[1] - fit.col
            least = min(least, abs(np.arctan2(r * ci - c * ri, r * ri + c * ci)))
    distance: float = 0.5 * fit.width / max(np.sin(0.5 * least), PARTING_SIN)
    return distance


@compiled
def _are_side_by_side(piece: Record, other: Record) -> bool:
    """Return whether two branches lead the same way."""
    r, c = piece.mean[0] - piece.start[0], piece.mean[1] - piece.start[1]
    other_r, other_c = other.mean[0] - other.start[0], other.mean[1] - other.start[1]
    return bool(r * other_r + c * other_c > SIDE_BY_SIDE_COS * np.hypot(r, c) * np.hypot(other_r, other_c))


@compiled
def _fit_straight_part(line: Record, rings: StructuredArray, begin: int, fit: Record) -> float:
    """Fit a line by total least squares to the rings from ``begin`` on, as far as the branch is straight.

    Of the parts that are long enough it takes the one whose line is known best at the candidate. Returns the
    variance there by which lines compare; infinite where there is too little to fit.
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
        length = (i + 1 - first) * fit.ring
        if rms > fit.straight and length > fit.shortest:
            break
        variance = _variance(max(rms - GRID_PX, 0.0) ** 2, ur * d_row + uc * d_col, length) / min(length, fit.full)
        if length > fit.shortest and variance > least:
            continue
        least = variance
        # Away from where the branch begins: the candidate may lie beyond the place that it comes from.
        sense = d_row * (ur - rings[first].r / rings[first].n) + d_col * (uc - rings[first].c / rings[first].n)
        if i == first:
            sense = d_row * ur + d_col * uc
        if sense < 0.0:
            d_row, d_col = -d_row, -d_col
        line.point[0], line.point[1] = fit.row + ur, fit.col + uc
        line.direction[0], line.direction[1] = d_row, d_col
        line.first, line.length, line.rms = first, length, rms
    return least


@compiled
def _weigh(lines: StructuredArray, fit: Record) -> None:
    """Weigh each line by its length, as far as that counts, over its variance at the candidate."""
    scatters = _scatters(lines)
    for i in range(lines.size):
        line = lines[i]
        if line.length > 0.0:
            off = (fit.row - line.point[0]) * line.direction[0]
            off += (fit.col - line.point[1]) * line.direction[1]
            line.weight = min(line.length, fit.full) / fit.full / _variance(scatters[i], off, line.length)


@compiled
def _scatters(lines: StructuredArray) -> FloatArray:
    """Return the mean square scatter of each branch around its line, beyond that of the grid, pixels^2.

    That of a short branch may be small by chance, so half of each is that of all branches around.
    """
    own = np.maximum(lines["rms"] - GRID_PX, 0.0) ** 2
    total: float = lines["length"].sum()
    common = (lines["length"] * own).sum() / total if total > 0.0 else 0.0
    return 0.5 * (own + common)


@compiled
def _square_stems(lines: StructuredArray, square_rad: float) -> None:
    """Turn branches that end at a through road towards the right angle, by how badly their direction is known.

    A ragged side road leans as a whole, of which its scatter tells only a part. The through road is that of the two
    best-known branches that continue each other, else the best-known branch. Branches that continue another one are
    no stems.
    """
    if lines["length"].sum() == 0.0:
        return
    variances = 12.0 * LEAN**2 * _scatters(lines) / np.maximum(lines["length"], 1e-9) ** 2  # of the directions
    variances[lines["length"] == 0.0] = np.inf
    one, other, least = variances.argmin(), -1, np.inf
    leads_on = np.zeros(lines.size, np.bool_)
    for i in range(lines.size):
        for j in range(i):
            alike = lines[i].direction[0] * lines[j].direction[0] + lines[i].direction[1] * lines[j].direction[1]
            if variances[i] + variances[j] < np.inf and alike < STRAIGHT_ON_COS:
                leads_on[i] = leads_on[j] = True
            if variances[i] + variances[j] < least and alike < THROUGH_COS:
                one, other, least = i, j, variances[i] + variances[j]
    row, col = lines[one].direction[0], lines[one].direction[1]
    if other >= 0:
        row, col = row - lines[other].direction[0], col - lines[other].direction[1]
    road = np.arctan2(row, col)
    for i in range(lines.size):
        if lines[i].length == 0.0 or i in (one, other) or leads_on[i]:
            continue
        angle = np.arctan2(lines[i].direction[0], lines[i].direction[1])
        off = (angle - road) % np.pi - 0.5 * np.pi  # from the right angle
        if abs(off) < 0.25 * np.pi:
            prior = square_rad**2 * (1.0 + (off / SQUARE_SCALE_RAD) ** 2) ** 2
            angle -= off * variances[i] / (variances[i] + prior)
            lines[i].direction[0], lines[i].direction[1] = np.sin(angle), np.cos(angle)


@compiled
def _variance(scatter: float, off: float, length: float) -> float:
    """Return the variance of a line so far from the middle of what it was fitted to, pixels^2.

    A line that is prolonged back to the candidate is known there the worse the farther off it was fitted.
    """
    far = off / length
    variance: float = (scatter + PIXEL_PX * PIXEL_PX) * (1.0 + 12.0 * far * far)
    return variance
