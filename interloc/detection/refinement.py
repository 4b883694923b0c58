"""Correction of the intersection point by its branches (paper, section III-C.2)."""

import math
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, Record, StructuredArray, UInt64Array
from interloc.detection.branches import Branches
from interloc.detection.edges import SLACK_M, are_seen, edges_across
from interloc.detection.image import BinaryImage
from interloc.detection.lines import LEADS_ON_COS, SIDE_BY_SIDE_RAD, spread
from interloc.kernels import compiled
from interloc.kernels.bits import NOWHERE

# Forks: where one road parts into others that lead on (beyond the paper).
#
# At a fork, or where a side road joins at an acute angle, the centerline branches far from where the axes meet, and
# the arms are often bent in between, so that their lines meet somewhere else. The surface tells the place: up to it
# the road has parallel sides, and beyond it the outer edges are those of the arms. So each place on the axis of the
# stem is tried: with arms that lead straight on from it to where their own axes are known, the edges must be where
# they are seen.
#
# Places and directions are rows and columns, lengths pixels.

FORK_COS = math.cos(math.radians(125.0))  # between a stem and an arm that leads straight on
ARM_BEGIN = 0.5  # radii of the inner circle from the candidate outwards: from there on the line of an arm is its axis
BEHIND = 2.0  # half widths by which the stem is looked at beyond the inner circle
ALIKE = 10.0  # pixels over which the errors of an edge are alike
FORK_M2 = 0.02  # of the variance of a fork along its stem: what its edges do not tell
ARM_M2 = 0.25, 2.0  # variance of where an arm passes its fork: a constant, and a multiple of that of the fork
REACH = 4.0  # half widths within which an edge is looked for


@compiled
def find_fork(
    lines: StructuredArray, candidate: FloatArray, inner: float, words: UInt64Array
) -> tuple[int, float, float, float]:
    """Find the place where the road of one branch parts into all others, if that is what they are.

    Parameters
    ----------
    lines, candidate, inner
        See `interloc.detection.branches.Branches`.
    words
        Of the road.

    Returns
    -------
    stem : int
        The branch that parts, -1 for none: two others or more, all of them, must lead on within 55 degrees of straight,
        45 where they bend, and its width must be known. Of branches without lines it is enough where they lead:
        straight from the candidate through their means. Lines that bend must do so where they begin, too.
    row, col : float
        From the candidate to the place, pixels.
    variance : float
        Of the place along the stem, pixels^2, by how well each place explains the edges; infinite for none.
    """
    stem = _stem(lines)
    if stem < 0 or lines[stem].half_width == 0.0:
        return -1, 0.0, 0.0, np.inf
    half, (d_row, d_col) = lines[stem].half_width, lines[stem].direction
    size = int(inner + BEHIND * half)
    r, c = _on_line(lines[stem], candidate, size)
    arms = np.empty((lines.size - 1, 4))
    for k in range(lines.size - 1):
        arm = lines[k if k < stem else k + 1]
        row, col = _on_line(arm, candidate, ARM_BEGIN * inner)
        along = -(arm.direction[0] * d_row + arm.direction[1] * d_col)
        arms[k, 0] = (r - row) * d_row + (c - col) * d_col
        arms[k, 1] = (col - c) * d_row - (row - r) * d_col
        arms[k, 2] = (arm.direction[1] * d_row - arm.direction[0] * d_col) / along
        arms[k, 3] = arm.half_width if arm.half_width > 0.0 else half
    edges = np.empty((size, 2))
    for s in range(size):
        edges[s] = edges_across(words, r - s * d_row, c - s * d_col, d_row, d_col, REACH * half)
    misfits = np.array([_misfit(edges, place, half, arms) for place in range(size)])
    at = misfits.argmin()
    error = max(0.5 * misfits[at] / size, 0.5)  # of an edge
    chance = np.exp((misfits[at] - misfits) / (ALIKE * error))
    variance = (chance * (np.arange(size) - at) ** 2).sum() / chance.sum()
    return stem, r - at * d_row - candidate[0], c - at * d_col - candidate[1], variance


@compiled
def _stem(lines: StructuredArray) -> int:
    """Return the branch that all others lead on from, of which there is one at most; -1 for none."""
    if lines.size < 3:
        return -1
    begins = [_tangent(line, line.begin) for line in lines]
    for i in range(lines.size):
        leads_on = True
        for j in range(lines.size):
            alike = lines[i].direction[0] * lines[j].direction[0] + lines[i].direction[1] * lines[j].direction[1]
            alike = max(alike, begins[i][2] * begins[j][2] + begins[i][3] * begins[j][3])
            leads_on &= j == i or alike < (FORK_COS if lines[j].bend == 0.0 else LEADS_ON_COS)
        if leads_on:
            return i
    return -1


