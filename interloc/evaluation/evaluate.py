"""The evaluation of the paper's section IV, from a run and a road map to figures."""

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from interloc.arrays import IntArray, JsonObject
from interloc.drives.folder import dropped_in_words
from interloc.errors import ConfigError, GeoreferenceError, expect
from interloc.evaluation import metrics
from interloc.evaluation.coverage import check_coverage, warn_of_border
from interloc.evaluation.roads import RoadScores, score_roads
from interloc.evaluation.verdicts import RunVerdicts, give_verdicts
from interloc.labelling.track import doubts_in_words
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import IntersectionNodes, intersection_nodes
from interloc.osm.policies import Policy
from interloc.output.geojson import as_printed
from interloc.output.roads import roads
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable, RunRecord
from interloc.roadmap.network import RoadNetwork
from interloc.wording import metres, percent

logger = logging.getLogger(__name__)

PAPER_ROI_M = 120.0
PAPER_OUTER_RADIUS_M = 40.0


@dataclass(frozen=True)
class Evaluation:
    """A run scored against OpenStreetMap."""

    roi_m: float
    relevant_zone_m: float
    """Sides of the two squares, metres."""
    graph: RoadGraph
    """The map."""
    nodes: IntersectionNodes
    """Its ground truth intersections, with the policy that chose them."""
    detection_row: IntArray
    """(E,) int64: rows of the detections that were scored: all that lie on the map."""
    matching: metrics.Matching
    """Of `detections` with `nodes`."""
    errors: metrics.ErrorSummary
    scores: metrics.Scores
    node_table: metrics.NodeTable
    map_level: metrics.MapLevel
    """Of the fused intersections with `nodes`."""
    track_to_road_m: float
    """Median distance of the track from the nearest drivable road, metres."""
    warnings: tuple[str, ...]
    """Reasons to read the figures with care."""
    result: DriveResult
    """The run that was scored, with the positions of its files."""
    given: DriveResult
    """The same as it was given."""
    network: RoadNetwork | None = None
    """Its roads, where they were made before."""

    @property
    def drive(self) -> str:
        """Name of the drive."""
        return self.result.drive

    @property
    def keyframes(self) -> KeyframeTable:
        """The keyframes of the run."""
        return self.result.keyframes

    @property
    def intersections(self) -> IntersectionTable:
        """All that the run fused."""
        return self.result.intersections

    @cached_property
    def detections(self) -> DetectionTable:
        """The detections that were scored: all that lie on the map."""
        return self.result.detections.select(self.detection_row)

    @property
    def detections_outside_map(self) -> int:
        """Number of detections beyond the declared bounds of the map, where nothing is known about them."""
        return len(self.result.detections) - len(self.detection_row)

    @property
    def georeference(self) -> JsonObject:
        """Where longitude and latitude come from: `source` ("drive" or "map"), and how uncertain a map makes them."""
        location = self.result.run.get("location")
        if location is None:
            return {"source": "drive"}
        return {"source": "map", **{name: location.get(name) for name in ("position_std_m", "heading_std_deg")}}

    @property
    def ace_m(self) -> float | None:
        """Average center error of all matched detections, metres (the paper's ACE); None without any."""
        return self.errors.ace_m

    @property
    def median_m(self) -> float | None:
        """Median center error of all matched detections, metres; None without any."""
        return self.errors.median_m

    @property
    def precision(self) -> float | None:
        """Precision of the detections at D = 5 m, 0..1; `scores` has the other thresholds."""
        return self.scores.at(metrics.STANDARD_THRESHOLD_M, self.scores.precision)

    @property
    def recall(self) -> float | None:
        """Recall of the detections at D = 5 m, 0..1."""
        return self.scores.at(metrics.STANDARD_THRESHOLD_M, self.scores.recall)

    @property
    def f1(self) -> float | None:
        """F1 of the detections at D = 5 m, 0..1."""
        return self.scores.at(metrics.STANDARD_THRESHOLD_M, self.scores.f1)

    @property
    def nodes_in_zone(self) -> int:
        """Number of OpenStreetMap nodes that the drive should have found."""
        return int(self.node_table.in_zone.sum())

    @property
    def nodes_found(self) -> int:
        """Number of these that a detection within 5 m was matched to."""
        return int((self.node_table.in_zone & self.node_table.found).sum())

    def __repr__(self) -> str:
        return (
            f"<Evaluation {self.drive}: ACE {metres(self.ace_m)}, precision {percent(self.precision)}, "
            f"recall {percent(self.recall)} at {metrics.STANDARD_THRESHOLD_M:g} m, "
            f"{self.nodes_found} of {self.nodes_in_zone} nodes>"
        )

    def geodataframe(self, layer: str = "intersections") -> Any:  # noqa: ANN401 - geopandas has no types
        """Return a layer, with its verdicts, as a GeoDataFrame: `interloc.geodataframe`."""
        import interloc  # noqa: PLC0415 - the public face stands above everything

        return interloc.geodataframe(self, layer)

    @cached_property
    def roads(self) -> RoadScores | None:
        """The map of the roads against the map; None where no road was seen."""
        network = roads(self.given) if self.network is None else self.network
        return score_roads(network, self.graph, self.nodes.policy)

    @cached_property
    def with_service(self) -> "Evaluation | None":
        """The same run under policy drive+service; None where it was scored under another one than drive."""
        if self.nodes.policy != "drive":
            return None
        return _score(
            self.result,
            self.graph,
            intersection_nodes(self.graph, "drive+service"),
            roi_m=self.roi_m,
            relevant_zone_m=self.relevant_zone_m,
            track_to_road_m=self.track_to_road_m,
            warnings=(),
            given=self.given,
        )

    @cached_property
    def verdicts(self) -> RunVerdicts:
        """Right or wrong, found or missed, and why: of every detection, intersection and node."""
        return give_verdicts(self.graph, self.nodes, self.result, self.detection_row, self.matching, self.map_level)


