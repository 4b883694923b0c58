"""The verdict on every detection, intersection and node: right or wrong, found or missed, and why."""

from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.evaluation.evidence import MapEvidence
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M, UNMATCHED, MapLevel, Matching, assign_one_to_one
from interloc.evaluation.reasons import (
    SAME_PLACE_M,
    FalseKind,
    FoundByDrive,
    MissKind,
    Reason,
    count_kinds,
    explain_false,
    explain_missed,
)
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import IntersectionNodes, intersection_nodes
from interloc.output.road import mosaic_of
from interloc.output.write import number_repeated, place_uids
from interloc.results import DriveResult, IntersectionTable, Verdicts

_AT_NODE_M = 0.5
"""Roads so near a node meet there."""

OUTSIDE_MAP = "beyond the bounds of the map"
OUTSIDE_ZONE = "in the relevant zone of no keyframe: too far from the track to be counted"


@dataclass(frozen=True)
class RunVerdicts:
    """What an evaluation says about all that a run found, and about all nodes."""

    detections: Verdicts
    """Of all D detections of the run; those beyond the map are unscored."""
    intersections: Verdicts
    """Of the M fused intersections."""
    uids: list[str]
    """Names of their places, see `interloc.output.write`."""
    names: list[str | None]
    """Names of the streets that meet there: "A / B"."""
    node_names: list[str | None]
    """The same of the nodes."""
    node_outcome: list[str]
    """found, missed or outside."""
    node_intersection: IntArray
    """(N,) int64: row of the intersection assigned to each node, -1 for none."""
    node_reason: list[str | None]
    """Why a node was missed; of one that was found, what is odd about it on the map."""
    counts: dict[str, dict[str, int]]
    """`detections`, `intersections` and `nodes`: kind of reason -> how many."""


def give_verdicts(
    graph: RoadGraph,
    nodes: IntersectionNodes,
    result: DriveResult,
    detection_row: IntArray,
    matching: Matching,
    map_level: MapLevel,
) -> RunVerdicts:
    """Give the verdicts of an evaluation, with reasons.

    `nodes` are what counts of the map, `detection_row` the rows of the detections that were scored, `matching` theirs
    with the nodes, `map_level` that of all fused intersections.
    """
    keyframes, intersections, every = result.keyframes, result.intersections, result.detections
    evidence = MapEvidence(graph, nodes, keyframes.degrees)

    node = np.full(len(every), UNMATCHED, dtype=np.int64)
    error_m = np.full(len(every), np.nan)
    is_scored = np.zeros(len(every), dtype=np.bool_)
    node[detection_row], error_m[detection_row], is_scored[detection_row] = matching.node, matching.error_m, True
    is_right = error_m < STANDARD_THRESHOLD_M
    detections, false = _verdicts(
        evidence, every.degrees, every.keyframe, node, error_m, is_scored, is_right, STANDARD_THRESHOLD_M
    )
    is_node = map_level.node != UNMATCHED
    once = np.zeros(len(intersections), dtype=np.int64)  # a map is seen at once, not keyframe by keyframe
    fused, wrong = _verdicts(
        evidence,
        intersections.degrees,
        once,
        map_level.node,
        map_level.error_m,
        map_level.counts,
        is_node,
        map_level.gate_m,
    )

    left_out = [reason is not None and reason.kind == "left_out" for reason in wrong]
    fused.outcome[:] = np.where(left_out, "not_counted", fused.outcome).tolist()

    seen = FoundByDrive(
        keyframe_xy=evidence.plane(keyframes.degrees),
        detection_xy=evidence.plane(every.degrees[detection_row]),
        detection_keyframe=every.keyframe[detection_row],
        detection_intersection=every.intersection[detection_row],
        intersection_xy=evidence.plane(intersections.degrees),
        intersection_id=intersections.id,
        intersection_node=map_level.node,
        gate_m=map_level.gate_m,
    )
    mosaic = mosaic_of(result) if map_level.missed.any() else None
    if mosaic is not None and (mosaic.epsg is None or not mosaic.raster.tiles):
        mosaic = None
    missed = [
        explain_missed(evidence, seen, row, mosaic) if each else None for row, each in enumerate(map_level.missed)
    ]
    odd = [evidence.oddity(row) if each else None for row, each in enumerate(map_level.node_found)]
    assigned = np.flatnonzero(is_node)
    node_intersection = np.full(len(nodes), UNMATCHED, dtype=np.int64)
    node_intersection[map_level.node[assigned]] = assigned
    return RunVerdicts(
        detections=detections,
        intersections=fused,
        uids=_uids(graph, intersections, map_level, fused.osm_id),
        names=_names(evidence, intersections.degrees, map_level.node),
        node_names=evidence.streets(evidence.node_xy, evidence.radius_m + _AT_NODE_M),
        node_outcome=np.select(
            [~map_level.node_in_zone, map_level.node_found], ["outside", "found"], "missed"
        ).tolist(),
        node_intersection=node_intersection,
        node_reason=[each.sentence if each else other for each, other in zip(missed, odd, strict=True)],
        counts={
            "detections": count_kinds(false, FalseKind),
            "intersections": count_kinds(wrong, FalseKind),
            "nodes": count_kinds(missed, MissKind),
        },
    )


