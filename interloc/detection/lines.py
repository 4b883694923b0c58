"""The straight lines that stand for branches, and how well each is known.

The paper lays a line through the start of a branch and its mean. But a centerline does not run straight into an
intersection: it is bent as far as the surfaces of its roads overlap, it leans where the road ends, leaves the window or
was seen in passing, and roads bend further out. So the preset `default` fits a line to the part that can be trusted:

1. The centerline is sampled in rings around the inner circle (`_sample`). What lies near a dead end of the branch or
   near the border of the image is left out, and so is what is wider or narrower than the branch: there a mouth opens,
   or an edge was not seen (`keep_parallel`; for edges see `interloc.detection.edges`).
   Where other ground begins at one edge only, the other one was not seen: a parked car or the kerb of a median hid the
   road. There the axis lies half a width inside the edge that was seen, with the width between edges that both were
   (`move_from_unseen_edges`). Of the two lines, with and without that, the one counts that is known better.
2. From where its sides are parallel the axis is followed inwards along the edge that goes on, half a width from it: at
   an acute mouth or a rounded corner one edge turns away long before the other (`follow_edge`). A branch that bends is
   expected to bend on. One whose edges are too ragged to tell stays as it is.
3. The line begins there and takes in more of the branch, ring by ring, as long as the branch is straight, and half of
   the shortest part in any case: where a road turns at the mouth, its chord would point past the intersection. Of the
   parts from the shortest on that one counts whose line is known best where the roads meet.
   Where a parabola tells more of the branch than that line, and is known better where the roads meet, the line bends
   with it (`_bend`).
4. Two branches of one road lead on from each other along one curve. That is known best between them, where the lines
   of both would be prolonged, so both are laid along it (`_join_roads`).
5. A branch that ends at a through road is turned towards the right angle, by how badly its direction is known: of a
   side road that is passed only ten ragged metres are seen (`_square_stems`).
6. A line weighs the inverse of its variance where the roads meet, which grows with the distance from what it was
   fitted to (`_weight`, and `interloc.detection.refinement`).
7. Where a branch strays from its line farther out, it may do so nearer in, half as far (`_stray`): by that a mouth
   counts beside the line, and the point that lines fix is known.
"""

import math

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, Record, StructuredArray, UInt64Array
from interloc.config import BranchConfig
from interloc.detection.centerline import Centerline, Pieces
from interloc.detection.edges import (
    GAP,
    PLACE,
    RING_M,
    RING_PX,
    SLACK_M,
    SLACK_PX,
    follow_edge,
    keep_parallel,
    move_from_unseen_edges,
)
from interloc.detection.image import BinaryImage
from interloc.kernels import compiled
from interloc.kernels.bits import NOWHERE, nearest_clear

GRID_PX = 0.4  # scatter that the grid gives to the centerline of an ideal road
PIXEL_PX = 0.1  # how well the line of an ideal road is known
MIN_FIT_M = 3.0  # a line fitted to less would point anywhere
SIDE_BY_SIDE_RAD = math.radians(10.0)  # between two roads that do not meet there: two carriageways
PARTING_SIN = 0.25  # of half an angle between roads: below 29 degrees they part no farther out
LEAN = 4.0  # by how much the shortest line errs in direction more than its scatter tells; the longer, the less
BOWED = 0.3  # of the mean square of half widths: errors of an edge are long, so that much of them looks like a bend
STRAY = 0.5  # of how far a branch strays from its line outwards: how far it may do so inwards
LEADS_ON_COS = math.cos(math.radians(135.0))  # between branches that lead on from each other, though the road bends
ONE_ROAD_COS = math.cos(math.radians(120.0))  # the same, where one curve tells both


