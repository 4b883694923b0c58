"""Segmentation of the road branches around a candidate (paper, section III-C.1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.config import BranchConfig
from interloc.detection.candidates import Candidates
from interloc.detection.centerline import BORDER_PX, Centerline
from interloc.kernels import skeleton as sk


@dataclass(frozen=True)
class Branches:
    """The branches of one candidate and the straight lines that stand for them.

    Attributes
    ----------
    which : int
        Number of the candidate.
    candidate : (2,) float64
        Row and column, pixels.
    inner : float
        Radius of the inner circle, pixels.
    directions : (B, 2) float64
        Unit direction (row, column) of each branch, away from the candidate.
    points : (B, 2) float64
        A point on the line of each branch.
    weights : (B,) float64
        How much each line counts: 1 in the paper, else the inverse of its variance at the candidate, 1 / m^2; 0 for a
        branch that is too short to tell its direction.
    lengths : (B,) float64
        Pixels of centerline in each branch.
    core : (C, 2) float64
        Junction pixels of the centerline that the candidate stands for; empty for Harris corners.
    """

    which: int
    candidate: FloatArray
    inner: float
    directions: FloatArray
    points: FloatArray
    weights: FloatArray
    lengths: FloatArray
    core: FloatArray

    @property
    def count(self) -> int:
        """Number of branches."""
        return len(self.directions)

    @property
    def normals(self) -> FloatArray:
        """(B, 2) float64 unit normals of the lines."""
        return np.column_stack([self.directions[:, 1], -self.directions[:, 0]])

    def only(self, which: list[int], candidate: FloatArray) -> Branches:
        """Return some of the branches, around another point."""
        return replace(
            self,
            candidate=candidate,
            directions=self.directions[which],
            points=self.points[which],
            weights=self.weights[which],
            lengths=self.lengths[which],
        )


def inner_radius(
    candidates: Candidates, which: int, others: IntArray, resolution_m: float, config: BranchConfig
) -> float:
    """Return the radius in pixels within which the centerline is bent by the junction itself."""
    radius = config.inner_radius_m / resolution_m
    if config.inner_widths is None:
        return radius
    radius = min(radius, config.inner_widths * float(candidates.widths[which]))
    others = others[others != which]
    if len(others):
        gaps = candidates.positions[others] - candidates.positions[which]
        radius = min(radius, 0.6 * float(np.hypot(gaps[:, 0], gaps[:, 1]).min()))
    return radius


def segment_all(
    candidates: Candidates, centerline: Centerline, resolution_m: float, config: BranchConfig
) -> tuple[list[Branches], IntArray]:
    """Segment the branches of all candidates and keep the intersections among them (paper, section III-C).

    Returns
    -------
    list of Branches
        Of the candidates with enough branches.
    (E,) int64
        The candidates at which branches end: all, as in the paper, or only those that have enough branches themselves.
    """
    enders = np.arange(len(candidates.positions))
    kept = _enough(candidates, enders, centerline, resolution_m, config)
    if not config.end_at_rejected and len(kept) < len(enders):
        enders = np.array([branches.which for branches in kept], np.int64)
        kept = _enough(candidates, enders, centerline, resolution_m, config)
    size = centerline.image.height
    inside = candidates.inside(size, config.margin_m / resolution_m)
    return [branches for branches in kept if branches.which in inside], enders


def _enough(
    candidates: Candidates,
    enders: IntArray,
    centerline: Centerline,
    resolution_m: float,
    config: BranchConfig,
) -> list[Branches]:
    branches = [segment_branches(candidates, int(i), enders, centerline, resolution_m, config) for i in enders]
    return [b for b in branches if b.count >= config.min_branches]


def segment_branches(
    candidates: Candidates,
    which: int,
    enders: IntArray,
    centerline: Centerline,
    resolution_m: float,
    config: BranchConfig,
) -> Branches:
    """Follow the centerline from the inner circle outwards and lay a line through each branch.

    Parameters
    ----------
    candidates
        All of the image.
    which
        The one looked at.
    enders : (E,) int64
        The ones before which a branch ends.
    centerline
    resolution_m
        Side of a pixel.
    config
        Radii and the kind of line.

    Notes
    -----
    Paper, eq. 7 to 9.
    """
    inner = inner_radius(candidates, which, enders, resolution_m, config)
    table = sk.follow_branches(
        centerline.rows,
        centerline.cols,
        centerline.neighbours,
        candidates.positions[which],
        candidates.positions[enders[enders != which]],
        float(candidates.widths[which]),
        inner,
        config.outer_radius_m / resolution_m,
        config.stop_m / resolution_m,
        config.fit_length_m / resolution_m,
        config.fit_least_m / resolution_m,
        config.full_fit_m / resolution_m,
        config.straight_m / resolution_m,
        config.trim_m / resolution_m,
        centerline.image.height,
        BORDER_PX,
    )
    # A piece that another candidate cuts short is a road between two intersections.
    table = table[(table[:, sk.REACH] * resolution_m >= config.min_reach_m) | (table[:, sk.AT_CANDIDATE] > 0)]
    means = table[:, [sk.MEAN_ROW, sk.MEAN_COL]]
    if config.line == "start_and_mean":
        points = table[:, [sk.START_ROW, sk.START_COL]]
        directions = _unit(means - points)
        has_line = np.ones(len(table), np.bool_)
        weights = np.ones(len(table))
    else:
        points = table[:, [sk.FIT_ROW, sk.FIT_COL]]
        has_line = table[:, sk.FIT_LENGTH] * resolution_m >= config.min_fit_m
        fitted = table[:, [sk.FIT_D_ROW, sk.FIT_D_COL]]
        directions = np.where(has_line[:, None], fitted, _unit(means - candidates.positions[which]))
        weights = np.where(has_line, table[:, sk.WEIGHT] / resolution_m**2, 0.0)
    return Branches(
        which,
        candidates.positions[which],
        inner,
        directions,
        points,
        weights,
        table[:, sk.LENGTH],
        candidates.cores[which],
    )


def _unit(vectors: FloatArray) -> FloatArray:
    return vectors / np.maximum(np.hypot(vectors[:, 0], vectors[:, 1]), 1e-9)[:, None]