@compiled
def _tangent(line: Record, along: float) -> tuple[float, float, float, float]:
    """Return the place on a line that lies so far along from its point, and the direction of the line there."""
    (row, col), (d_row, d_col), slope, aside = line.point, line.direction, 2.0 * line.bend * along, line.bend * along**2
    row, col = row + along * d_row + aside * d_col, col + along * d_col - aside * d_row
    norm = math.sqrt(1.0 + slope * slope)
    return row, col, (d_row + slope * d_col) / norm, (d_col - slope * d_row) / norm


@compiled
def _on_line(line: Record, candidate: FloatArray, away: float) -> tuple[float, float]:
    """Return the place on a line that lies so far out from the one nearest to the candidate."""
    (row, col), (d_row, d_col) = line.point, line.direction
    along = (candidate[0] - row) * d_row + (candidate[1] - col) * d_col + away
    return row + along * d_row, col + along * d_col


@compiled
def _misfit(edges: FloatArray, place: int, half: float, arms: FloatArray) -> float:
    """Return by how much the edges lie off if the road parts at a place, each by a half width at most, along the stem.

    ``edges`` are the distances from the axis of the stem to the left and the right edge, inwards pixel by pixel. A row
    of ``arms`` holds where its line begins, along that axis and to the left of it, its slope, and its half width.
    """
    total = 0.0
    for s in range(edges.shape[0]):
        left = right = half if s <= place else 0.0
        for along, aside, slope, half_width in arms:
            tangent, axis = slope, aside + (s - along) * slope
            if place < along and s <= along:  # straight on to where its line begins
                tangent = aside / (along - place)
                axis = (s - place) * tangent
            across = half_width * math.sqrt(1.0 + tangent * tangent)
            if s > place or tangent > 0.0:  # the outer edge of an arm meets that of the stem before the place
                left = max(left, across + axis)
            if s > place or tangent < 0.0:
                right = max(right, across - axis)
        left, right = min(left, REACH * half), min(right, REACH * half)
        total += min(abs(edges[s, 0] - left), half) + min(abs(edges[s, 1] - right), half)
    return total


# Lines are near-parallel, and their meeting point means nothing, when the smaller eigenvalue of the normal matrix is
# less than this share of their number: a fan of lines within about 10 degrees.
PARALLEL = math.sin(math.radians(10.0)) ** 2 / 2

# Mouths of side roads (beyond the paper).
#
# Where a side road bends before it comes to a through road, its line points past the intersection, and the centerline
# branches far from it. Its mouth tells the place: with a fillet of radius r, a corner of the angle t begins at
# r / tan(t / 2) from where the edges would meet, and that is (w / 2) / tan(t / 2) from the intersection where both
# roads are as wide as w. At t and pi - t the two are as cos^2(t / 2) to sin^2(t / 2), whatever r and w are.
# Line and mouth count by what is known of them. Of roads that bend little a line is known far better.

MOUTH_M = 0.8  # from the edge of the through road to where its mouth is measured, and the same again for a second time
MOUTH_SHARE = 0.35  # of half the width of a mouth: standard deviation of what it tells
MOUTHS_AGREE = 1.6  # of that: by which what the two of them tell may differ; edges are ragged if it is more

LOPSIDED = 0.25  # weight of a candidate between a through road and one side road: its road reaches farther out there
UNKNOWN_M = 30.0  # standard deviation of a point that lines do not fix
ROUNDS = 4  # the weights of the lines are those at the point of the round before
TOLERANCE = 1.6  # radii of the inner circle that a line may pass the point at before it counts a quarter
MAX_SHIFTS = 2.5  # radii of the inner circle by which a point may be moved along the road


@dataclass(frozen=True)
class Junction:
    """A refined intersection in the image."""

    position: FloatArray
    """(2,) float64: row and column, pixels."""
    residual: float
    """Root mean square distance of the point from the lines, pixels; infinite where the lines do not fix it."""
    std_m: float
    """Standard deviation of the point along each axis, metres, by how well its lines are known and meet; where these
    are as well known everywhere, as in the paper, by how they lie and meet. At least `SLACK_M`."""
    branches: Branches
    """What it was computed from."""