def _verdicts(
    evidence: MapEvidence,
    lonlat: FloatArray,
    keyframe: IntArray,
    node: IntArray,
    error_m: FloatArray,
    is_scored: BoolArray,
    is_right: BoolArray,
    gate_m: float,
) -> tuple[Verdicts, list[Reason | None]]:
    """Give the verdicts on the rows of a table, and the reasons of those that are scored and wrong.

    `node`: row of the node that each was compared with, -1 for none.
    """
    wrong = np.flatnonzero(is_scored & ~is_right)
    claims = zip(keyframe[is_right].tolist(), node[is_right].tolist(), strict=True)
    found = explain_false(evidence, evidence.plane(lonlat[wrong]), keyframe[wrong].tolist(), claims, gate_m)
    reasons: list[Reason | None] = [None] * len(lonlat)
    for row, reason in zip(wrong.tolist(), found, strict=True):
        reasons[row] = reason
    beyond = np.where(evidence.graph.covers(lonlat), OUTSIDE_ZONE, OUTSIDE_MAP)
    sentences = [
        str(outside) if not scored else reason and reason.sentence
        for scored, outside, reason in zip(is_scored, beyond, reasons, strict=True)
    ]
    outcome = np.select([~is_scored, is_right], ["unscored", "right"], "wrong").tolist()
    osm_ids: list[int | None] = [*evidence.nodes.osm_id.tolist(), None]  # row -1: none
    return Verdicts(outcome, [osm_ids[row] for row in node.tolist()], error_m, sentences), reasons


def _names(evidence: MapEvidence, lonlat: FloatArray, node: IntArray) -> list[str | None]:
    """Name intersections by the streets that meet at their node, or else by those that are near."""
    has_node = node != UNMATCHED
    xy = np.where(has_node[:, None], evidence.node_xy[node] if len(evidence.nodes) else 0.0, evidence.plane(lonlat))
    at_node = evidence.radius_m[node] + _AT_NODE_M if len(evidence.nodes) else SAME_PLACE_M
    return evidence.streets(xy, np.where(has_node, at_node, SAME_PLACE_M))


def _uids(graph: RoadGraph, intersections: IntersectionTable, level: MapLevel, osm_ids: list[int | None]) -> list[str]:
    """Name the places of intersections by the map: their node, else a junction of roads that no other stands for."""
    names = list(osm_ids)
    junctions = intersection_nodes(graph, "drive+service")
    free = np.flatnonzero(~np.isin(junctions.osm_id, [name for name in names if name is not None]))
    open_rows = np.flatnonzero(level.node == UNMATCHED)
    rows, columns, _ = assign_one_to_one(intersections.degrees[open_rows], junctions.lonlat[free], level.gate_m)
    for row, osm_id in zip(open_rows[rows].tolist(), junctions.osm_id[free[columns]].tolist(), strict=True):
        names[row] = osm_id
    cells = place_uids(intersections)
    uids = [cell if name is None else f"n{name}" for name, cell in zip(names, cells, strict=True)]
    return number_repeated(uids, intersections.degrees)
