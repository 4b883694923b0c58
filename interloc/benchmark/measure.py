"""One drive, one preset, one level of label errors: detect, evaluate, and keep what tables and figures need."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.benchmark.failures import Explain, find_failures
from interloc.benchmark.row import Cell, MapPicture, Place, Point, Row
from interloc.config import DetectorConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drive import Drive
from interloc.drives.label_errors import MislabelledDrive
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.evaluation.label_errors import parse_level
from interloc.evaluation.matching import UNMATCHED
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M
from interloc.evaluation.reliability import squared_errors
from interloc.geometry import enu_from_lonlat, middle_of
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import road_ways
from interloc.osm.policies import Policy
from interloc.pipeline import detect, detect_range
from interloc.processes import Progress
from interloc.results import DriveResult

MAP_MARGIN_M = 60.0
_TRACK_STEP_M = 3.0


@dataclass(frozen=True)
class Scoring:
    """How detections are scored."""

    policy: Policy = "drive"
    tolerance_m: float = 15.0
    """Of policy `consolidated`."""


def measure(
    cell: Cell,
    fingerprint: str,
    drive: Drive,
    graph: RoadGraph,
    config: DetectorConfig,
    truth: Scoring,
    explain: Explain,
    *,
    axes: Mapping[int, tuple[float, float]] | None = None,
    progress: Progress | None = None,
) -> Row:
    """Measure a cell of the benchmark.

    Parameters
    ----------
    cell, fingerprint
        Which measurement this is.
    drive, graph
        Drive without label errors, and its map.
    config, truth
    explain
        Gives the command lines that show a frame.
    axes
        Longitude and latitude of where the axes of the roads meet, by node; None: at the nodes.
    progress
        See `interloc.pipeline.detect`.

    Raises
    ------
    DriveError, GeoreferenceError, MapError
        The drive is damaged, or does not fit its map.
    """
    r_fpr, r_fnr = parse_level(cell.noise)
    source = MislabelledDrive(drive, r_fpr, r_fnr, cell.seed) if r_fpr or r_fnr else drive
    _warm_up(source, config)
    began = time.process_time()
    result = detect(source, config, progress=progress)
    used_s = time.process_time() - began  # of this process: what else runs on the machine does not count
    evaluation = evaluate(result, graph, policy=truth.policy, tolerance_m=truth.tolerance_m)
    matching, level = evaluation.matching, evaluation.map_level
    squared = squared_errors(evaluation.intersections, level, evaluation.nodes.lonlat)
    return Row(
        cell=cell,
        fingerprint=fingerprint,
        policy=truth.policy,
        keyframes=len(evaluation.keyframes),
        errors_m=_rounded(matching.error_m[matching.is_matched]),
        places=_places(evaluation, axes),
        unmatched=int(np.count_nonzero(~matching.is_matched)),
        fn=evaluation.scores.fn,
        nodes_found=evaluation.nodes_found,
        nodes_in_zone=evaluation.nodes_in_zone,
        map_true=int(level.right.sum()),
        map_false=int(level.wrong.sum()),
        map_missed=int(level.missed.sum()),
        map_nodes=int(level.node_in_zone.sum()),
        map_errors_m=_rounded(level.errors_m),
        map_axes_errors_m=_from_axes(evaluation, axes or {}),
        map_squared=_rounded(squared[np.isfinite(squared)]),
        map_confidence=_rounded(evaluation.intersections.confidence[level.counts]),
        map_right=tuple(level.right[level.counts].tolist()),
        compute_s=round(used_s, 4),
        warnings=evaluation.warnings,
        picture=map_picture(evaluation, result),
        failures=find_failures(evaluation, explain),
    )


def _places(evaluation: Evaluation, axes: Mapping[int, tuple[float, float]] | None) -> tuple[Place, ...]:
    matching, lonlat, ids = evaluation.matching, evaluation.detections.lonlat, evaluation.nodes.osm_id
    assert lonlat is not None
    missed = np.bincount(matching.zone_node[~matching.zone_found], minlength=len(ids))
    places = []
    for node in np.unique([*matching.node.tolist(), *np.flatnonzero(missed).tolist()]).tolist():
        rows = np.flatnonzero(matching.node == node)
        known = node != UNMATCHED
        errors = matching.error_m[rows] if known else np.zeros(0)
        number = int(ids[node]) if known else UNMATCHED
        off = float(errors.sum()) if known and axes is None else None
        if axes is not None and number in axes:
            off = float(np.hypot(*enu_from_lonlat(*axes[number][::-1], lonlat[rows]).T).sum())
        places.append(
            Place(
                node=number,
                detections=len(rows),
                right=int((errors < STANDARD_THRESHOLD_M).sum()),
                missed=int(missed[node]) if known else 0,
                error_m=round(float(errors.sum()), 4),
                axes_error_m=None if off is None else round(off, 4),
            )
        )
    return tuple(places)


def _from_axes(evaluation: Evaluation, axes: Mapping[int, tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    level, lonlat, nodes = evaluation.map_level, evaluation.intersections.lonlat, evaluation.nodes
    assert lonlat is not None
    found = []
    for row in np.flatnonzero(level.node != UNMATCHED).tolist():
        node = level.node[row]
        if (place := axes.get(int(nodes.osm_id[node]))) is not None:
            origins = np.array([nodes.lonlat[node], place])
            errors = np.hypot(*enu_from_lonlat(origins[:, 1], origins[:, 0], np.broadcast_to(lonlat[row], (2, 2))).T)
            found.append((round(float(errors[0]), 4), round(float(errors[1]), 4)))
    return tuple(found)


def _warm_up(drive: Drive, config: DetectorConfig) -> None:
    """Detect around a keyframe in the middle, so that no compiling is timed."""
    keyframes = select_keyframes(drive.T_world_lidar, config.keyframes)
    middle = len(keyframes) // 2
    detect_range(drive, keyframes, middle, min(middle + 1, len(keyframes)), config)


def map_picture(evaluation: Evaluation, result: DriveResult) -> MapPicture:
    """Return what the map of an evaluated drive shows (paper, Fig. 6)."""
    assert result.trajectory_lonlat is not None
    assert evaluation.detections.lonlat is not None
    lon, lat = middle_of(result.trajectory_lonlat)
    track = _thin(enu_from_lonlat(lat, lon, result.trajectory_lonlat))
    low, high = track.min(axis=0) - MAP_MARGIN_M, track.max(axis=0) + MAP_MARGIN_M

    graph = evaluation.graph
    near = np.abs(graph.lonlat - (lon, lat)).max(axis=1) < 1.0  # the plane has an end
    place = np.full((len(graph.lonlat), 2), np.nan)
    place[near] = enu_from_lonlat(lat, lon, graph.lonlat[near])
    pieces = place[graph.edges_of(road_ways(graph, evaluation.nodes.policy))]
    shown = ((pieces.min(axis=1) <= high) & (pieces.max(axis=1) >= low)).all(axis=1)

    nodes = enu_from_lonlat(lat, lon, evaluation.nodes.lonlat)
    inside = ((nodes >= low) & (nodes <= high)).all(axis=1)
    table = evaluation.node_table
    detections = enu_from_lonlat(lat, lon, evaluation.detections.lonlat)
    true = evaluation.matching.error_m < STANDARD_THRESHOLD_M
    return MapPicture(
        roads=tuple((a, b, c, d) for a, b, c, d in np.round(pieces[shown].reshape(-1, 4), 1).tolist()),
        track=_points(track),
        true=_points(detections[true]),
        false=_points(detections[~true]),
        found=_points(nodes[table.in_zone & table.found]),
        missed=_points(nodes[table.in_zone & ~table.found]),
        beyond=_points(nodes[~table.in_zone & inside]),
        is_made_up=graph.is_made_up,
    )


def _thin(track: FloatArray) -> FloatArray:
    """Leave out points of a track that are nearer than a few metres to the one before; the last stays."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))])
    _, first = np.unique((along / _TRACK_STEP_M).astype(np.int64), return_index=True)
    thinned: FloatArray = track[np.unique([*first, len(track) - 1])]
    return thinned


def _points(xy: FloatArray) -> tuple[Point, ...]:
    return tuple((x, y) for x, y in np.round(xy, 1).tolist())


def _rounded(values: FloatArray) -> tuple[float, ...]:
    return tuple(np.round(values, 4).tolist())