def refine(
    branches: Branches,
    prior_weight: float = 0.0,
    occupancy: BinaryImage | None = None,
    against: BinaryImage | None = None,
) -> Junction:
    """Move the candidate to the point of least squared distances to the lines of its branches, within the inner disc.

    Near-parallel lines do not fix a point: the candidate stays where it is and its residual is infinite. With the road
    it moves to where it forks, if they are the lines of a fork (`interloc.detection.refinement`).

    Parameters
    ----------
    branches
    prior_weight : float
        Weight of the candidate itself beside the lines; 0 as in the paper. With the road it is less along the line that
        halves an acute angle, and a fork counts by its edges, along its stem, and moves the lines of its arms; there is
        neither where the blob holds several intersections: centerlines branch anywhere in it. Beside a side road it is
        a quarter; the mouth of that, where it was seen, takes its place, and moves the line of the side road by how
        badly that is known.
    occupancy
        The road. With it each line counts by what is known of it at the point, not at the candidate, and the point may
        leave the inner disc.
    against
        Set where other ground was seen. Only a mouth of which both ends were seen counts; all, where that is not known.

    Notes
    -----
    Paper, eq. 10. With unit normals n, points a and weights w (1 in the paper) of the lines, the minimum solves
    (sum w n n^T) p = sum w n n^T a. The candidate is two more lines through itself, at right angles; a fork is one,
    across its stem. With the road it is found by iteratively reweighted least squares (Geman and McClure, "Statistical
    methods for tomographic image reconstruction", 1987): a line that passes far off, because its road bends before it
    comes to the intersection, counts little. The variance of the point is the mean of those along both axes, that is
    half the trace of the inverse of the normal matrix, and the mean squares of its distances from the lines and of what
    an edge may lie off.
    """
    weight = 0.0 if branches.is_part else prior_weight
    words = NOWHERE if occupancy is None else occupancy.words
    other, pixel_m = NOWHERE if against is None else against.words, branches.resolution_m
    row, col, residual, std_m = _meet(branches.lines, branches.candidate, branches.inner, weight, words, other, pixel_m)
    return Junction(branches.candidate + np.array([row, col]), residual, std_m, branches)


@compiled
def _meet(
    lines: StructuredArray,
    candidate: FloatArray,
    inner: float,
    prior_weight: float,
    words: UInt64Array,
    against: UInt64Array,
    pixel_m: float,
) -> tuple[float, float, float, float]:
    """Return by how many rows and columns the candidate moves, the residual, and the standard deviation in metres."""
    count, row, col, limit = lines.size, 0.0, 0.0, inner
    stem, side, m_row, m_col, variance, mouth_variance = -1, -1, 0.0, 0.0, np.inf, np.inf
    # Of each line: unit normal, way from the line to the candidate, weight, variance by how far its branch may stray.
    given = np.zeros((count + 3, 6))
    for i in range(count):
        (d_row, d_col), point = lines[i].direction, lines[i].point
        given[i] = d_col, -d_row, candidate[0] - point[0], candidate[1] - point[1], lines[i].weight, 0.0
    given[count] = 1.0, 0.0, 0.0, 0.0, prior_weight, 0.0
    given[count + 1] = 0.0, 1.0, 0.0, 0.0, prior_weight, 0.0
    if words.size > 0:
        limit = MAX_SHIFTS * inner
        (a, b), known = _acute_angle(lines)
        given[count] = a, b, 0.0, 0.0, known * prior_weight, 0.0
        given[count + 1] = b, -a, 0.0, 0.0, prior_weight, 0.0
        stem, row, col, variance = find_fork(lines, candidate, inner, words)
        if stem >= 0:
            d_row, d_col = lines[stem].direction
            known = 0.0 if prior_weight == 0.0 else 1.0 / (FORK_M2 + variance * pixel_m**2)
            given[count + 2] = d_row, d_col, -row, -col, known, 0.0
            row, col = _within(row, col, limit)
    if not _fix_a_point(given[:count]):
        return row, col, np.inf, UNKNOWN_M
    if words.size > 0:
        row, col = 0.0, 0.0
        side = _side_road(lines) if stem < 0 and prior_weight > 0.0 else -1
    for turn in range(1 if words.size == 0 else ROUNDS):
        if words.size > 0:
            _weigh_at(given, lines, candidate, inner, row, col, pixel_m)
        if side >= 0 and turn == 1:
            place = candidate[0] + row, candidate[1] + col
            r, c, std = _mouth(lines, side, place, words, against, MOUTH_M / pixel_m)
            m_row, m_col, mouth_variance = row + r, col + c, (std * pixel_m) ** 2
            given[count:, 4] *= LOPSIDED if std == np.inf else 0.0
        _move_arms(given, lines, stem, variance * pixel_m**2)
        if mouth_variance < np.inf:
            _move_toward(given[side], m_row, m_col, mouth_variance)
        row, col = _solve(given)
        row, col = _within(row, col, limit)
    normals, ways, weights = given[:count, :2], given[:count, 2:4], given[:count, 4]
    squares = (normals * (ways + np.array([row, col]))).sum(axis=1) ** 2
    residual = math.sqrt((weights * squares).sum() / weights.sum() + lines["unsure"].mean())
    given[:, 4] /= 1.0 + given[:, 4] * given[:, 5]
    # No line is known better than an edge: what is wrong with one label is wrong with those beside it.
    return row, col, residual, math.sqrt(_variance(given) + (residual * pixel_m) ** 2 + SLACK_M**2)


