"""Why a detection or an intersection is wrong, and why a node was missed: what the map and the result say about it.

Each rule asks for evidence at the place and gives a short sentence; the first rule that finds some decides. `KINDS` is
the closed list of the answers. A reason says what lies there, not that it is the cause: a junction with a service road
0.8 m from a wrong intersection explains it, whether or not the service road is what the LiDAR saw.

Of something wrong, in this order (the thresholds are the constants below and in `evidence`):

1. `not_joined`, `no_node`: nodes at one place that are not joined, and roads that cross on one level without a node:
   slips of OpenStreetMap that hide a junction, where no counted node is nearer.
2. `left_out`: a junction that only exists with ways that the policy leaves out, and no counted node is nearer.
3. `slip_road`: on a slip road near its mouth. Its lanes join far from where the map puts the node.
4. `fork`: between two roads that leave a node at an acute angle. Their surfaces part further on than their lines.
5. `second`: near a node that another detection (of this keyframe) or another intersection stands for already.
6. `off`: near a node, but not near enough; or near a node of a merged place whose middle is not near enough.
7. `bend`: a road that turns here, without a junction.
8. `road_end`: the end of a road.
9. `path`: a path for walkers or cyclists meets a road.
10. `nothing`: none of these. What the map may lack.

Of a node that was missed:

1. `merged`: the intersection of a neighbouring node lies near this one too, or holds detections that do.
2. `misplaced`: an intersection that is assigned to no node lies near it.
3. `too_few`: detections lie at the node, but the fusion made no intersection of them: too few, or of low confidence.
4. `levels`: its roads lie on different levels (`layer`, `bridge`, `tunnel`), or all on another than the road driven.
5. `twice`: two of its roads run on one line: a road drawn twice.
6. `not_driven`: the drive did not come near enough to look into its branches.
7. `short`: fewer than three of its branches are long enough.
8. `not_seen`: the drive passed it, and nothing was detected. `interloc explain` shows more.

Where it matters, the reason also says which of its branches were seen as road, by the mosaic of the road
(`road.tif`), and which as other ground: hidden, or labelled as something else.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.evaluation.evidence import BRANCH_M, LEVEL_M, MapEvidence
from interloc.mapping.mosaic import Mosaic
from interloc.osm.intersections import MIN_DEGREE

FalseKind = Literal[
    "not_joined", "no_node", "left_out", "slip_road", "fork", "second", "off", "bend", "road_end", "path", "nothing"
]
MissKind = Literal["merged", "misplaced", "too_few", "levels", "twice", "not_driven", "short", "not_seen"]

KINDS: dict[FalseKind | MissKind, str] = {
    "not_joined": "nodes at one place that OpenStreetMap does not join",
    "no_node": "roads that cross without a node in OpenStreetMap",
    "left_out": "junction with a way that the policy leaves out",
    "slip_road": "mouth of a slip road",
    "fork": "roads part at an acute angle",
    "second": "second one at a node that is found already",
    "off": "off a node",
    "bend": "bend of a road",
    "road_end": "end of a road",
    "path": "a path meets a road",
    "nothing": "nothing in OpenStreetMap near: worth a look",
    "merged": "merged with a neighbouring node",
    "misplaced": "found, but off",
    "too_few": "detected too rarely or too weakly",
    "levels": "roads on different levels",
    "twice": "a road drawn twice",
    "not_driven": "no keyframe near enough",
    "short": "branches too short",
    "not_seen": "passed, nothing detected",
}
"""Kind -> what it means, for the tables of a report."""

SAME_PLACE_M = 10.0
"""A junction so near is the same place: the gate of the map. An intersection there would be right if it counted."""

PATH_M = 5.0  # the same for paths: they are everywhere in a town, so only one very near explains anything
NEAR_M = 20.0  # a node so near is what was meant: half the side of the relevant zone, and the width of a large junction
COMPOUND_M = 25.0  # nodes so near each other may be one compound junction on the ground
ON_LINK_M = 8.0  # so near the line of a slip road lies on it: half its width and the width of the wedge beside it
MOUTH_M = 30.0  # length of a slip road, from its node, along which its lane is joined with the road beside it
BEND_DEG = 30.0
"""A turn by so much over twice `evidence.ARM_M` is a bend: its inner and outer edges part like those of a junction."""

FORK_DEG = 45.0
"""Two roads 7 m wide that leave a node at this angle share their surface for 9 m; for 14 m at 30 degrees."""

PASSED_M = 15.0  # a node further from all keyframes was not passed: beside the road driven, or at the next corner
_OF_BRANCHES = {"too_few", "not_driven", "short", "not_seen"}
"""Kinds of reasons that depend on what was seen of the branches."""

Claims = Iterable[tuple[int, int]]


class Reason(NamedTuple):
    """Why something is wrong or missed: kind of `KINDS`, and a sentence about this one."""

    kind: FalseKind | MissKind
    sentence: str


def count_kinds(reasons: Iterable[Reason | None], family: Any) -> dict[str, int]:  # noqa: ANN401 - a Literal
    """Return how many reasons there are of each kind of `FalseKind` or `MissKind`, those without any too."""
    counts = Counter(reason.kind for reason in reasons if reason is not None)
    return {kind: counts[kind] for kind in get_args(family)}


def explain_false(
    evidence: MapEvidence, xy: FloatArray, groups: Sequence[int], taken: Claims, limit_m: float
) -> list[Reason]:
    """Say of each wrong detection or intersection what the map holds at its place, (N, 2) of `MapEvidence.plane`.

    What is in one of the N groups shares a node only once: the keyframe of each detection; of intersections, the same
    number for all. `taken` are pairs (group, row of a node) of nodes that something right stands for. Nearer to a node
    than the limit it would have been right.
    """
    if len(xy) == 0:
        return []
    is_taken = set(taken)
    node_m, node = evidence.counted.nearest(xy)
    part_m, place = evidence.parts.nearest(xy)  # large places reach further than their middle
    node, node_m = np.where(part_m < node_m, place, node), np.minimum(node_m, part_m)
    hidden = _hidden(evidence, xy, node_m)
    mouth_m, link = evidence.mouths.nearest(xy)
    link_m, _ = evidence.links.nearest(xy)
    path_m, path = evidence.paths.nearest(xy)
    end_m, _ = evidence.road_ends.nearest(xy)
    reasons = []
    for row, group in enumerate(groups):
        if junction := hidden[row]:
            reason = junction
        elif link_m[row] <= ON_LINK_M and mouth_m[row] <= MOUTH_M:
            way = evidence.graph.ways.label(int(link[row]))
            reason = Reason("slip_road", f"mouth of a slip road ({way}), its node {mouth_m[row]:.1f} m away")
        elif node_m[row] <= NEAR_M:
            is_second = (group, int(node[row])) in is_taken
            reason = _near_node(evidence, int(node[row]), xy[row], limit_m, is_second=is_second)
            if odd := evidence.oddity(int(node[row])):
                reason = Reason(reason.kind, f"{reason.sentence}; of that node: {odd}")
        elif (turn := evidence.bend_deg(xy[row])) >= BEND_DEG:
            reason = Reason(
                "bend", f"bend of a road, which turns by {turn:.0f} degrees; no junction within {NEAR_M:g} m"
            )
        elif end_m[row] <= SAME_PLACE_M:
            reason = Reason("road_end", f"end of a road, {end_m[row]:.1f} m away")
        elif path_m[row] <= PATH_M:
            reason = Reason(
                "path", f"{evidence.graph.ways.label(int(path[row]))} meets a road, {path_m[row]:.1f} m away"
            )
        else:
            reason = Reason("nothing", f"nothing in OpenStreetMap within {NEAR_M:g} m explains it: worth a look")
        reasons.append(reason)
    return reasons


def _hidden(evidence: MapEvidence, xy: FloatArray, node_m: FloatArray) -> list[Reason | None]:
    """Say which junction is at (N, 2) places that does not count, where no node that counts is as near."""
    slip_m, slip = evidence.unjoined[0].nearest(xy)
    left_out_m, left_out = evidence.left_out.nearest(xy)
    reasons: list[Reason | None] = [None] * len(xy)
    for row in np.flatnonzero(np.minimum(slip_m, left_out_m) < np.minimum(node_m, SAME_PLACE_M + 1e-9)).tolist():
        if slip_m[row] <= left_out_m[row]:
            found = evidence.unjoined[1][slip[row]]
            reasons[row] = Reason(found.kind, f"{slip_m[row]:.1f} m away {found.text}: an error of OpenStreetMap?")
        else:
            way = f"{evidence.graph.ways.label(int(left_out[row]))}, {left_out_m[row]:.1f} m away"
            reasons[row] = Reason("left_out", f"junction with {way}, which policy {evidence.nodes.policy} leaves out")
    return reasons


def _near_node(evidence: MapEvidence, node: int, xy: FloatArray, limit_m: float, *, is_second: bool) -> Reason:
    """Say what a wrong place (2,) has to do with the node that counts near it."""
    name, distance_m = evidence.name_of(node), float(np.hypot(*(evidence.node_xy[node] - xy)))
    angle = evidence.fork_deg(node, xy)
    if angle <= FORK_DEG:
        return Reason("fork", f"roads part by only {angle:.0f} degrees at {name}, {distance_m:.1f} m away")
    if is_second:
        return Reason("second", f"second one at a compound or wide junction: {name}, {distance_m:.1f} m away, has one")
    return Reason("off", f"off by {distance_m:.1f} m from {name}; {limit_m:g} m are allowed")


@dataclass(frozen=True)
class FoundByDrive:
    """What a drive found, in the plane of a `MapEvidence`."""

    keyframe_xy: FloatArray
    """(K, 2) float64."""
    detection_xy: FloatArray
    """(D, 2) float64."""
    detection_keyframe: IntArray
    """(D,) int64."""
    detection_intersection: IntArray
    """(D,) int64: row of the intersection that each belongs to, -1 for none."""
    intersection_xy: FloatArray
    """(M, 2) float64."""
    intersection_id: IntArray
    """(M,) int64."""
    intersection_node: IntArray
    """(M,) int64: row of the node that each is assigned to, -1 for none."""
    gate_m: float
    """Largest distance of an intersection from its node."""


def explain_missed(evidence: MapEvidence, seen: FoundByDrive, node: int, mosaic: Mosaic | None = None) -> Reason:
    """Say of a node, by its row, that no intersection was assigned to what the drive found there instead."""
    reason = _explain_missed(evidence, seen, node)
    if reason.kind not in _OF_BRANCHES:
        return reason
    branches = "what road was seen is not known" if mosaic is None else evidence.branches_seen(node, mosaic)
    return reason if branches is None else Reason(reason.kind, f"{reason.sentence}; {branches}")


def _explain_missed(evidence: MapEvidence, seen: FoundByDrive, node: int) -> Reason:
    xy = evidence.node_xy[node]
    fused_m = np.hypot(*(seen.intersection_xy - xy).T)
    is_free = seen.intersection_node < 0
    of_others = np.where(is_free, np.inf, fused_m)
    detected = np.hypot(*(seen.detection_xy - xy).T) <= seen.gate_m
    neighbour_m = np.hypot(*(evidence.node_xy[seen.intersection_node] - xy).T)
    holds_both = np.isin(np.arange(len(fused_m)), seen.detection_intersection[detected]) | (fused_m <= seen.gate_m)
    of_others[(neighbour_m > COMPOUND_M) | ~holds_both] = np.inf
    part_m = evidence.parts_m(node, seen.intersection_xy)  # large places reach further than their middle
    unassigned_m = np.where(is_free, np.minimum(fused_m, part_m), np.inf)
    merged_m, misplaced_m = of_others.min(initial=np.inf), unassigned_m.min(initial=np.inf)
    if merged_m <= COMPOUND_M and merged_m <= misplaced_m:
        row = int(np.argmin(of_others))
        other = evidence.name_of(int(seen.intersection_node[row]))
        return Reason("merged", f"merged with {other}, {neighbour_m[row]:.1f} m away: one intersection stands for both")
    if misplaced_m <= NEAR_M:
        row = int(np.argmin(unassigned_m))
        return Reason(
            "misplaced",
            f"intersection {seen.intersection_id[row]} lies {fused_m[row]:.1f} m off{evidence.off_what(node)}; "
            f"{seen.gate_m:g} m are allowed",
        )
    if detected.any():
        keyframes = len(np.unique(seen.detection_keyframe[detected]))
        return Reason(
            "too_few", f"detected at keyframes: {keyframes}; too rarely or weakly for an intersection of the map"
        )
    return _not_detected(evidence, seen, node)


def _not_detected(evidence: MapEvidence, seen: FoundByDrive, node: int) -> Reason:
    """Say of a node at which nothing was detected what may be the cause."""
    keyframe_m = evidence.parts_m(node, seen.keyframe_xy)
    passed_m = float(keyframe_m.min())
    if levels := evidence.levels(node, seen.keyframe_xy[keyframe_m <= LEVEL_M]):
        return Reason("levels", levels)
    if twice := evidence.drawn_twice(node):
        return Reason("twice", twice)
    if passed_m > PASSED_M:
        return Reason("not_driven", f"no keyframe near enough: {passed_m:.1f} m at the nearest")
    lengths = evidence.branch_lengths_m(node)
    if lengths is not None and sum(each >= BRANCH_M for each in lengths) < MIN_DEGREE:
        listed = ", ".join(f"{each:.0f}" for each in sorted(lengths))
        return Reason("short", f"branches too short: the next junctions or ends are {listed} m away")
    return Reason("not_seen", f"nothing detected; the nearest keyframe {passed_m:.1f} m away")