LINE = np.dtype(
    [
        ("point", np.float64, (2,)),
        ("direction", np.float64, (2,)),
        ("length", np.float64),
        ("rms", np.float64),
        ("weight", np.float64),
        ("first", np.int64),
        ("begin", np.float64),
        ("half_width", np.float64),
        ("is_parallel", np.bool_),
        ("bend", np.float64),
        ("doubt", np.float64),
        ("unsure", np.float64),
        ("stray", np.float64),
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
    Of the part that it was fitted to, with what lies between the branches of one road, pixels; infinite in the paper,
    where lines are as well known everywhere.
rms : float64
    Root mean square distance of that part from it, pixels.
weight : float64
    How much it counts: 1 in the paper, else the inverse of its variance at the candidate, 1 / m^2.
first : int64
    Ring at which that part begins.
begin : float64
    How far along the line that lies from the point, pixels; negative, but on the curve of two branches.
half_width : float64
    Usual half width of the road, pixels; 0 where none is known, and in the paper, which does not measure it.
is_parallel : bool
    Whether that part lies between parallel edges; else these are too ragged to tell.
bend : float
    Half the curvature of a branch that bends, towards the normal (column, -row) of its direction, 1 / pixels: the line
    is its tangent at the point.
doubt : float
    Mean square that the branch may bend by otherwise, as a share of the variance of the line in the middle.
unsure : float
    Mean square that the line may lie off at the candidate since its branch bends, pixels^2.
stray : float64
    Mean square of half the curvature by which the branch may stray from the line inwards, 1 / pixels^2.
"""

# Named tuples would stand in the files of compiled code by the name of their class, which may change; these do not.
_FIT = "row col width inner length shortest trim max_half_width ring slack straight square"
FIT = np.dtype([(name, np.float64) for name in _FIT.split()])
"""Row and column of a candidate, width and inner radius there, the settings `fit_length_m`, `fit_least_m` and `stop_m`,
half of the widest road that is measured, and lengths of `interloc.detection.edges`; pixels. `straight_deg` and
`square_std_deg`, radians."""


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
    width : float
        Road width at the candidate, pixels.
    config
    against
        Set where other ground was seen; None where that is not known: then every edge counts as seen.
    """
    pixel_m = centerline.resolution_m
    lengths_m = config.fit_length_m, config.fit_least_m, config.stop_m
    lengths = (length_m / pixel_m for length_m in lengths_m)
    angles = (math.radians(angle_deg) for angle_deg in (config.straight_deg, config.square_std_deg or 0.0))
    steps = max(RING_M / pixel_m, RING_PX), max(SLACK_M / pixel_m, SLACK_PX)
    fit = np.array((*candidate, width, pieces.inner, *lengths, centerline.max_half_width, *steps, *angles), FIT)[()]
    road, other = centerline.occupancy.words, NOWHERE if against is None else against.words
    lines = fit_lines(fit, centerline.pixels, pieces.traced, pieces.is_main, pieces.table, road, other)
    is_short = lines["length"] * pixel_m < MIN_FIT_M
    if is_short.any():
        mean = pieces.table["mean"][is_short]
        lines["point"][is_short], lines["direction"][is_short] = mean, _unit(mean - candidate)
        lines["length"][is_short] = lines["weight"][is_short] = 0.0
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
    # Round a bend an axis is longer than the circle is deep: as half of the circle is round, at most.
    inside, n_rings = int(np.pi * fit.inner / fit.ring) + 1, max(1, int(fit.length / fit.ring))
    axes, variances = np.zeros((pieces.size, inside + n_rings), PLACE), np.zeros(pieces.size)
    # Numba frees an array after its name was last mentioned, though a record of it may be read later: these stay.
    trial, bent = np.zeros(1, LINE), np.zeros(1, LINE)
    for i in range(pieces.size):
        main = traced[pieces[i].begin : pieces[i].end][is_main[pieces[i].begin : pieces[i].end]]
        _sample(axes[i, inside:], pixels, main, words, fit)
        parting = int(max(_parting(pieces, i, fit) - fit.inner, 0.0) / fit.ring)
        begin = inside + min(parting, n_rings - 1)
        moved = axes[i].copy()
        trial[:] = np.zeros(1, LINE)
        variances[i] = _fit_between_edges(lines[i], axes[i], begin, pieces[i].at_candidate, fit)
        if move_from_unseen_edges(moved, words, against, fit):
            moved_variance = _fit_between_edges(trial[0], moved, begin, pieces[i].at_candidate, fit)
            if trial[0].is_parallel and moved_variance <= variances[i]:
                lines[i], axes[i], variances[i] = trial[0], moved, moved_variance
    straight = lines.copy()
    for i in range(pieces.size):
        if lines[i].length > 0.0 and lines[i].is_parallel:
            bent[:] = straight[i : i + 1]
            _bend(bent[0], axes[i], lines[i].first, variances[i], fit)
            first = follow_edge(axes[i], bent[0], straight, i, words, against, fit)
            minimum = _fit_straight_part(lines[i], axes[i], first, fit)
            _bend(lines[i], axes[i], first, minimum, fit)
    scatters = _scatters(lines)
    _join_roads(lines, axes, scatters, fit)
    for i in range(lines.size):
        lines[i].weight = _weight(lines[i], scatters[i], 1.0, fit)
    if fit.square > 0.0:
        _square_stems(lines, scatters, fit)
    for i in range(pieces.size):
        if lines[i].length > 0.0:
            first = axes[i, lines[i].first]
            r, c = first.row - lines[i].point[0], first.col - lines[i].point[1]
            lines[i].begin = r * lines[i].direction[0] + c * lines[i].direction[1]
            _stray(lines[i], axes[i])
    return lines


@compiled
def _sample(axis: StructuredArray, pixels: StructuredArray, piece: Int32Array, words: UInt64Array, fit: Record) -> None:
    """Take the mean of the usable pixels of a piece in each ring, and the half width of the road at the last of them.

    The first ring lies at the inner circle, the others outside of it.
    """
    size, last = words.shape[0] - 2, np.zeros(axis.size, np.int32)
    tips = piece[pixels["is_tip"][piece]]
    for p in piece:
        pixel = pixels[p]
        ring = int((math.hypot(pixel.row - fit.row, pixel.col - fit.col) - fit.inner) / fit.ring)
        usable = ring < axis.size and pixel.border_distance >= fit.trim
        for t in tips:
            usable &= math.hypot(pixel.row - pixels[t].row, pixel.col - pixels[t].col) >= fit.trim
        if usable:
            place, last[ring] = axis[ring], p
            r, c = pixel.row - place.row, pixel.col - place.col
            place.n += 1.0
            place.row += r / place.n
            place.col += c / place.n
            place.rr += r * (pixel.row - place.row)
            place.rc += r * (pixel.col - place.col)
            place.cc += c * (pixel.col - place.col)
    for i in np.flatnonzero(axis["n"] > 0.0):
        row, col = pixels[last[i]].row, pixels[last[i]].col
        axis[i].half = nearest_clear(words, row, col, size, size, int(fit.max_half_width))


@compiled
def _parting(pieces: StructuredArray, which: int, fit: Record) -> float:
    """Return how far from the candidate the surface of a branch parts from that of its nearest neighbour, pixels.

    Two roads of width w at an angle t part at (w / 2) / sin(t / 2); the centerline is bent until there. Roads side by
    side are apart from where they begin.
    """
    minimum = np.pi
    piece, place = pieces[which], np.array([fit.row, fit.col])
    for i in range(pieces.size):
        other = pieces[i]
        if i != which and _angle(piece.start, piece.mean, other.start, other.mean) > SIDE_BY_SIDE_RAD:
            minimum = min(minimum, _angle(place, piece.mean, place, other.mean))
    distance: float = 0.5 * fit.width / max(math.sin(0.5 * minimum), PARTING_SIN)
    return distance


@compiled
def _angle(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> float:
    """Return the angle between the ways from a to b and from c to d, radians."""
    row, col, other_row, other_col = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    return abs(math.atan2(row * other_col - col * other_row, row * other_row + col * other_col))


@compiled
def _fit_between_edges(line: Record, axis: StructuredArray, begin: int, is_link: bool, fit: Record) -> float:
    """Fit a line to what of an axis lies between parallel edges; return its variance as `_fit_straight_part` does."""
    line.half_width, line.is_parallel = keep_parallel(axis, is_link, fit.slack)
    return _fit_straight_part(line, axis, begin, fit)


@compiled
def _fit_straight_part(line: Record, axis: StructuredArray, begin: int, fit: Record) -> float:
    """Fit a line by total least squares to an axis from one of its places on, as far as it is straight.

    Of the parts that are long enough it takes the one whose line is known best at the candidate. Returns the
    variance there by which lines compare; infinite where there is too little to fit.
    """
    first, minimum = -1, np.inf
    n, sr, sc, srr, src, scc = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, axis.size):
        place = axis[i]
        if place.n == 0.0:
            continue
        first = i if first < 0 else first
        r, c = place.row - fit.row, place.col - fit.col
        n += place.n
        sr += place.n * r
        sc += place.n * c
        srr += place.n * r * r + place.rr
        src += place.n * r * c + place.rc
        scc += place.n * c * c + place.cc
        if i == first:
            continue
        row, col, length = sr / n, sc / n, (i + 1 - first) * fit.ring
        vrr, vrc, vcc = srr / n - row * row, src / n - row * col, scc / n - col * col
        angle = 0.5 * math.atan2(2.0 * vrc, vrr - vcc)
        d_row, d_col = math.cos(angle), math.sin(angle)
        rms = math.sqrt(max(vrr * d_col * d_col - 2.0 * vrc * d_row * d_col + vcc * d_row * d_row, 0.0))
        if rms > fit.slack and length > 0.5 * fit.shortest:
            break
        far = (row * d_row + col * d_col) / length
        variance = (_scatter(rms) + PIXEL_PX**2) * spread(far, 0.0) / min(length, 0.5 * fit.length)
        if length > fit.shortest and variance > minimum:
            continue
        minimum = variance
        # Away from where the branch begins: the candidate may lie beyond the place that it comes from.
        if d_row * (place.row - axis[first].row) + d_col * (place.col - axis[first].col) < 0.0:
            d_row, d_col = -d_row, -d_col
        line.point[0], line.point[1] = fit.row + row, fit.col + col
        line.direction[0], line.direction[1] = d_row, d_col
        line.first, line.length, line.rms = first, length, rms
    return minimum


@compiled
def _bend(line: Record, axis: StructuredArray, begin: int, minimum: float, fit: Record) -> None:
    """Let a line bend with its branch where a parabola tells more of that, and is known better at the candidate.

    Of two errors that hide how a branch bends the mean square is known: of what it lies off the parabola, alike over
    `GAP` places, and of its half width: a mouth or a lay-by bends one edge of a road, its own bend both. The bend
    counts by the share of its mean square that is not due to them (James and Stein 1961); what is left of them grows
    with the square of the distance that the parabola is prolonged by.
    """
    places = begin + np.flatnonzero(axis["n"][begin:] > 0.0)
    next_best, straight = np.inf, line.length
    for count in range(places.size, 3 * GAP, -GAP):
        length = (places[count - 1] + 1 - places[0]) * fit.ring
        if length < straight:
            break
        part = axis[places[:count]]
        angle = math.atan2(part["row"][-1] - part["row"][0], part["col"][-1] - part["col"][0])
        d_row, d_col = math.sin(angle), math.cos(angle)
        curve = _parabola(part, d_row, d_col)
        row, col, square, lean, slope, bend, doubt, rms = curve
        if bend == 0.0 or rms > fit.slack:
            continue
        scatter = _scatter(rms) + PIXEL_PX**2
        away = (fit.row - row) * d_row + (fit.col - col) * d_col
        aside = slope * away + bend * (away * (away - lean) - square)
        variance = scatter * spread(away / length, doubt)
        cost = variance / min(length, 0.5 * fit.length)
        if cost > minimum:
            if cost < next_best:
                r, c = row + away * d_row + aside * d_col, col + away * d_col - aside * d_row
                off = (r - line.point[0]) * line.direction[1] - (c - line.point[1]) * line.direction[0]
                next_best, line.unsure = cost, max(off * off - variance, 0.0)
            continue
        minimum = next_best = cost
        line.unsure = variance - scatter * spread(away / length, 0.0)
        _lay_along(line, curve, d_row, d_col, length)
        line.first = places[0]


@compiled
def _parabola(part: StructuredArray, d_row: float, d_col: float) -> tuple[float, ...]:
    """Fit a parabola to places of an axis that lead in a direction.

    Returns the mean of the places, along their direction their mean square and how lopsided they lie, the slope and the
    bend of the parabola, what of the bend is doubtful as a share of the variance in the middle, and the root mean
    square of what the places lie off; no bend where all of it is doubtful.
    """
    weight, half = part["n"] / part["n"].sum(), part["half"][part["half"] > 0.0]
    row, col = (weight * part["row"]).sum(), (weight * part["col"]).sum()
    along = (part["row"] - row) * d_row + (part["col"] - col) * d_col
    across = (part["row"] - row) * d_col - (part["col"] - col) * d_row
    square = (weight * along**2).sum()
    lean, slope = (weight * along**3).sum() / square, (weight * along * across).sum() / square
    bow = along * (along - lean) - square  # orthogonal to lines
    bow_square, bend = (weight * bow**2).sum(), (weight * bow * across).sum()
    bend /= bow_square
    within = (part["rr"] * d_col**2 - 2.0 * part["rc"] * d_row * d_col + part["cc"] * d_row**2).sum()
    rest = (weight * (across - slope * along - bend * bow) ** 2).sum() + within / part["n"].sum()
    rms = math.sqrt(max(rest, 0.0))
    scatter = _scatter(rms) + PIXEL_PX**2
    doubt = 2.0 * scatter / (part.size / GAP - 3.0) + BOWED * (half.var() if half.size > 0 else 0.0)
    share = max(1.0 - doubt / max(bend**2 * bow_square, 1e-9), 0.0)
    return row, col, square, lean, slope, share * bend, share * doubt / scatter, rms


@compiled
def _lay_along(line: Record, curve: tuple[float, ...], d_row: float, d_col: float, length: float) -> None:
    """Lay a line along a parabola that was fitted in a direction to so long a part."""
    row, col, square, lean, slope, bend, doubt, rms = curve
    tangent = slope - bend * lean
    norm = math.sqrt(1.0 + tangent * tangent)
    line.point[0], line.point[1] = row - bend * square * d_col, col + bend * square * d_row
    line.direction[0], line.direction[1] = (d_row + tangent * d_col) / norm, (d_col - tangent * d_row) / norm
    line.length, line.rms, line.bend, line.doubt = length, rms, bend, doubt


@compiled
def _join_roads(lines: StructuredArray, axes: StructuredArray, scatters: FloatArray, fit: Record) -> None:
    """Lay the lines of two branches that lead on from each other along one curve, where it is known better."""
    weights, gains, curve = np.zeros(lines.size), np.zeros((lines.size, lines.size)), np.zeros(1, LINE)
    for i in range(lines.size):
        weights[i] = _weight(lines[i], _scatter(lines[i].rms), 1.0, fit)
        for j in range(i):
            alike = lines[i].direction[0] * lines[j].direction[0] + lines[i].direction[1] * lines[j].direction[1]
            if weights[i] * weights[j] > 0.0 and lines[i].is_parallel and lines[j].is_parallel and alike < ONE_ROAD_COS:
                curve[:] = _joint(lines, axes, i, j, fit)
                gains[i, j] = _weight(curve[0], _scatter(curve[0].rms), 2.0, fit) - weights[i] - weights[j]
    while gains.size > 0 and gains.max() > 0.0:
        one, other = divmod(int(gains.argmax()), lines.size)
        curve[:] = _joint(lines, axes, one, other, fit)
        for k, sign in ((one, 1.0), (other, -1.0)):
            gains[k], gains[:, k], scatters[k] = 0.0, 0.0, max(scatters[k], _scatter(curve[0].rms))
            for at in range(2):
                lines[k].point[at], lines[k].direction[at] = curve[0].point[at], sign * curve[0].direction[at]
            lines[k].bend, lines[k].doubt, lines[k].unsure = sign * curve[0].bend, curve[0].doubt, 0.0
            lines[k].length, lines[k].rms = curve[0].length, curve[0].rms


@compiled
def _joint(lines: StructuredArray, axes: StructuredArray, one: int, other: int, fit: Record) -> StructuredArray:
    """Return the curve through what the lines of two branches were fitted to; of no length where these overlap."""
    curve, is_part = np.zeros(1, LINE), axes["n"] > 0.0
    for k in (one, other):
        is_part[k, : lines[k].first] = False
        is_part[k, lines[k].first + round(lines[k].length / fit.ring) :] = False
    begin, end = axes[one][is_part[one]], axes[other][is_part[other]]
    part = np.concatenate((begin, end))
    d_row = lines[one].direction[0] - lines[other].direction[0]
    d_col = lines[one].direction[1] - lines[other].direction[1]
    norm = math.hypot(d_row, d_col)
    d_row, d_col = d_row / norm, d_col / norm
    along = part["row"] * d_row + part["col"] * d_col
    if part.size > 3 * GAP and along[: begin.size].min() >= along[begin.size :].max():
        _lay_along(curve[0], _parabola(part, d_row, d_col), d_row, d_col, along.max() - along.min())
    return curve


@compiled
def _stray(line: Record, axis: StructuredArray) -> None:
    """Take from the last place of an axis, beyond what its line was fitted to, by how much the branch may stray."""
    last = axis[np.flatnonzero(axis["n"] > 0.0)[-1]]
    r, c = last.row - line.point[0], last.col - line.point[1]
    along = r * line.direction[0] + c * line.direction[1]
    if along > 0.5 * line.length:
        across = r * line.direction[1] - c * line.direction[0]
        line.stray = (STRAY * (across / along**2 - line.bend)) ** 2


@compiled
def _scatter(rms: float) -> float:
    """Return the mean square scatter of a branch around its line, beyond that of the grid, pixels^2."""
    return max(rms - GRID_PX, 0.0) ** 2


@compiled
def _scatters(lines: StructuredArray) -> FloatArray:
    """Return the scatter of each branch. That of a short one may be small by chance, so half of each is that of all."""
    scatters = np.array([_scatter(rms) for rms in lines["rms"]])
    mixed: FloatArray = 0.5 * (scatters + (lines["length"] * scatters).sum() / max(lines["length"].sum(), 1e-9))
    return mixed


@compiled
def spread(far: float, doubt: float) -> float:
    """Return by how much the variance of a line is greater than in the middle of what it was fitted to.

    A line that is prolonged is known the worse the farther off it was fitted, and one that may bend the more so: by
    the polynomials of degree 1 and 2 that are orthogonal over that part, and of mean square 1 there.
    """
    grown: float = 1.0 + 12.0 * far * far + 180.0 * doubt * (far * far - 1.0 / 12.0) ** 2
    return grown


@compiled
def _weight(line: Record, scatter: float, maximum: float, fit: Record) -> float:
    """Return the length of a line, up to so many halves of a fit, over its variance at the candidate."""
    if line.length == 0.0:
        return 0.0
    off = (fit.row - line.point[0]) * line.direction[0] + (fit.col - line.point[1]) * line.direction[1]
    variance = (scatter + PIXEL_PX**2) * spread(off / line.length, line.doubt)
    weight: float = min(line.length / (0.5 * fit.length), maximum) / variance
    return weight


@compiled
def _square_stems(lines: StructuredArray, scatters: FloatArray, fit: Record) -> None:
    """Turn branches that end at a through road towards the right angle, by how badly their direction is known.

    A ragged side road leans as a whole, the more the less of it is seen, and its scatter tells only a part of that. The
    through road is that of the two best-known branches that continue each other, else the best-known branch. Branches
    that continue another one are no stems.
    """
    if lines["length"].sum() == 0.0:
        return
    variances = 12.0 * (LEAN * fit.shortest) ** 2 * scatters / np.maximum(lines["length"], 1e-9) ** 4  # of directions
    variances[lines["length"] == 0.0] = np.inf
    one, other, minimum = variances.argmin(), -1, np.inf
    leads_on = np.zeros(lines.size, np.bool_)
    for i in range(lines.size):
        for j in range(i):
            alike = lines[i].direction[0] * lines[j].direction[0] + lines[i].direction[1] * lines[j].direction[1]
            if variances[i] + variances[j] < np.inf and alike < -math.cos(fit.straight):
                leads_on[i] = leads_on[j] = True
            if variances[i] + variances[j] < minimum and alike < LEADS_ON_COS:
                one, other, minimum = i, j, variances[i] + variances[j]
    row, col = lines[one].direction
    if other >= 0:
        row, col = row - lines[other].direction[0], col - lines[other].direction[1]
    road = math.atan2(row, col)
    for i in range(lines.size):
        if lines[i].length == 0.0 or i in (one, other) or leads_on[i]:
            continue
        angle = math.atan2(lines[i].direction[0], lines[i].direction[1])
        off = (angle - road) % np.pi - 0.5 * np.pi  # from the right angle
        if math.cos(off) > -LEADS_ON_COS:
            prior = fit.square**2 * (1.0 + (off / fit.straight) ** 2) ** 2
            angle -= off * variances[i] / (variances[i] + prior)
            lines[i].direction[0], lines[i].direction[1] = math.sin(angle), math.cos(angle)