@compiled
def _move_arms(given: FloatArray, lines: StructuredArray, stem: int, variance: float) -> None:
    """Move the lines of arms towards a fork, if it counts, by its variance along the stem: they bend from there on."""
    d_row, d_col, row, col, weight, _ = given[lines.size + 2]
    for i in range(lines.size):
        if i != stem and lines[i].length > 0.0 and weight > 0.0:
            across = given[i, 0] * d_row + given[i, 1] * d_col
            _move_toward(given[i], -row, -col, ARM_M2[0] + ARM_M2[1] * variance * across**2)


@compiled
def _move_toward(line: FloatArray, row: float, col: float, variance: float) -> None:
    """Move a line towards where its mouth or fork tells, by how badly it is known; there it does not stray."""
    known = 1.0 / line[4] + line[5]
    off = known / (known + variance) * _distance(line, row, col)
    line[2] -= off * line[0]
    line[3] -= off * line[1]
    line[5] = 0.0


@compiled
def _variance(given: FloatArray) -> float:
    """Return the variance along each axis of the point of least squared distances, by the weights of the lines."""
    a, b, d = UNKNOWN_M**-2, 0.0, UNKNOWN_M**-2  # of the normal matrix
    for n_row, n_col, _, _, weight, _ in given:
        a += weight * n_row * n_row
        b += weight * n_row * n_col
        d += weight * n_col * n_col
    variance: float = 0.5 * (a + d) / (a * d - b * b)
    return variance


@compiled
def _weigh_at(
    given: FloatArray,
    lines: StructuredArray,
    candidate: FloatArray,
    inner: float,
    row: float,
    col: float,
    pixel_m: float,
) -> None:
    """Lay each line as it runs beside a place so far from the candidate, and weigh it by what is known of it there."""
    for i in range(lines.size):
        line, (d_row, d_col) = lines[i], lines[i].direction
        r, c = candidate[0] - line.point[0], candidate[1] - line.point[1]
        if line.length > 0.0:
            here = r * d_row + c * d_col
            there = here + row * d_row + col * d_col
            # Where it bends, it is its tangent beside the point.
            r, c, d_row, d_col = _tangent(line, there)
            given[i, :4] = d_col, -d_row, candidate[0] - r, candidate[1] - c
            off = _distance(given[i], row, col) / (TOLERANCE * inner)
            # A line is known best in the middle of what it was fitted to (the variance of a prediction).
            known = spread(here / line.length, line.doubt) / spread(there / line.length, line.doubt)
            given[i, 4] = line.weight * known / (1.0 + off * off) ** 2
            if line.stray > 0.0:
                given[i, 5] = line.stray * ((there * there - line.length * line.length / 12.0) * pixel_m) ** 2


@compiled
def _side_road(lines: StructuredArray) -> int:
    """Return which of three branches ends at the road of the two others, which lead on from each other; -1 for none."""
    side, minimum = -1, LEADS_ON_COS
    for k in range(3 if lines.size == 3 else 0):
        one, other = lines[(k + 1) % 3], lines[(k + 2) % 3]
        alike = one.direction[0] * other.direction[0] + one.direction[1] * other.direction[1]
        if alike < minimum and one.is_parallel and other.is_parallel:
            side, minimum = k, alike
    is_known = side >= 0 and (lines["length"] > 0.0).all() and (lines["half_width"] > 0.0).all()
    return side if is_known else -1


