"""The verdict on every detection, intersection and node: right or wrong, found or missed, and why."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, IntArray
from interloc.evaluation.map_level import MapLevel, assign_one_to_one
from interloc.evaluation.matching import UNMATCHED, Matching
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M
from interloc.evaluation.reasons import (
    FalseKind,
    MapEvidence,
    MissKind,
    Reason,
    Sightings,
    count_kinds,
    explain_false,
    explain_missed,
)
from interloc.osm.graph import RoadGraph, within
from interloc.osm.intersections import IntersectionNodes, intersection_nodes
from interloc.output.uids import number_repeated, place_uids
from interloc.results import DriveResult, IntersectionTable, Verdicts

OUTSIDE_MAP = "beyond the bounds of the map"
OUTSIDE_ZONE = "in the relevant zone of no keyframe: too far from the track to be counted"


@dataclass(frozen=True)
class RunVerdicts:
    """What an evaluation says about all that a run found, and about all nodes.

    Attributes
    ----------
    detections : Verdicts
        Of all D detections of the run; those beyond the map are unscored.
    intersections : Verdicts
        Of the M fused intersections.
    uids : list of M str
        Names of their places, see `interloc.output.uids`.
    node_outcome : list of N str
        found, missed or outside.
    node_intersection : (N,) int64
        Row of the intersection assigned to each node, -1 for none.
    node_reason : list of N str or None
        Why a node was missed.
    false_kind : list of E str or None
        Kind of the reason, of `KINDS`, why each scored detection is wrong.
    miss_kind : list of N str or None
        The same of each missed node.
    counts : dict
        `detections`, `intersections` and `nodes`: kind of reason -> how many.
    """

    detections: Verdicts
    intersections: Verdicts
    uids: list[str]
    node_outcome: list[str]
    node_intersection: IntArray
    node_reason: list[str | None]
    false_kind: list[str | None]
    miss_kind: list[str | None]
    counts: dict[str, dict[str, int]]


def judge(
    graph: RoadGraph,
    nodes: IntersectionNodes,
    result: DriveResult,
    detection_row: IntArray,
    matching: Matching,
    map_level: MapLevel,
) -> RunVerdicts:
    """Give the verdicts of an evaluation, with reasons.

    Parameters
    ----------
    graph, nodes
        The whole map, and what counts of it.
    result
        The run, with georeference.
    detection_row : (E,) int64
        Rows of the detections that were scored.
    matching
        Of the scored detections with the nodes.
    map_level
        Of all fused intersections with the nodes.
    """
    keyframes, intersections = result.keyframes, result.intersections
    detections = result.detections.select(detection_row)
    assert keyframes.lonlat is not None
    assert detections.lonlat is not None
    assert intersections.lonlat is not None
    evidence = MapEvidence(graph, nodes, keyframes.lonlat)
    osm_ids: list[int | None] = [*nodes.osm_id.tolist(), None]  # row -1: none

    true = matching.error_m < STANDARD_THRESHOLD_M
    false_rows = np.flatnonzero(~true)
    false = explain_false(
        evidence,
        evidence.plane(detections.lonlat[false_rows]),
        detections.keyframe[false_rows].tolist(),
        zip(detections.keyframe[true].tolist(), matching.node[true].tolist(), strict=True),
        STANDARD_THRESHOLD_M,
    )
    scored = Verdicts(
        ["right" if each else "wrong" for each in true.tolist()],
        [osm_ids[row] for row in matching.node.tolist()],
        matching.error_m,
        _spread(len(detections), false_rows, _sentences(false)),
    )

    wrong_rows = np.flatnonzero(map_level.wrong)
    wrong = explain_false(
        evidence,
        evidence.plane(intersections.lonlat[wrong_rows]),
        [0] * len(wrong_rows),
        ((0, row) for row in map_level.node[map_level.node != UNMATCHED].tolist()),
        map_level.gate_m,
    )
    fused = Verdicts(
        [
            ("unscored" if not counts else "right" if node != UNMATCHED else "wrong")
            for counts, node in zip(map_level.counts.tolist(), map_level.node.tolist(), strict=True)
        ],
        [osm_ids[row] for row in map_level.node.tolist()],
        map_level.error_m,
        _spread(len(intersections), wrong_rows, _sentences(wrong)),
    )
    inside = within(graph.bounds, intersections.lonlat)
    for row in np.flatnonzero(~map_level.counts).tolist():
        fused.reason[row] = OUTSIDE_ZONE if inside[row] else OUTSIDE_MAP

    missed_rows = np.flatnonzero(map_level.missed)
    seen = Sightings(
        keyframe_xy=evidence.plane(keyframes.lonlat),
        detection_xy=evidence.plane(detections.lonlat),
        detection_keyframe=detections.keyframe,
        detection_intersection=detections.intersection,
        intersection_xy=evidence.plane(intersections.lonlat),
        intersection_id=intersections.id,
        intersection_node=map_level.node,
        gate_m=map_level.gate_m,
    )
    missed = [explain_missed(evidence, seen, row) for row in missed_rows.tolist()]
    assigned = np.flatnonzero(map_level.node != UNMATCHED)
    node_intersection = np.full(len(nodes), UNMATCHED, dtype=np.int64)
    node_intersection[map_level.node[assigned]] = assigned
    return RunVerdicts(
        detections=_of_all(scored, detection_row, len(result.detections)),
        intersections=fused,
        uids=_uids(graph, intersections, map_level, osm_ids),
        node_outcome=_node_outcomes(map_level.node_found, map_level.node_in_zone),
        node_intersection=node_intersection,
        node_reason=_spread(len(nodes), missed_rows, _sentences(missed)),
        false_kind=_spread(len(detections), false_rows, [reason.kind for reason in false]),
        miss_kind=_spread(len(nodes), missed_rows, [reason.kind for reason in missed]),
        counts={
            "detections": count_kinds(false, FalseKind),
            "intersections": count_kinds(wrong, FalseKind),
            "nodes": count_kinds(missed, MissKind),
        },
    )


def _sentences(reasons: Iterable[Reason]) -> list[str]:
    return [reason.sentence for reason in reasons]


def _spread(count: int, rows: IntArray, values: Sequence[str]) -> list[str | None]:
    """Return the values of some rows of a table as a column of all of them."""
    column: list[str | None] = [None] * count
    for row, value in zip(rows.tolist(), values, strict=True):
        column[row] = value
    return column


def _of_all(scored: Verdicts, rows: IntArray, count: int) -> Verdicts:
    """Return the verdicts of all detections of a run: those that were not scored lie beyond the map."""
    every = Verdicts.unscored(count)
    every.reason[:] = [OUTSIDE_MAP] * count
    every.error_m[rows] = scored.error_m
    for row, outcome, osm_id, reason in zip(rows.tolist(), scored.outcome, scored.osm_id, scored.reason, strict=True):
        every.outcome[row], every.osm_id[row], every.reason[row] = outcome, osm_id, reason
    return every


def _node_outcomes(found: BoolArray, in_zone: BoolArray) -> list[str]:
    pairs = zip(found.tolist(), in_zone.tolist(), strict=True)
    return ["outside" if not is_in else "found" if is_found else "missed" for is_found, is_in in pairs]


def _uids(
    graph: RoadGraph, intersections: IntersectionTable, level: MapLevel, osm_ids: Sequence[int | None]
) -> list[str]:
    """Name the places of intersections by the map: their node, else a junction of roads that no other stands for."""
    assert intersections.lonlat is not None
    names: list[Any] = [osm_ids[row] for row in level.node.tolist()]
    junctions = intersection_nodes(graph, "drive+service")
    free = np.flatnonzero(~np.isin(junctions.osm_id, [name for name in names if name is not None]))
    open_rows = np.flatnonzero(level.node == UNMATCHED)
    rows, columns, _ = assign_one_to_one(intersections.lonlat[open_rows], junctions.lonlat[free], level.gate_m)
    for row, osm_id in zip(open_rows[rows].tolist(), junctions.osm_id[free[columns]].tolist(), strict=True):
        names[row] = osm_id
    cells = place_uids(intersections)
    uids = [cell if name is None else f"n{name}" for name, cell in zip(names, cells, strict=True)]
    return number_repeated(uids, intersections.lonlat)
