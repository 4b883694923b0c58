"""The straight lines that stand for branches, and how well each is known.

The paper lays a line through the start of a branch and its mean. But a centerline does not run straight into an
intersection: it is bent as far as the surfaces of its roads overlap, it leans where the road ends, leaves the window or
was seen in passing, and roads bend further out. So the preset `default` fits a line to the part that can be trusted:

1. The centerline of the branch is sampled in steps; what lies near a dead end or the border of the image is left out,
   and so is what does not lie between parallel edges (`interloc.detection.edges`).
2. From where its edges are parallel the axis is followed inwards along the edge that goes on.
3. The line begins there and takes in more of the branch, step by step, as long as the branch is straight; of these
   parts that one counts whose line is known best where the roads meet.
4. A branch that ends at a through road is turned towards the right angle, by how badly its direction is known.
5. A line weighs the inverse of its variance where the roads meet, which grows with the distance from what it was
   fitted to.
"""

from __future__ import annotations

import math

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, Record, StructuredArray, UInt64Array
from interloc.config import BranchConfig
from interloc.detection.centerline import Centerline, Pieces
from interloc.detection.edges import PLACE, SLACK_PX, STEP_PX, follow_edge, keep_parallel
from interloc.kernels import compiled

GRID_PX = 0.2  # scatter that the grid gives to the places on the axis of an ideal road
PIXEL_PX = 0.1  # how well the line of an ideal road is known
LEAN = 4.0  # by how much a line errs in direction more than its scatter tells
ALIKE_RAD = math.radians(10.0)  # two roads at less than this angle do not meet there: two carriageways
PARTING_SIN = 0.25  # of half an angle between roads: below 29 degrees they part no farther out


LINE = np.dtype(
    [
        ("point", np.float64, (2,)),
        ("direction", np.float64, (2,)),
        ("length", np.float64),
        ("rms", np.float64),
        ("weight", np.float64),
        ("first", np.int64),
        ("half_width", np.float64),
        ("is_parallel", np.bool_),
    ]
)
"""The line of a branch. A branch of which nothing can be trusted has none: its length and its weight are 0, and its
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
    Step at which that part begins.
half_width : float64
    Usual half width of the road, pixels; 0 where none is known, and in the paper, which does not measure it.
is_parallel : bool
    Whether that part lies between parallel edges; else these are too ragged to tell.
"""

_FIT = ["row", "col", "width", "inner", "length", "shortest", "trim", "max_half_width", "straight_cos", "square"]
FIT = np.dtype([(name, np.float64) for name in _FIT])
"""Row and column of a candidate, width and inner radius there; of the settings `fit_length_m`, `fit_least_m` and
`stop_m`, half of the widest road that is measured; pixels. Cosine between branches that are one road, and
`square_std_deg` in radians."""


def through_start_and_mean(pieces: Pieces) -> StructuredArray:
    """Lay a line through the start and the mean of each piece, (P,) LINE (paper, eq. 9); all count alike."""
    lines = np.zeros(len(pieces.table), LINE)
    lines["point"] = pieces.table["start"]
    lines["direction"] = _unit(pieces.table["mean"] - pieces.table["start"])
    lines["length"], lines["weight"] = np.inf, 1.0
    return lines


