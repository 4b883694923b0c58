"""The straight lines that stand for branches, and how much each counts.

The paper lays a line through the start of a branch and its mean. But a centerline does not run straight into an
intersection: it is bent as far as the surfaces of its roads overlap, it leans where the road ends or leaves the window,
and roads bend further out. So the preset `default` fits a line to the part of a branch that can be trusted:

1. Pixels near a dead end of the branch or near the border of the image are left out (`trim_m`).
2. The line begins where the surface of the road parts from those of the other branches (`_parting`).
3. It takes in more of the branch, ring by ring, as long as the branch is straight (`straight_m`, `fit_length_m`).
4. It weighs the inverse of its variance at the candidate: a short or crooked branch, or one that can be trusted only
   far away, tells less about where the roads meet (`_weigh`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from interloc.arrays import BoolArray, FloatArray, Int32Array, Record, StructuredArray
from interloc.config import BranchConfig
from interloc.detection.centerline import Centerline
from interloc.kernels import compiled

RING_PX = 4.0  # a line grows by this much at a time
GRID_PX = 0.4  # scatter that the grid gives to the centerline of an ideal road
PIXEL_PX = 0.1  # how well the line of an ideal road is known


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
    """

    points: FloatArray
    directions: FloatArray
    weights: FloatArray


def through_start_and_mean(pieces: StructuredArray) -> Lines:
    """Lay a line through the start and the mean of each piece (paper, eq. 9); all count alike."""
    return Lines(pieces["start"], _unit(pieces["mean"] - pieces["start"]), np.ones(len(pieces)))


def least_squares(
    centerline: Centerline,
    traced: Int32Array,
    pieces: StructuredArray,
    candidate: FloatArray,
    width: float,
    inner: float,
    resolution_m: float,
    config: BranchConfig,
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
    """
    limits_m = config.fit_length_m, config.fit_least_m, config.full_fit_m, config.straight_m, config.trim_m
    limits = np.array((width, inner, *(limit_m / resolution_m for limit_m in limits_m)), LIMITS)
    lines = fit_lines(
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
    return Lines(lines["point"], directions, np.where(has_line, lines["weight"] / resolution_m**2, 0.0))


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
    ]
)
"""What `fit_lines` returns for each piece; pixels."""

_MOMENTS = np.dtype([(name, np.float64) for name in ("n", "r", "c", "rr", "rc", "cc")])
"""Sums over pixels: their number, rows, columns, and the products of these."""


# Named tuples would stand in the files of compiled code by the name of their class, which may change; these do not.
_LIMITS = ("width", "inner", "length", "shortest", "full", "straight", "trim")
LIMITS = np.dtype([(name, np.float64) for name in _LIMITS])
"""Road width and inner radius at the candidate, and the settings of the fit from `BranchConfig`; pixels."""


@compiled
def fit_lines(
    rows: Int32Array,
    cols: Int32Array,
    border_distance: Int32Array,
    is_tip: BoolArray,
    traced: Int32Array,
    pieces: StructuredArray,
    candidate: FloatArray,
    limits: Record,
) -> StructuredArray:
    """Fit and weigh a line for each piece; (P,) LINE. For the arrays see `Centerline` and `trace_branches`."""
    lines = np.zeros(pieces.size, LINE)
    n_rings = max(1, int(limits.length / RING_PX))
    for i in range(pieces.size):
        rings = _moments_by_ring(
            rows, cols, border_distance, is_tip, traced[pieces[i].begin : pieces[i].end], candidate, n_rings, limits
        )
        begin = int(max(_parting(pieces, i, candidate, limits.width) - limits.inner, 0.0) / RING_PX)
        _fit_straight_part(lines[i], rings, min(begin, n_rings - 1), candidate, limits)
    _weigh(lines, limits.full)
    return lines


@compiled
def _moments_by_ring(
    rows: Int32Array,
    cols: Int32Array,
    border_distance: Int32Array,
    is_tip: BoolArray,
    piece: Int32Array,
    candidate: FloatArray,
    n_rings: int,
    limits: Record,
) -> StructuredArray:
    """Sum up the trustworthy pixels of a piece in rings around the inner circle, from it outwards."""
    rings = np.zeros(n_rings, _MOMENTS)
    tips = piece[is_tip[piece]]
    for p in piece:
        dr, dc = rows[p] - candidate[0], cols[p] - candidate[1]
        ring = int((np.sqrt(dr * dr + dc * dc) - limits.inner) / RING_PX)
        usable = ring < n_rings and border_distance[p] >= limits.trim
        for t in tips:
            tr, tc = rows[p] - rows[t], cols[p] - cols[t]
            if tr * tr + tc * tc < limits.trim * limits.trim:
                usable = False
        if usable:
            sums = rings[ring]
            sums.n += 1.0
            sums.r += dr
            sums.c += dc
            sums.rr += dr * dr
            sums.rc += dr * dc
            sums.cc += dc * dc
    return rings


@compiled
def _parting(pieces: StructuredArray, which: int, candidate: FloatArray, width: float) -> float:
    """Return how far from the candidate the surface of a branch parts from that of its nearest neighbour, pixels.

    Two roads of width w at an angle t part at (w / 2) / sin(t / 2); the centerline is bent until there.
    """
    least = np.pi
    r, c = pieces[which].mean[0] - candidate[0], pieces[which].mean[1] - candidate[1]
    for i in range(pieces.size):
        if i != which:
            ri, ci = pieces[i].mean[0] - candidate[0], pieces[i].mean[1] - candidate[1]
            least = min(least, abs(np.arctan2(r * ci - c * ri, r * ri + c * ci)))
    distance: float = 0.5 * width / max(np.sin(0.5 * least), 0.25)
    return distance


@compiled
def _fit_straight_part(line: Record, rings: StructuredArray, begin: int, candidate: FloatArray, limits: Record) -> None:
    """Fit a line by total least squares to the rings from ``begin`` on, as far as the branch is straight."""
    first = -1
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
        length = (i + 1 - first) * RING_PX
        if rms > limits.straight and length > limits.shortest:
            break
        if d_row * ur + d_col * uc < 0.0:
            d_row, d_col = -d_row, -d_col
        line.point[0], line.point[1] = candidate[0] + ur, candidate[1] + uc
        line.direction[0], line.direction[1] = d_row, d_col
        line.start, line.length, line.rms = limits.inner + first * RING_PX, length, rms


@compiled
def _weigh(lines: StructuredArray, full: float) -> None:
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
            variance = 0.5 * (scatter * scatter + common / total) + PIXEL_PX * PIXEL_PX
            # A line that is prolonged back to the candidate is known there the worse the farther off it was fitted.
            far = (line.start + 0.5 * line.length) / line.length
            variance *= 1.0 + 12.0 * far * far
            line.weight = min(line.length, full) / full / variance
