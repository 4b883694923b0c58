"""What speaks for a place once the track is bent onto its roads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import wrap_angle
from interloc.localization.refine import Chain, Fit
from interloc.localization.roads import RoadMap

_LANE_SIGMA_M = 1.5
_AT_NODE_M = 4.0
_NEAR_NODE_M = 10.0
_PASSED_M = 15.0
_SAME_PASSAGE = 6  # poses
_SAME_BRANCH_RAD = np.radians(30.0)
_INTERSECTIONS_SHARE, _STRAIN_SHARE = 0.5, 0.05


@dataclass(frozen=True)
class Evidence:
    """How well a place explains a drive.

    Attributes
    ----------
    road : float
        Share of the track that runs within its lane, 0..1, softly: exp(-d^2 / 2 sigma^2) of each pose.
    seen, at_nodes : int
        Passages of intersections that the drive saw, and those of them at a node of the map.
    passed, missed : int
        Nodes of the map along the track, and those of them at which the drive saw none.
    branches : float
        Share of the branches of those at nodes that agree with roads of the node, 0..1.
    strain : float
        How far the odometry had to be bent; see `Fit`.
    """

    road: float
    seen: int
    at_nodes: int
    passed: int
    missed: int
    branches: float
    strain: float

    @property
    def intersections(self) -> float:
        """Agreement of the intersections seen with the nodes, 0..1.

        The harmonic mean of how many each side has of the other; half of what a hit counts are its branches.
        """
        hits = self.at_nodes * (0.5 + 0.5 * self.branches)
        wrong = (self.seen - self.at_nodes) + self.missed
        return 0.0 if hits <= 0.0 else 2.0 * hits / (2.0 * self.at_nodes + wrong)

    @property
    def score(self) -> float:
        """All of it in one figure: 1 is a perfect track, 1.5 one with all intersections in place."""
        return self.road + _INTERSECTIONS_SHARE * self.intersections - _STRAIN_SHARE * self.strain


def evidence_of(chain: Chain, fitted: Fit, roads: RoadMap) -> Evidence:
    """Compare a bent chain with the map."""
    lateral = np.where(np.isnan(fitted.lateral_m), 1e3, fitted.lateral_m)
    road = float(np.exp(-0.5 * (lateral / _LANE_SIGMA_M) ** 2).mean())
    if not len(chain.seen_from) or not len(roads.node_xy):
        return Evidence(road, len(chain.seen_from), 0, 0, 0, 0.0, fitted.strain)
    seen_at = chain.seen_at(fitted.pose)
    places = np.concatenate([fitted.pose[:, :2], seen_at])
    low, high = places.min(axis=0) - _PASSED_M, places.max(axis=0) + _PASSED_M
    near = np.flatnonzero(((roads.node_xy >= low) & (roads.node_xy <= high)).all(axis=1))  # few of a large map
    if not len(near):
        return Evidence(road, len(seen_at), 0, 0, 0, 0.0, fitted.strain)
    apart = np.hypot(*np.moveaxis(seen_at[:, None] - roads.node_xy[None, near], -1, 0))
    nearest = apart.argmin(axis=1)
    hit = apart[np.arange(len(seen_at)), nearest] < _AT_NODE_M
    turned = chain.seen_angles_rad[hit] + fitted.pose[chain.seen_from[hit], 2][:, None]
    branches = _agreement(turned, roads.node_angles_rad[near[nearest[hit]]])
    passed, missed = _passed(chain, fitted, roads.node_xy[near], apart)
    return Evidence(road, len(seen_at), int(hit.sum()), passed, missed, branches, fitted.strain)


def _agreement(seen: FloatArray, mapped: FloatArray) -> float:
    """Return the share of branches that have a partner, of both sides of (H, B) directions."""
    if not len(seen):
        return 0.0
    difference = np.abs(wrap_angle(seen[:, :, None] - mapped[:, None, :]))
    close = np.nan_to_num(difference, nan=9.0) < _SAME_BRANCH_RAD
    partners = close.any(axis=2).sum() + close.any(axis=1).sum()
    return float(partners / (np.isfinite(seen).sum() + np.isfinite(mapped).sum()))


def _passed(chain: Chain, fitted: Fit, node_xy: FloatArray, apart: FloatArray) -> tuple[int, int]:
    """Return how many of (K, 2) nodes the track passes, passage by passage, and at how many nothing was seen.

    ``apart`` are the distances of what was seen from each node, (J, K).
    """
    from_track = np.hypot(*np.moveaxis(fitted.pose[:, None, :2] - node_xy[None], -1, 0))
    passed = missed = 0
    for node in range(len(node_xy)):
        poses = np.flatnonzero(from_track[:, node] < _PASSED_M)
        if not len(poses):
            continue
        for passage in np.split(poses, np.flatnonzero(np.diff(poses) > _SAME_PASSAGE) + 1):
            passed += 1
            then = (chain.seen_from >= passage[0] - _SAME_PASSAGE) & (chain.seen_from <= passage[-1] + _SAME_PASSAGE)
            missed += not (apart[then, node] < _NEAR_NODE_M).any()
    return passed, missed