def least_squares(
    pieces: Pieces, centerline: Centerline, candidate: FloatArray, width: float, inner: float, config: BranchConfig
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
    """
    pixel_m = centerline.resolution_m
    fit = np.zeros((), FIT)
    fit["row"], fit["col"] = candidate
    fit["width"], fit["inner"], fit["max_half_width"] = width, inner, centerline.max_half_width
    fit["length"], fit["shortest"] = config.fit_length_m / pixel_m, config.fit_least_m / pixel_m
    fit["trim"] = config.stop_m / pixel_m
    fit["straight_cos"] = -math.cos(math.radians(config.straight_deg))
    fit["square"] = math.radians(config.square_std_deg or 0.0)
    road = centerline.occupancy.words
    lines = fit_lines(fit[()], centerline.pixels, pieces.traced, pieces.is_main, pieces.table, road)
    has_none = lines["length"] == 0.0
    mean = pieces.table["mean"][has_none]
    lines["point"][has_none], lines["direction"][has_none] = mean, _unit(mean - candidate)
    lines["weight"] /= pixel_m**2
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
) -> StructuredArray:
    """Fit and weigh a line for each piece; (P,) LINE, but with the weight per square pixel.

    Parameters
    ----------
    fit : FIT
    pixels : (N,) PIXEL
        Of the centerline.
    traced, is_main, pieces
        See `interloc.kernels.skeleton.trace_branches`.
    words
        Of the road.
    """
    lines = np.zeros(pieces.size, LINE)
    within = int(fit.inner / STEP_PX) + 1  # steps inside the inner circle, for an axis that is followed inwards
    axes = np.zeros((pieces.size, within + 1 + int(fit.length / STEP_PX)), PLACE)
    for i in range(pieces.size):
        main = traced[pieces[i].begin : pieces[i].end][is_main[pieces[i].begin : pieces[i].end]]
        _sample(axes[i, within:], pixels, main, fit)
        lines[i].half_width, lines[i].is_parallel = keep_parallel(axes[i], words, fit.max_half_width)
        parting = int(max(_parting(pieces, i, fit) - fit.inner, 0.0) / STEP_PX)
        _fit_straight_part(lines[i], axes[i], min(within + parting, axes.shape[1] - 1), fit)
    straight = lines.copy()
    for i in range(pieces.size):
        if lines[i].length > 0.0 and lines[i].is_parallel:
            first = follow_edge(axes[i], straight, i, words, fit)
            _fit_straight_part(lines[i], axes[i], first, fit)
    scatters = _scatters(lines)
    for i in range(lines.size):
        line = lines[i]
        if line.length > 0.0:
            off = (fit.row - line.point[0]) * line.direction[0] + (fit.col - line.point[1]) * line.direction[1]
            line.weight = min(line.length, fit.shortest) / fit.shortest / _variance(scatters[i], off, line.length)
    if fit.square > 0.0:
        _square_stems(lines, scatters, fit)
    return lines


@compiled
def _sample(axis: StructuredArray, pixels: StructuredArray, piece: Int32Array, fit: Record) -> None:
    """Take the mean of the usable pixels of a piece in each ring around the inner circle, from it outwards."""
    tips = piece[pixels["is_tip"][piece]]
    for p in piece:
        pixel = pixels[p]
        ring = int((math.hypot(pixel.row - fit.row, pixel.col - fit.col) - fit.inner) / STEP_PX)
        usable = ring < axis.size and pixel.border_distance >= fit.trim
        for t in tips:
            usable &= math.hypot(pixel.row - pixels[t].row, pixel.col - pixels[t].col) >= fit.trim
        if usable:
            axis[ring].row += pixel.row
            axis[ring].col += pixel.col
            axis[ring].n += 1.0
    for i in np.flatnonzero(axis["n"] > 0.0):
        axis[i].row /= axis[i].n
        axis[i].col /= axis[i].n


@compiled
def _parting(pieces: StructuredArray, which: int, fit: Record) -> float:
    """Return how far from the candidate the surface of a branch parts from that of its nearest neighbour, pixels.

    Two roads of width w at an angle t part at (w / 2) / sin(t / 2); the centerline is bent until there. Roads side by
    side are apart from where they begin.
    """
    least = np.pi
    piece = pieces[which]
    for i in range(pieces.size):
        other = pieces[i]
        if i != which and _angle(piece.start, piece.mean, other.start, other.mean) > ALIKE_RAD:
            place = np.array([fit.row, fit.col])
            least = min(least, _angle(place, piece.mean, place, other.mean))
    distance: float = 0.5 * fit.width / max(math.sin(0.5 * least), PARTING_SIN)
    return distance


@compiled
def _angle(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> float:
    """Return the angle between the ways from a to b and from c to d, radians."""
    row, col, other_row, other_col = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    return abs(math.atan2(row * other_col - col * other_row, row * other_row + col * other_col))


@compiled
def _fit_straight_part(line: Record, axis: StructuredArray, begin: int, fit: Record) -> None:
    """Fit a line by total least squares to an axis from one of its places on, as far as it is straight.

    Of the parts that are long enough it takes the one whose line is known best at the candidate.
    """
    first, least = -1, np.inf
    n, sr, sc, srr, src, scc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, axis.size):
        place = axis[i]
        if place.n == 0.0:
            continue
        r, c = place.row - fit.row, place.col - fit.col
        n += place.n
        sr += place.n * r
        sc += place.n * c
        srr += place.n * r * r
        src += place.n * r * c
        scc += place.n * c * c
        if first < 0:
            first = i
            continue
        row, col = sr / n, sc / n
        vrr, vrc, vcc = srr / n - row * row, src / n - row * col, scc / n - col * col
        angle = 0.5 * math.atan2(2.0 * vrc, vrr - vcc)
        d_row, d_col = math.cos(angle), math.sin(angle)
        rms = math.sqrt(max(vrr * d_col * d_col - 2.0 * vrc * d_row * d_col + vcc * d_row * d_row, 0.0))
        length = (i + 1 - first) * STEP_PX
        if rms > SLACK_PX and length > fit.shortest:
            break
        variance = _variance(_scatter(rms), row * d_row + col * d_col, length) / min(length, fit.shortest)
        if length > fit.shortest and variance > least:
            continue
        least = variance
        # Away from where the branch begins: the candidate may lie beyond the place that it comes from.
        if d_row * (place.row - axis[first].row) + d_col * (place.col - axis[first].col) < 0.0:
            d_row, d_col = -d_row, -d_col
        line.point[0], line.point[1] = fit.row + row, fit.col + col
        line.direction[0], line.direction[1] = d_row, d_col
        line.first, line.length, line.rms = first, length, rms


@compiled
def _scatter(rms: float) -> float:
    """Return the mean square scatter of a branch around its line, beyond that of the grid, pixels^2."""
    return max(rms - GRID_PX, 0.0) ** 2


@compiled
def _scatters(lines: StructuredArray) -> FloatArray:
    """Return the scatter of each branch. That of a short one may be small by chance, so half of each is that of all."""
    scatters = np.array([_scatter(rms) for rms in lines["rms"]])
    total = max(lines["length"].sum(), 1e-9)
    mixed: FloatArray = 0.5 * (scatters + (lines["length"] * scatters).sum() / total)
    return mixed


@compiled
def _variance(scatter: float, off: float, length: float) -> float:
    """Return the variance of a line so far from the middle of what it was fitted to, pixels^2.

    A line that is prolonged back to the candidate is known there the worse the farther off it was fitted.
    """
    far = off / length
    variance: float = (scatter + PIXEL_PX * PIXEL_PX) * (1.0 + 12.0 * far * far)
    return variance


@compiled
def _square_stems(lines: StructuredArray, scatters: FloatArray, fit: Record) -> None:
    """Turn branches that end at a through road towards the right angle, by how badly their direction is known.

    A ragged side road leans as a whole, of which its scatter tells only a part. The through road is that of the two
    best-known branches that continue each other, else the best-known branch. Branches that continue another one are
    no stems.
    """
    if lines["length"].sum() == 0.0:
        return
    variances = 12.0 * LEAN**2 * scatters / np.maximum(lines["length"], 1e-9) ** 2  # of the directions
    variances[lines["length"] == 0.0] = np.inf
    one, other, least = variances.argmin(), -1, np.inf
    leads_on = np.zeros(lines.size, np.bool_)
    for i in range(lines.size):
        for j in range(i):
            alike = lines[i].direction[0] * lines[j].direction[0] + lines[i].direction[1] * lines[j].direction[1]
            if variances[i] + variances[j] < np.inf and alike < fit.straight_cos:
                leads_on[i] = leads_on[j] = True
                if variances[i] + variances[j] < least:
                    one, other, least = i, j, variances[i] + variances[j]
    row, col = lines[one].direction[0], lines[one].direction[1]
    if other >= 0:
        row, col = row - lines[other].direction[0], col - lines[other].direction[1]
    road = math.atan2(row, col)
    for i in range(lines.size):
        if lines[i].length == 0.0 or i == one or leads_on[i]:
            continue
        angle = math.atan2(lines[i].direction[0], lines[i].direction[1])
        off = (angle - road) % np.pi - 0.5 * np.pi  # from the right angle
        if abs(off) < 0.25 * np.pi:
            prior = fit.square**2 * (1.0 + (off / math.acos(-fit.straight_cos)) ** 2) ** 2
            angle -= off * variances[i] / (variances[i] + prior)
            lines[i].direction[0], lines[i].direction[1] = math.sin(angle), math.cos(angle)
