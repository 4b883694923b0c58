"""What became of each candidate, and why: recomputed from the steps with the pixels that they do not keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import BoolArray, FloatArray, Int32Array, IntArray
from interloc.config import BranchConfig, DetectorConfig, HarrisCandidates
from interloc.detection.branches import Branches, inner_radius, segment_branches
from interloc.detection.candidates import Candidates, harris_corners, merge_until_stable
from interloc.detection.centerline import Centerline
from interloc.detection.detector import Steps
from interloc.detection.image import Roi
from interloc.kernels import skeleton as sk


@dataclass(frozen=True)
class Piece:
    """A connected piece of centerline that leaves the inner circle of a candidate.

    Attributes
    ----------
    pixels : (P,) int64
        Positions among the pixels of the centerline.
    reach : float
        Greatest distance from the candidate, pixels.
    at_candidate : bool
        It ends before another candidate.
    is_branch : bool
        It counts; otherwise it is too short.
    """

    pixels: IntArray
    reach: float
    at_candidate: bool
    is_branch: bool


@dataclass(frozen=True)
class Verdict:
    """One candidate and what became of it.

    Attributes
    ----------
    number : int
        Its name in the pictures, from 1 on.
    position : (2,) float64
        Row and column, pixels.
    width : float
        Road width there, pixels.
    merged : (M, 2) float64
        The corners or junctions of the centerline that it stands for, row and column.
    branches
    pieces
        Those that are branches are in the order of ``branches``.
    detections : list of int
        Positions among ``Steps.junctions``: none, one, or several where it was split.
    why_not : str or None
        Why it is none.
    """

    number: int
    position: FloatArray
    width: float
    merged: FloatArray
    branches: Branches
    pieces: list[Piece]
    detections: list[int]
    why_not: str | None

    @property
    def is_kept(self) -> bool:
        """Whether it became an intersection."""
        return bool(self.detections)


def judge(steps: Steps, vehicle: FloatArray, config: DetectorConfig) -> list[Verdict]:
    """Explain all candidates of a keyframe, the nearest to the vehicle (x, y in W, metres) first."""
    candidates, centerline, resolution_m = steps.candidates, steps.centerline, steps.roi.resolution_m
    merged = merged_points(centerline, candidates, resolution_m, config)
    branches = [
        segment_branches(candidates, which, steps.enders, centerline, resolution_m, config.branches)
        for which in range(len(candidates.positions))
    ]
    detections = [[i for i, j in enumerate(steps.junctions) if j.branches.which == w] for w in range(len(branches))]
    order = np.argsort(np.hypot(*(candidates.positions - steps.roi.image(vehicle)).T), kind="stable")
    verdicts = []
    for number, which in enumerate(order.tolist(), start=1):
        pieces = pieces_around(candidates, which, steps.enders, centerline, resolution_m, config.branches)
        verdicts.append(
            Verdict(
                number=number,
                position=candidates.positions[which],
                width=float(candidates.widths[which]),
                merged=merged[which],
                branches=branches[which],
                pieces=pieces,
                detections=detections[which],
                why_not=None if detections[which] else _why_not(branches[which], pieces, steps.roi, config.branches),
            )
        )
    return verdicts


def merged_points(
    centerline: Centerline, candidates: Candidates, resolution_m: float, config: DetectorConfig
) -> list[FloatArray]:
    """Return the points, (M, 2) row and column, that each candidate stands for."""
    if not isinstance(config.candidates, HarrisCandidates):
        return candidates.cores
    corners, _ = harris_corners(centerline, config.candidates)
    points = _points(centerline, corners)
    _, groups = merge_until_stable(points, config.candidates.merge_m / resolution_m)
    return [points[group] for group in groups]


def pieces_around(
    candidates: Candidates,
    which: int,
    enders: IntArray,
    centerline: Centerline,
    resolution_m: float,
    config: BranchConfig,
) -> list[Piece]:
    """Find the pieces of centerline around a candidate pixel by pixel (paper, section III-C.1).

    The numbers of these pieces are those of `interloc.kernels.skeleton.follow_branches`.
    """
    neighbours, here = centerline.neighbours, candidates.positions[which]
    pixels = _points(centerline, np.arange(len(centerline.rows)))
    distance = np.hypot(*(pixels - here).T)
    inner = inner_radius(candidates, which, enders, resolution_m, config)
    annulus = (distance > inner) & (distance < config.outer_radius_m / resolution_m)
    starts = np.flatnonzero(annulus & _beside(distance <= inner, neighbours)).astype(np.int32)
    foreign = np.zeros(len(pixels), np.bool_)  # too near to another candidate
    for other in candidates.positions[enders[enders != which]]:
        foreign |= np.hypot(*(pixels - other).T) < config.stop_m / resolution_m
    allowed = annulus & ~foreign
    allowed[starts] = True
    labels, count = sk.label_pieces(neighbours, allowed, starts)
    at_candidate = _beside(annulus & foreign & (labels < 0), neighbours)
    pieces = []
    for label in range(count):
        members = np.flatnonzero(labels == label)
        reach, cut = float(distance[members].max()), bool(at_candidate[members].any())
        pieces.append(Piece(members, reach, cut, cut or reach * resolution_m >= config.min_reach_m))
    return pieces


def _why_not(branches: Branches, pieces: list[Piece], roi: Roi, config: BranchConfig) -> str:
    if branches.count >= config.min_branches:
        position = branches.candidate
        gap_m = float(min(position.min(), roi.size - 1 - position.max())) * roi.resolution_m
        return f"{gap_m:.1f} m from the border, {config.margin_m:g} m needed"
    why = f"{branches.count} {'branch' if branches.count == 1 else 'branches'}, {config.min_branches} needed"
    short = [f"{piece.reach * roi.resolution_m:.1f}" for piece in pieces if not piece.is_branch]
    if short:
        why += f"; {len(short)} too short ({', '.join(short)} of {config.min_reach_m:g} m)"
    return why


def _points(centerline: Centerline, pixels: NDArray[np.integer]) -> FloatArray:
    return np.column_stack([centerline.rows[pixels], centerline.cols[pixels]]).astype(np.float64)


def _beside(mask: BoolArray, neighbours: Int32Array) -> BoolArray:
    """Return the pixels that are joined to one of a mask, (P,) bool."""
    known: BoolArray = np.append(mask, False)[neighbours]  # -1, no neighbour, takes what is appended
    beside: BoolArray = np.logical_or.reduce(known, axis=1)
    return beside