@compiled
def _mouth(
    lines: StructuredArray, side: int, place: tuple[float, float], words: UInt64Array, against: UInt64Array, step: float
) -> tuple[float, float, float]:
    """Return where the mouth of a side road tells that it joins, seen from a place on the through road.

    That is rows and columns from the place, along the through road, if the side road leads there straight from where
    its axis begins to be known, and the standard deviation; infinite unless both ends were seen, and tell the same.
    """
    line, one, other = lines[side], lines[(side + 1) % 3], lines[(side + 2) % 3]
    (r, c), begin = place, _tangent(line, line.begin)
    n_row, n_col = other.direction[1] - one.direction[1], one.direction[0] - other.direction[0]
    toward = (begin[0] - r) * n_row + (begin[1] - c) * n_col
    norm = math.copysign(math.hypot(n_row, n_col), toward)
    n_row, n_col = n_row / norm, n_col / norm  # across the through road, to the side road
    d_row, d_col = n_col, -n_row
    along, across = (begin[0] - r) * d_row + (begin[1] - c) * d_col, toward / norm
    found, width = np.zeros(2), 0.0
    for k in range(2):
        half = 0.5 * (one.half_width + other.half_width) + (k + 1) * step
        row, col, reach = r + half * n_row, c + half * n_col, REACH * half
        left, right = edges_across(words, row, col, n_row, n_col, reach)
        width += left + right
        is_left, is_right = are_seen(against, row, col, n_row, n_col, left, right)
        is_mouth = is_left and is_right and max(left, right) < reach and left + right >= line.half_width
        if not is_mouth or across < half:
            return 0.0, 0.0, np.inf
        for _ in range(ROUNDS):
            ahead = along - found[k]
            share = 0.5 - 0.5 * ahead / math.hypot(ahead, across)  # sin^2 of half the angle
            found[k] = share * right - (1.0 - share) * left - (half - line.half_width) * ahead / across
    if abs(found[0] - found[1]) > MOUTHS_AGREE * step:
        return 0.0, 0.0, np.inf
    return found.mean() * d_row, found.mean() * d_col, MOUTH_SHARE * width / 4.0


@compiled
def _distance(line: FloatArray, row: float, col: float) -> float:
    """Return the signed distance from a line of a place so many rows and columns from the candidate."""
    distance: float = (line[2] + row) * line[0] + (line[3] + col) * line[1]
    return distance


@compiled
def _fix_a_point(given: FloatArray) -> bool:
    """Return whether the lines that count are not near-parallel, however unlike their weights."""
    count, a, b, d = 0, 0.0, 0.0, 0.0  # of the normal matrix
    for n_row, n_col, _, _, weight, _ in given:
        if weight > 0.0:
            a += n_row * n_row
            b += n_row * n_col
            d += n_col * n_col
            count += 1
    smaller_eigenvalue: float = (a + d) / 2 - math.hypot((a - d) / 2, b)
    return count >= 2 and smaller_eigenvalue >= PARALLEL * count


@compiled
def _solve(given: FloatArray) -> tuple[float, float]:
    """Return rows and columns from the candidate to the point of least squared distances."""
    a, b, d, u, v = 0.0, 0.0, 0.0, 0.0, 0.0
    for n_row, n_col, row, col, weight, _ in given:
        off = row * n_row + col * n_col
        a += weight * n_row * n_row
        b += weight * n_row * n_col
        d += weight * n_col * n_col
        u -= weight * n_row * off
        v -= weight * n_col * off
    determinant = a * d - b * b
    return (d * u - b * v) / determinant, (a * v - b * u) / determinant


@compiled
def _within(row: float, col: float, limit: float) -> tuple[float, float]:
    length = math.hypot(row, col)
    share = limit / length if length > limit else 1.0
    return row * share, col * share


@compiled
def _acute_angle(lines: StructuredArray) -> tuple[tuple[float, float], float]:
    """Return the direction that halves the smallest angle between roads, and what the candidate is known along it.

    The surfaces of roads at an angle t part at 1 / sin(t / 2) half widths, where their centerline branches. So along
    the line that halves an acute angle the candidate lies off by more than at a right one, and its standard deviation
    grows by the square of that; across it the candidate is known as well as any.
    """
    cosine = -math.cos(SIDE_BY_SIDE_RAD)  # of the smallest angle, but for roads side by side or straight on
    row, col = 1.0, 0.0
    for i in range(lines.size):
        for j in range(i):
            if lines[i].length > 0.0 and lines[j].length > 0.0:
                (d_row, d_col), (o_row, o_col) = lines[i].direction, lines[j].direction
                alike = d_row * o_row + d_col * o_col
                if cosine < alike < math.cos(SIDE_BY_SIDE_RAD):
                    cosine = alike
                    row, col = d_row + o_row, d_col + o_col
    half, norm = 0.5 * math.acos(min(cosine, 1.0)), math.hypot(row, col)
    spread = max(1.0, math.sin(math.pi / 4) / math.sin(half))
    return (row / norm, col / norm), spread**-4
