"""What became of each candidate, and why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import BranchConfig
from interloc.detection.branches import Branches, Piece
from interloc.detection.detector import Steps
from interloc.detection.image import Roi


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
        Why it is no intersection.
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


def judge(steps: Steps, vehicle: FloatArray, config: BranchConfig) -> list[Verdict]:
    """Explain all candidates of a keyframe, the nearest to the vehicle (x, y in W, metres) first."""
    candidates, segmentation = steps.candidates, steps.segmentation
    order = np.argsort(np.hypot(*(candidates.positions - steps.roi.image(vehicle)).T), kind="stable")
    verdicts = []
    for number, index in enumerate(order.tolist(), start=1):
        branches, pieces = segmentation.branches[index], list(segmentation.pieces[index])
        detections = [i for i, junction in enumerate(steps.junctions) if junction.branches.index == index]
        verdicts.append(
            Verdict(
                number=number,
                position=candidates.positions[index],
                width=float(candidates.widths[index]),
                merged=candidates.merged[index],
                branches=branches,
                pieces=pieces,
                detections=detections,
                why_not=None if detections else _why_not(branches, pieces, steps.roi, config),
            )
        )
    return verdicts


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
