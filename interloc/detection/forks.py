"""Forks: where one road parts into others that lead on (beyond the paper).

At a fork, or where a side road joins at an acute angle, the centerline branches far from where the axes meet, and the
arms are often bent in between, so that their lines meet somewhere else. The surface tells the place: up to it the road
has parallel sides, and beyond it the outer edges are those of the arms. So each place on the axis of the stem is tried:
with arms that lead straight on from it to where their own axes are known, the edges must be where they are seen.

Places and directions are rows and columns, lengths pixels.
"""

import math

import numpy as np

from interloc.arrays import FloatArray, Record, StructuredArray, UInt64Array
from interloc.detection.edges import edges_across
from interloc.detection.lines import LEADS_ON_COS
from interloc.kernels import compiled

ARM_BEGIN = 0.5  # radii of the inner circle from the candidate outwards: from there on the line of an arm is its axis
BEHIND = 2.0  # half widths by which the stem is looked at beyond the inner circle
REACH = 4.0  # half widths within which an edge is looked for


@compiled
def find_fork(
    lines: StructuredArray, candidate: FloatArray, inner: float, words: UInt64Array
) -> tuple[int, float, float]:
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
        The branch that parts, -1 for none: two others or more, all of them, must lead on within 45 degrees of straight,
        and its width must be known. Of branches without lines it is enough where they lead: straight from the candidate
        through their means.
    row, col : float
        From the candidate to the place, pixels.
    """
    stem = _stem(lines)
    if stem < 0 or lines[stem].half_width == 0.0:
        return -1, 0.0, 0.0
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
    at, least = 0, np.inf
    for place in range(size):
        misfit = _misfit(edges, place, half, arms)
        if misfit < least:
            at, least = place, misfit
    return stem, r - at * d_row - candidate[0], c - at * d_col - candidate[1]


@compiled
def _stem(lines: StructuredArray) -> int:
    """Return the branch that all others lead on from, of which there is one at most; -1 for none."""
    if lines.size < 3:
        return -1
    for i in range(lines.size):
        leads_on = True
        for j in range(lines.size):
            alike = lines[i].direction[0] * lines[j].direction[0] + lines[i].direction[1] * lines[j].direction[1]
            leads_on &= j == i or alike < LEADS_ON_COS
        if leads_on:
            return i
    return -1


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