def evaluate(
    result: DriveResult,
    graph: RoadGraph,
    *,
    policy: Policy = "drive",
    roi_m: float | None = None,
    relevant_zone_m: float | None = None,
    tolerance_m: float = 15.0,
    network: RoadNetwork | None = None,
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
    network
        The roads of the run, as `write_results` returns them; by default they are made when they are asked for.

    Raises
    ------
    GeoreferenceError
        The run has no longitude and latitude.
    MapError
        The map is of another place.
    ConfigError
        The policy is unknown, or the sizes of the zones are not valid.
    """
    expect(result, DriveResult)
    expect(graph, RoadGraph)
    given, result = result, as_printed(result)
    if result.keyframes.lonlat is None or result.detections.lonlat is None or result.intersections.lonlat is None:
        raise GeoreferenceError(
            f"{result.drive}: the run has no georeference, so its detections cannot be compared with OpenStreetMap. "
            "Run it again with one: --oxts with a KITTI raw drive or a file of OXTS rows, or geo.csv in the drive."
        )
    roi_m, relevant_zone_m = _zones(result.run, roi_m, relevant_zone_m)
    track_to_road_m, warnings = check_coverage(result.keyframes.lonlat, graph, roi_m=roi_m)
    warnings += warn_of_border(result.keyframes.lonlat, result.detections.lonlat, graph)
    for warning in graph.warnings:
        logger.warning(warning)
    return _score(
        result,
        graph,
        intersection_nodes(graph, policy, tolerance_m),
        roi_m=roi_m,
        relevant_zone_m=relevant_zone_m,
        track_to_road_m=track_to_road_m,
        warnings=graph.warnings + warnings,
        given=given,
        network=network,
    )


def _score(
    result: DriveResult,
    graph: RoadGraph,
    nodes: IntersectionNodes,
    *,
    roi_m: float,
    relevant_zone_m: float,
    track_to_road_m: float,
    warnings: tuple[str, ...],
    given: DriveResult,
    network: RoadNetwork | None = None,
) -> Evaluation:
    on_map = np.flatnonzero(graph.covers(result.detections.degrees))
    near = np.unique(metrics.pairs_in_square(result.keyframes, nodes.lonlat, roi_m)[1])
    known = np.ones(len(nodes), dtype=np.bool_)  # what meets a node beyond the border of the file is missing
    known[near] = graph.covers(nodes.lonlat[near])
    nodes = nodes.select(known)
    detections = result.detections.select(on_map)
    matching = metrics.match(result.keyframes, detections, nodes.lonlat, roi_m=roi_m, relevant_zone_m=relevant_zone_m)
    node_table = metrics.tabulate_nodes(matching, len(nodes))
    map_level = metrics.assign_intersections(
        result.keyframes, result.intersections, nodes.lonlat, node_table.in_zone, relevant_zone_m=relevant_zone_m
    )
    map_level = replace(map_level, counts=map_level.counts & graph.covers(result.intersections.degrees))
    if doubts := result.run.get("doubtful_labels_m"):
        warnings += (doubts_in_words(doubts),)
    if dropped := result.run.get("dropped"):
        warnings += (dropped_in_words(dropped),)
    if "location" in result.run:
        warnings += (
            result.run["location"].get("scored")
            or "The run was placed on a map by its roads. If this is the same map, the figures flatter; "
            "`interloc run --locate` scores each node with a fit that left it out.",
        )
    if not node_table.in_zone.any():
        warnings += (
            f"No intersection of policy {nodes.policy} lies in the relevant zone of any keyframe: recall is undefined.",
        )
    return Evaluation(
        roi_m=roi_m,
        relevant_zone_m=relevant_zone_m,
        graph=graph,
        nodes=nodes,
        detection_row=on_map,
        matching=matching,
        errors=metrics.summarize_errors(matching),
        scores=metrics.score(matching),
        node_table=node_table,
        map_level=map_level,
        track_to_road_m=track_to_road_m,
        warnings=warnings,
        result=result,
        given=given,
        network=network,
    )


def _zones(run: RunRecord, roi_m: float | None, relevant_zone_m: float | None) -> tuple[float, float]:
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
