"""Correction of the intersection point by its branches (paper, section III-C.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, Record, StructuredArray, UInt64Array
from interloc.detection.branches import Branches
from interloc.detection.forks import find_fork
from interloc.detection.image import BinaryImage
from interloc.detection.lines import SIDE_BY_SIDE_COS
from interloc.kernels import compiled

# Lines are near-parallel, and their meeting point means nothing, when the smaller eigenvalue of the normal matrix is
# less than this share of their number: a fan of lines within about 10 degrees.
PARALLEL = math.sin(math.radians(10.0)) ** 2 / 2

ACUTE_SIN = 0.1  # of half an angle between roads: below 12 degrees the candidate is known no worse
ROUNDS = 4  # the weights of the lines are those at the point of the round before
TOLERANCE = 1.6  # radii of the inner circle that a line may pass the point at before it counts a quarter
MAX_SHIFTS = 2.5  # radii of the inner circle by which a point may be moved along the road


@dataclass(frozen=True)
class Junction:
    """A refined intersection in the image.

    Attributes
    ----------
    position : (2,) float64
        Row and column, pixels.
    residual : float
        Root mean square distance of the point from the lines, pixels; infinite where the lines do not fix it.
    branches
        What it was computed from.
    """

    position: FloatArray
    residual: float
    branches: Branches


def refine(
    branches: Branches, prior_weight: float = 0.0, occupancy: BinaryImage | None = None, fork_weight: float = 0.0
) -> Junction:
    """Move the candidate to the point of least squared distances to the lines of its branches, within the inner disc.

    Near-parallel lines do not fix a point: the candidate stays where it is and its residual is infinite. With the road
    it moves to where it forks, if they are the lines of a fork (`interloc.detection.forks`).

    Parameters
    ----------
    branches
    prior_weight : float
        Weight of the candidate itself beside the lines; 0 as in the paper. With the road it is less along the line that
        halves an acute angle, and none where the blob holds several intersections: centerlines branch anywhere in it.
        Only with it the place of a fork counts, along its stem.
    occupancy
        The road. With it each line counts by what is known of it at the point, not at the candidate, and the point may
        leave the inner disc.
    fork_weight : float
        Weight of the place of a fork along its stem, with the road; 0: forks are not looked for.

    Notes
    -----
    Paper, eq. 10. With unit normals n, points a and weights w (1 in the paper) of the lines, the minimum solves
    (sum w n n^T) p = sum w n n^T a. With the road it is found by iteratively reweighted least squares (Geman and
    McClure, "Statistical methods for tomographic image reconstruction", 1987): a line that passes far off, because its
    road bends before it comes to the intersection, counts little.
    """
    row, col, residual = _meet(
        branches.lines,
        branches.candidate,
        branches.inner,
        0.0 if branches.is_part else prior_weight,
        None if occupancy is None else occupancy.words,
        fork_weight,
    )
    return Junction(branches.candidate + np.array([row, col]), residual, branches)


@compiled
def _meet(
    lines: StructuredArray,
    candidate: FloatArray,
    inner: float,
    prior_weight: float,
    words: UInt64Array | None,
    fork_weight: float,
) -> tuple[float, float, float]:
    """Return by how many rows and columns the candidate moves, and the residual."""
    stem, row, col = -1, 0.0, 0.0
    if words is not None and fork_weight > 0.0:
        stem, row, col = find_fork(lines, candidate, inner, words)
    if not _fix_a_point(lines):
        row, col = _within(row, col, MAX_SHIFTS * inner)
        return row, col, np.inf
    weights = lines["weight"].copy()
    if words is None:
        prior = prior_weight, 0.0, prior_weight, 0.0, 0.0
        row, col = _solve(lines, weights, candidate, prior)
        row, col = _within(row, col, inner)
    else:
        prior = _prior(lines, prior_weight)
        if stem >= 0 and prior_weight > 0.0:
            prior = _with_fork(prior, lines[stem].direction, row, col, fork_weight)
        row, col = 0.0, 0.0
        for _ in range(ROUNDS):
            for i in range(lines.size):
                line = lines[i]
                if line.length > 0.0:
                    off = _distance(line, candidate, row, col) / (TOLERANCE * inner)
                    here = _along(line, candidate, 0.0, 0.0) / line.length
                    there = _along(line, candidate, row, col) / line.length
                    # A line is known best in the middle of what it was fitted to (the variance of a prediction).
                    at_point = line.weight * (1.0 + 12.0 * here * here) / (1.0 + 12.0 * there * there)
                    weights[i] = at_point / (1.0 + off * off) ** 2
            row, col = _solve(lines, weights, candidate, prior)
            row, col = _within(row, col, MAX_SHIFTS * inner)
    total = 0.0
    for i in range(lines.size):
        total += weights[i] * _distance(lines[i], candidate, row, col) ** 2
    return row, col, math.sqrt(total / weights.sum())


@compiled
def _fix_a_point(lines: StructuredArray) -> bool:
    """Return whether the lines that count are not near-parallel, however unlike their weights."""
    count, a, b, d = 0, 0.0, 0.0, 0.0  # of the normal matrix
    for line in lines:
        if line.length > 0.0:
            d_row, d_col = line.direction
            a += d_col * d_col
            b -= d_col * d_row
            d += d_row * d_row
            count += 1
    smaller_eigenvalue: float = (a + d) / 2 - math.hypot((a - d) / 2, b)
    return count >= 2 and smaller_eigenvalue >= PARALLEL * count


@compiled
def _distance(line: Record, candidate: FloatArray, row: float, col: float) -> float:
    """Return the signed distance from a line of a place so many rows and columns from the candidate."""
    d_row, d_col = line.direction
    distance: float = (candidate[0] - line.point[0] + row) * d_col - (candidate[1] - line.point[1] + col) * d_row
    return distance


@compiled
def _along(line: Record, candidate: FloatArray, row: float, col: float) -> float:
    """Return how far along a line, from its point, such a place lies."""
    d_row, d_col = line.direction
    along: float = (candidate[0] - line.point[0] + row) * d_row + (candidate[1] - line.point[1] + col) * d_col
    return along


@compiled
def _solve(
    lines: StructuredArray,
    weights: FloatArray,
    candidate: FloatArray,
    prior: tuple[float, float, float, float, float],
) -> tuple[float, float]:
    """Return rows and columns from the candidate to the point of least squared distances."""
    a, b, d, u, v = prior
    for i in range(lines.size):
        d_row, d_col = lines[i].direction
        off = _distance(lines[i], candidate, 0.0, 0.0)
        a += weights[i] * d_col * d_col
        b -= weights[i] * d_col * d_row
        d += weights[i] * d_row * d_row
        u -= weights[i] * d_col * off
        v += weights[i] * d_row * off
    determinant = a * d - b * b
    return (d * u - b * v) / determinant, (a * v - b * u) / determinant


@compiled
def _within(row: float, col: float, limit: float) -> tuple[float, float]:
    length = math.hypot(row, col)
    share = limit / length if length > limit else 1.0
    return row * share, col * share


@compiled
def _prior(lines: StructuredArray, weight: float) -> tuple[float, float, float, float, float]:
    """Return the normal equations of the candidate: the weights of its row, row with column, and column; no shift.

    The surfaces of roads at an angle t part at 1 / sin(t / 2) half widths, where their centerline branches. So along
    the line that halves an acute angle the candidate lies off by more than at a right one, and its standard deviation
    grows by the square of that; across it the candidate is known as well as any.
    """
    cosine = -1.0  # of the smallest angle, but for roads side by side
    row, col = 0.0, 0.0
    for i in range(lines.size):
        for j in range(i):
            if lines[i].length > 0.0 and lines[j].length > 0.0:
                (d_row, d_col), (o_row, o_col) = lines[i].direction, lines[j].direction
                alike = d_row * o_row + d_col * o_col
                if cosine < alike < SIDE_BY_SIDE_COS:
                    cosine = alike
                    row, col = d_row + o_row, d_col + o_col
    half = 0.5 * math.acos(min(cosine, 1.0))
    spread = max(1.0, math.sin(math.pi / 4) / max(math.sin(half), ACUTE_SIN))
    lost = weight * (1.0 - spread**-4) / max(row * row + col * col, 1e-9)
    return weight - lost * row * row, -lost * row * col, weight - lost * col * col, 0.0, 0.0


@compiled
def _with_fork(
    prior: tuple[float, float, float, float, float], direction: FloatArray, row: float, col: float, weight: float
) -> tuple[float, float, float, float, float]:
    """Add to normal equations how far along its stem a fork lies."""
    a, b, d, u, v = prior
    along = weight * (row * direction[0] + col * direction[1])
    a += weight * direction[0] * direction[0]
    b += weight * direction[0] * direction[1]
    d += weight * direction[1] * direction[1]
    return a, b, d, u + along * direction[0], v + along * direction[1]
