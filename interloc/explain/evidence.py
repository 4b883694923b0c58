"""What the method saw and did at one keyframe, and what the map has there: what pictures show, and its numbers."""

import math
from dataclasses import dataclass
from itertools import islice

import numpy as np

from interloc.arrays import FloatArray, Int32Array, IntArray, JsonObject
from interloc.config import BranchConfig, DetectorConfig
from interloc.detection.centerline import Piece
from interloc.detection.detector import Detector, KeyframeDetections, Steps, locate
from interloc.detection.image import BinaryImage, Roi
from interloc.detection.keyframes import Keyframe, select_keyframes
from interloc.drive import Drive, DriveScan, Georeference, GroundPoints, is_slow, read_ahead, scans_of
from interloc.errors import ConfigError, DriveError
from interloc.geometry import enu_from_lonlat, rotate_2d, wrap_longitude, yaw_of
from interloc.kernels import grid
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import intersection_nodes, road_ways
from interloc.osm.policies import Policy
from interloc.processes import cores


@dataclass(frozen=True)
class ExplainedCandidate:
    """One candidate and what became of it."""

    number: int
    """Its name in the pictures, from 1 on."""
    position: FloatArray
    """(2,) float64: row and column, pixels."""
    width: float
    """Road width there, pixels."""
    merged: FloatArray
    """(M, 2) float64: the corners or junctions of the centerline that it stands for, row and column."""
    inner: float
    """Radius of its inner circle, pixels."""
    pieces: list[Piece]
    """Those that are branches are in the order of its `Branches`."""
    detections: list[int]
    """Positions among ``Steps.junctions``: none, one, or several where it was split."""
    why_not: str | None
    """Why it is no intersection."""

    @property
    def is_kept(self) -> bool:
        """Whether it became an intersection."""
        return bool(self.detections)


def explain_candidates(steps: Steps, vehicle: FloatArray, config: BranchConfig) -> list[ExplainedCandidate]:
    """Explain all candidates of a keyframe, the nearest to the vehicle (x, y in W, metres) first."""
    candidates = steps.candidates
    order = np.argsort(np.hypot(*(candidates.positions - steps.roi.image(vehicle)).T), kind="stable")
    explained = []
    for number, index in enumerate(order.tolist(), start=1):
        around = steps.segmentation.pieces[index]
        position, pieces = candidates.positions[index], list(around)
        detections = [i for i, junction in enumerate(steps.junctions) if junction.branches.index == index]
        explained.append(
            ExplainedCandidate(
                number=number,
                position=position,
                width=float(candidates.widths[index]),
                merged=candidates.merged[index],
                inner=around.inner,
                pieces=pieces,
                detections=detections,
                why_not=None if detections else _why_not(position, pieces, steps.roi, config),
            )
        )
    return explained


def _why_not(position: FloatArray, pieces: list[Piece], roi: Roi, config: BranchConfig) -> str:
    count = sum(piece.is_branch for piece in pieces)
    if count >= config.min_branches:
        gap_m = float(min(position.min(), roi.size - 1 - position.max())) * roi.resolution_m
        return f"{gap_m:.1f} m from the border, {config.margin_m:g} m needed"
    why = f"{count} {'branch' if count == 1 else 'branches'}, {config.min_branches} needed"
    lost_m = [piece.reach * roi.resolution_m for piece in pieces if not piece.is_branch]
    short = [f"{reach_m:.1f}" for reach_m in lost_m if reach_m < config.min_reach_m]
    if short:
        why += f"; {len(short)} too short ({', '.join(short)} of {config.min_reach_m:g} m)"
    if len(short) < len(lost_m):
        why += f"; {len(lost_m) - len(short)} too short and narrow (less than {config.min_surface_m2:g} m2 of road)"
    return why


@dataclass(frozen=True)
class WindowScan:
    """One keyframe of the window."""

    frame: int
    """Scan number."""
    age: int
    """Keyframes after (+) or before (-) the one explained."""
    world_xy: FloatArray
    """(2,) float64: position of the LiDAR in W, metres."""
    cells: Int32Array
    """(N, 2) int32: cell along x and y of W of each road point."""


