"""What speaks for a place once the track is bent onto its roads, and whether that is enough."""

from dataclasses import dataclass
from typing import Literal

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

MIN_LENGTH_M = 100.0
"""A shorter drive fits nearly everywhere."""

MIN_ROAD = 0.70
"""Share of the track that must run along roads: wrong places with curves reach 0.72, right ones 0.73 to 0.96."""

MIN_SCORE = 1.15
"""Score of track and intersections together, where intersections were seen: a wrong place that led had 1.09."""

MARGIN = 0.10
"""How much better than the next place, and than chance, the best must be."""

ALONE, ALONE_SCORE = 3.0, 1.3
"""A place that leads the next one by so many margins, with such a score, needs half a margin over chance: what fits in
a mirror nearly as well is then the place itself, seen in a mirror. On a mirrored map the mirror leads. One that leads
chance by as much, too, and has a third of the intersections in place, needs no `MIN_SCORE`: on maps without the drive,
and on mirrored ones, none of some 300 leads over both was above 1.3 margins."""

FULL_LENGTH_M = 700.0
"""A shorter drive needs a larger lead, twice the margin at half this length: one of 500 m led by 0.10 in a mirror."""

FULL_LENGTH_ALONE_M = 1000.0
"""The same where the trajectory is all there is: one of 500 m led by 0.19 on a map that does not hold it."""

MIN_SEEN = 2
"""Intersections seen, from which on they count in the decision."""


@dataclass(frozen=True)
class Evidence:
    """How well a place explains a drive.

    `road` is the share of the track within its lane, 0..1, softly: exp(-d^2 / 2 sigma^2) of each pose. The drive saw
    `seen` passages of intersections, `at_nodes` of them at a node of the map, and `branches` is the share of their
    branches that agree with its roads; of `passed` nodes along the track it `missed` some. `strain`: see `Fit`.
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
    seen_at = chain.seen_at(fitted.pose)
    near = np.zeros(0, dtype=np.int64)
    if len(seen_at) and len(roads.node_xy):
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
        for passage in np.split(poses, np.flatnonzero(np.diff(poses) > _SAME_PASSAGE) + 1) if len(poses) else ():
            passed += 1
            then = (chain.seen_from >= passage[0] - _SAME_PASSAGE) & (chain.seen_from <= passage[-1] + _SAME_PASSAGE)
            missed += not (apart[then, node] < _NEAR_NODE_M).any()
    return passed, missed


@dataclass(frozen=True)
class Decision:
    """What came out of a search, and why: `reason` stands after "the drive was not placed: " or "found: ".

    `advice` says in a sentence what would help; "" where it was found.
    """

    outcome: Literal["found", "ambiguous", "not_found"]
    reason: str
    advice: str = ""


def too_short(length_m: float) -> Decision:
    """Refuse a drive that is too short to be looked for."""
    return Decision(
        "not_found",
        f"the drive is {length_m:.0f} m long, and under {MIN_LENGTH_M:.0f} m nearly every road fits it.",
        "Give a longer drive, or the track of a phone that was along (interloc locate --gpx).",
    )


def decide(best: Evidence | None, runner_up: float, chance: float, length_m: float) -> Decision:
    """Decide by the figures of the best place (None where nothing fitted at all).

    The score of the best place alone proves nothing: a curve less, and a wrong place does as well. What counts is its
    lead over the best wrong ones: over the next best place elsewhere, and over `chance`, the best place for the same
    drive seen in a mirror. That one was never driven (unless the drive is straight), has as many curves and
    intersections, and shows how well this map explains such a drive by chance.
    """
    longer = "A longer drive, labels (for the intersections along it) or roughly where it was (near) would help."
    if best is None or best.road < MIN_ROAD:
        share = 0.0 if best is None else best.road
        return Decision(
            "not_found",
            f"at the best place only {100 * share:.0f} % of the track run along roads of the map "
            f"(expected {100 * MIN_ROAD:.0f} % or more).",
            "Give a map that holds the roads driven; if it does, the poses may drift too much.",
        )
    full_length_m = FULL_LENGTH_M if best.seen >= MIN_SEEN else FULL_LENGTH_ALONE_M
    margin = MARGIN * max(1.0, full_length_m / max(length_m, 1.0))
    if best.score - runner_up < margin:
        return Decision(
            "ambiguous",
            f"the best place scores {best.score:.2f}, the next one {runner_up:.2f}: not {margin:.2f} apart.",
            longer,
        )
    is_alone = best.seen >= MIN_SEEN and best.score - runner_up >= ALONE * margin
    if best.score - chance < margin * (0.5 if is_alone and best.score >= ALONE_SCORE else 1.0):
        return Decision(
            "not_found",
            f"the best place scores {best.score:.2f}, which is not {margin:.2f} better than chance: the same drive "
            f"seen in a mirror, which nobody drove, reaches {chance:.2f}.",
            longer,
        )
    is_far_ahead = is_alone and best.score - chance >= ALONE * margin and 3 * best.at_nodes >= best.seen
    if best.seen >= MIN_SEEN and best.score < MIN_SCORE and not is_far_ahead:
        return Decision(
            "not_found",
            f"at the best place {best.at_nodes} of the {best.seen} intersections seen are at intersections of the map, "
            f"and {best.missed} of the {best.passed} passed were not seen.",
            "Give a map that holds the roads driven, better labels, or a longer drive.",
        )
    return Decision(
        "found", f"the best place scores {best.score:.2f}, the next one {runner_up:.2f}, chance {chance:.2f}."
    )
