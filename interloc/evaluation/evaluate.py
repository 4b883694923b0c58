"""The evaluation of the paper's section IV, from a run and a road map to figures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from interloc.arrays import IntArray
from interloc.errors import ConfigError, GeoreferenceError
from interloc.evaluation.coverage import check_coverage
from interloc.evaluation.map_level import MapLevel, assign_intersections
from interloc.evaluation.matching import Matching, match
from interloc.evaluation.metrics import ErrorSummary, NodeTable, Scores, score, summarize_errors, tabulate_nodes
from interloc.evaluation.verdicts import RunVerdicts, judge
from interloc.osm.graph import RoadGraph, within
from interloc.osm.intersections import IntersectionNodes, intersection_nodes
from interloc.osm.policies import Policy
from interloc.output.geojson import positions
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable

PAPER_ROI_M = 120.0
PAPER_OUTER_RADIUS_M = 40.0


@dataclass(frozen=True)
class Evaluation:
    """A run scored against OpenStreetMap.

    Attributes
    ----------
    drive : str
        Name of the drive.
    roi_m, relevant_zone_m : float
        Sides of the two squares, metres.
    graph : RoadGraph
        The map.
    nodes : IntersectionNodes
        Its ground truth intersections, with the policy that chose them.
    keyframes : KeyframeTable
    intersections : IntersectionTable
        All that the run fused.
    detections : DetectionTable
        Those that were scored: all that lie on the map.
    detection_row : (E,) int64
        Rows of them in the result.
    detections_outside_map : int
        Detections beyond the declared bounds of the map, where nothing is known about them.
    matching : Matching
        Of `detections` with `nodes`.
    errors : ErrorSummary
    scores : Scores
    node_table : NodeTable
    map_level : MapLevel
        Of the fused intersections with `nodes`.
    georeference : dict
        Where longitude and latitude come from: `source` ("drive" or "map"), and what `run.json` says of their
        uncertainty where it is the map.
    track_to_road_m : float
        Median distance of the track from the nearest drivable road, metres.
    warnings : tuple of str
        Reasons to read the figures with care.
    """

    drive: str
    roi_m: float
    relevant_zone_m: float
    graph: RoadGraph
    nodes: IntersectionNodes
    keyframes: KeyframeTable
    intersections: IntersectionTable
    detections: DetectionTable
    detection_row: IntArray
    detections_outside_map: int
    matching: Matching
    errors: ErrorSummary
    scores: Scores
    node_table: NodeTable
    map_level: MapLevel
    georeference: dict[str, Any]
    track_to_road_m: float
    warnings: tuple[str, ...]

    @cached_property
    def verdicts(self) -> RunVerdicts:
        """Right or wrong, found or missed, and why: of every detection, intersection and node."""
        return judge(
            self.graph,
            self.nodes,
            self.keyframes,
            self.detections,
            self.detection_row,
            len(self.detections) + self.detections_outside_map,
            self.matching,
            self.intersections,
            self.map_level,
            self.node_table,
        )


def evaluate(
    result: DriveResult,
    graph: RoadGraph,
    *,
    policy: Policy = "drive",
    roi_m: float | None = None,
    relevant_zone_m: float | None = None,
    tolerance_m: float = 15.0,
) -> Evaluation:
    """Score the detections and the fused intersections of a run against the nodes of a road map.

    Parameters
    ----------
    result
        Result of `detect`, with georeference.
    graph
        The roads around the drive.
    policy
        Which OSM nodes count as intersections.
    roi_m
        Side S of the ROI, metres; default: the one that the run used (120 in the paper).
    relevant_zone_m
        Side of the relevant zone, metres; default: S - 2 a_o of the run (40 in the paper).
    tolerance_m
        Radius of the merging under policy `consolidated`, metres.

    Raises
    ------
    GeoreferenceError
        The run has no longitude and latitude.
    MapError
        The map is of another place.
    ConfigError
        The policy is unknown, or the sizes of the zones are not valid.
    """
    result = _as_printed(result)
    if result.keyframes.lonlat is None or result.detections.lonlat is None or result.intersections.lonlat is None:
        raise GeoreferenceError(
            f"{result.drive}: the run has no georeference, so its detections cannot be compared with OpenStreetMap. "
            "Detect again with one: --oxts with a KITTI raw drive or a file of OXTS rows, or geo.csv in the drive."
        )
    roi_m, relevant_zone_m = _zones(result.run, roi_m, relevant_zone_m)
    track_to_road_m, warnings = check_coverage(result.keyframes.lonlat, graph, roi_m=roi_m)
    nodes = intersection_nodes(graph, policy, tolerance_m)

    on_map = np.flatnonzero(within(graph.bounds, result.detections.lonlat))
    detections = _select(result.detections, on_map)
    matching = match(result.keyframes, detections, nodes.lonlat, roi_m=roi_m, relevant_zone_m=relevant_zone_m)
    node_table = tabulate_nodes(matching, len(nodes))
    map_level = assign_intersections(
        result.keyframes,
        result.intersections,
        nodes.lonlat,
        node_table.in_zone,
        relevant_zone_m=relevant_zone_m,
    )
    map_level = replace(map_level, counts=map_level.counts & within(graph.bounds, result.intersections.lonlat))
    if "location" in result.run:
        warnings += (
            result.run["location"].get("scored")
            or "The run was placed on a map by its roads. If this is the same map, the figures flatter; "
            "`interloc run --locate` scores each node with a fit that left it out.",
        )
    if not node_table.in_zone.any():
        warnings += (
            f"No intersection of policy {policy} lies in the relevant zone of any keyframe: recall is undefined.",
        )
    return Evaluation(
        drive=result.drive,
        roi_m=roi_m,
        relevant_zone_m=relevant_zone_m,
        graph=graph,
        nodes=nodes,
        keyframes=result.keyframes,
        intersections=result.intersections,
        detections=detections,
        detection_row=on_map,
        detections_outside_map=len(result.detections) - len(on_map),
        matching=matching,
        errors=summarize_errors(matching),
        scores=score(matching),
        node_table=node_table,
        map_level=map_level,
        georeference=_georeference(result.run),
        track_to_road_m=track_to_road_m,
        warnings=warnings,
    )


def _as_printed(result: DriveResult) -> DriveResult:
    """Return a run with the positions of its files, so that a run and its result folder get the same report."""

    def printed(table: Any) -> Any:  # noqa: ANN401 - one of three tables
        if table.lonlat is None:
            return table
        return replace(table, lonlat=np.array(positions(table.lonlat, local=False)).reshape(-1, 2))

    tables = ("keyframes", "detections", "intersections")
    return replace(result, **{name: printed(getattr(result, name)) for name in tables})


def _georeference(run: dict[str, Any]) -> dict[str, Any]:
    location = run.get("location")
    if location is None:
        return {"source": "drive"}
    return {"source": "map", **{name: location.get(name) for name in ("position_std_m", "heading_std_deg")}}


def _zones(run: dict[str, Any], roi_m: float | None, relevant_zone_m: float | None) -> tuple[float, float]:
    """Take S and S - 2 a_o from the configuration of the run where they are not given."""
    config = run.get("config", {})
    if roi_m is None:
        roi_m = float(config.get("bev", {}).get("size_m", PAPER_ROI_M))
    if relevant_zone_m is None:
        outer = float(config.get("branches", {}).get("outer_radius_m", PAPER_OUTER_RADIUS_M))
        relevant_zone_m = roi_m - 2.0 * outer
    if not 0.0 < relevant_zone_m <= roi_m:
        raise ConfigError(
            f"the relevant zone is {relevant_zone_m:g} m wide and the region of interest {roi_m:g} m. "
            "Expected 0 < zone <= region; the zone is the region less twice the outer branch radius unless given."
        )
    return roi_m, relevant_zone_m


def _select(detections: DetectionTable, rows: IntArray) -> DetectionTable:
    return DetectionTable(
        keyframe=detections.keyframe[rows],
        lidar_xy=detections.lidar_xy[rows],
        world_xy=detections.world_xy[rows],
        lonlat=None if detections.lonlat is None else detections.lonlat[rows],
        bearings_deg=[detections.bearings_deg[row] for row in rows],
        score=detections.score[rows],
        intersection=detections.intersection[rows],
    )