@dataclass(frozen=True)
class ExplainedKeyframe:
    """One keyframe, explained."""

    asked: int
    """Scan number that was asked for."""
    index: int
    """Position of the keyframe among the scans of the drive."""
    number: int
    keyframe_count: int
    """Position of the keyframe among the keyframes of the drive, from 0 on; how many there are."""
    keyframe: Keyframe
    config: DetectorConfig
    points: GroundPoints
    """Of the keyframe's own scan, in L."""
    window: list[WindowScan]
    """All keyframes accumulated, in the order of the drive."""
    steps: Steps
    """What the detector did."""
    candidates: list[ExplainedCandidate]
    """What became of each candidate, the nearest to the vehicle first."""
    detections: KeyframeDetections
    """In the order of ``steps.junctions``."""

    @property
    def roi(self) -> Roi:
        """Where the images lie in W."""
        return self.steps.roi

    @property
    def vehicle(self) -> FloatArray:
        """(2,) float64: position of the LiDAR in W, metres."""
        return self.keyframe.T_world_lidar[:2, 3]

    @property
    def yaw_rad(self) -> float:
        """Heading in W, counter-clockwise from +x."""
        return float(yaw_of(self.keyframe.T_world_lidar[:3, :3]))

    def around(self, places: FloatArray) -> FloatArray:
        """Return x, y along the axes of W from the vehicle, metres, (..., 2), of (..., 2) rows and columns."""
        return self.roi.world(places[..., 0], places[..., 1]) - self.vehicle

    @property
    def kept(self) -> list[ExplainedCandidate]:
        """The candidates that became intersections."""
        return [each for each in self.candidates if each.is_kept]


def gather(drive: Drive, frame: int, config: DetectorConfig) -> ExplainedKeyframe:
    """Run the method on the keyframe nearest to a scan number of a drive, and keep everything."""
    if not len(drive.frames):
        raise DriveError(f"{drive.name}: the drive holds no scans")
    low, high = int(drive.frames[0]), int(drive.frames[-1])
    if not low <= frame <= high:
        raise ConfigError(f"frame {frame}: {drive.name} has the scans {low} to {high}")
    keyframes = select_keyframes(drive.T_world_lidar, config.keyframes)
    number = int(np.argmin(np.abs(drive.frames[keyframes] - frame)))
    first = max(0, number - config.keyframes.window)
    around = scans_of(drive, keyframes[first : number + config.keyframes.after + 1])
    scans = list(read_ahead(around, cores()) if is_slow(drive) else around)
    scan = scans[number - first]

    window = next(islice(Detector(config, first=first).completed(scans), number - first, None))
    steps, keyframe = window.steps(), window.keyframe
    return ExplainedKeyframe(
        asked=frame,
        index=scan.index,
        number=number,
        keyframe_count=len(keyframes),
        keyframe=keyframe,
        config=config,
        points=drive.ground_points(scan.index),
        window=[_window_scan(other, first + i - number, config) for i, other in enumerate(scans)],
        steps=steps,
        candidates=explain_candidates(steps, keyframe.T_world_lidar[:2, 3], config.branches),
        detections=locate(steps, keyframe, config),
    )


def _window_scan(scan: DriveScan, age: int, config: DetectorConfig) -> WindowScan:
    pose = np.ascontiguousarray(scan.T_world_lidar, np.float64)
    points = np.ascontiguousarray(scan.road_points, np.float32)
    cells, _ = grid.cells_of(points, pose, config.bev.resolution_m, config.bev.max_range_m)
    return WindowScan(scan.frame, age, pose[:2, 3], cells)


_NEAR_DEG = 0.1  # the plane of a fix has an end


@dataclass(frozen=True)
class GroundTruth:
    """What the map says about the region of interest."""

    policy: Policy
    roads: FloatArray
    """(R, 2, 2) float64: ends of the road pieces; x, y along the axes of W from the vehicle, metres."""
    nodes: FloatArray
    """(N, 2) float64: intersections in the region of interest, likewise."""
    osm_id: IntArray
    """(N,) int64."""


def ground_truth(
    explained: ExplainedKeyframe, georeference: Georeference, graph: RoadGraph, policy: Policy
) -> GroundTruth:
    """Bring the map into W by the keyframe's own fix: the errors of the poses along the drive play no part."""
    i = explained.index
    lat_deg, lon_deg = georeference.lat_deg[i], georeference.lon_deg[i]
    turn = explained.yaw_rad - yaw_of(georeference.R_enu_lidar[i])

    def place(lonlat: FloatArray) -> FloatArray:
        return rotate_2d(enu_from_lonlat(lat_deg, lon_deg, lonlat), turn)

    half_m = explained.roi.size * explained.roi.resolution_m / 2
    ends = graph.lonlat[graph.edges_of(road_ways(graph, policy))]
    ends = ends[(np.abs(wrap_longitude(ends - (lon_deg, lat_deg))) < _NEAR_DEG).all(axis=(1, 2))]
    roads = place(ends)
    crosses = (roads.min(axis=1) < half_m).all(axis=1) & (roads.max(axis=1) > -half_m).all(axis=1)
    nodes = intersection_nodes(graph, policy)
    near = (np.abs(wrap_longitude(nodes.lonlat - (lon_deg, lat_deg))) < _NEAR_DEG).all(axis=1)
    nodes_xy = place(nodes.lonlat[near])
    inside = (np.abs(nodes_xy) < half_m).all(axis=1)
    return GroundTruth(policy, roads[crosses], nodes_xy[inside], nodes.osm_id[near][inside])


# the numbers ----------------------------------------------------------------------------------------------------------


def record(explained: ExplainedKeyframe, drive_name: str, truth: GroundTruth | None) -> JsonObject:
    """Collect the numbers of a keyframe: positions in L (levelled) and W in metres, angles in degrees in W."""
    steps, keyframe = explained.steps, explained.keyframe
    x, y = explained.vehicle.tolist()
    found = [] if truth is None else zip(truth.osm_id.tolist(), truth.nodes, strict=True)
    nodes = [{"osm_id": str(osm_id), **_place(explained, around)} for osm_id, around in found]
    return {
        "drive": drive_name,
        "frame_asked": explained.asked,
        "frame": keyframe.frame,
        "time_s": keyframe.time_s,
        "keyframe": explained.number,
        "keyframes_in_drive": explained.keyframe_count,
        "pose": {"world_x_m": x, "world_y_m": y, "heading_deg": math.degrees(explained.yaw_rad)},
        "window": {"keyframes": len(explained.window), "frames": [scan.frame for scan in explained.window]},
        "roi": {"cells": steps.roi.size, "resolution_m": steps.roi.resolution_m},
        "points": {
            "road": explained.points.road_count,
            "other_ground": len(explained.points.confusable),
            "road_in_window": sum(len(scan.cells) for scan in explained.window),
        },
        "min_points": steps.min_points,
        "cells": {
            "bev": pixels(steps.bev),
            "occupancy": pixels(steps.occupancy),
            "centerline": len(steps.centerline.rows),
        },
        "candidates": [_candidate(explained, candidate) for candidate in explained.candidates],
        "detections": [_detection(explained, v, i) for v in explained.candidates for i in v.detections],
        "ground_truth": None if truth is None else {"policy": truth.policy, "nodes": nodes},
        "config": explained.config.model_dump(mode="json"),
    }


def pixels(image: BinaryImage) -> int:
    """Return the number of pixels that are set."""
    return int(image.to_array().sum())


def _candidate(explained: ExplainedKeyframe, candidate: ExplainedCandidate) -> JsonObject:
    metre = explained.roi.resolution_m
    return {
        "number": candidate.number,
        **_place(explained, explained.around(candidate.position)),
        "road_width_m": candidate.width * metre,
        "merged_points": len(candidate.merged),
        "inner_radius_m": candidate.inner * metre,
        "branches": sum(piece.is_branch for piece in candidate.pieces),
        "pieces": [
            {"reach_m": piece.reach * metre, "ends_at_candidate": piece.at_candidate, "is_branch": piece.is_branch}
            for piece in candidate.pieces
        ],
        "kept": candidate.is_kept,
        "why_not": candidate.why_not,
    }


def _detection(explained: ExplainedKeyframe, candidate: ExplainedCandidate, i: int) -> JsonObject:
    junction, found, metre = explained.steps.junctions[i], explained.detections, explained.roi.resolution_m
    return {
        "candidate": candidate.number,
        **_place(explained, found.world_xy[i] - explained.vehicle),
        "branch_count": junction.branches.count,
        "branch_angles_deg": np.degrees(found.branch_angles_rad[i]).tolist(),
        "moved_m": float(np.hypot(*(junction.position - candidate.position))) * metre,
        "residual_m": junction.residual * metre if math.isfinite(junction.residual) else None,
        "score": float(found.score[i]),
    }


def _place(explained: ExplainedKeyframe, around: FloatArray) -> dict[str, float]:
    """Return a point given from the vehicle along the axes of W, in L and in W."""
    x, y = rotate_2d(around, -explained.yaw_rad).tolist()
    world_x, world_y = (explained.vehicle + around).tolist()
    return {"x_m": x, "y_m": y, "world_x_m": world_x, "world_y_m": world_y}
