"""Runs made by hand: keyframes on a plane around Karlsruhe, detections where the test says."""

import gzip
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d
from interloc.osm.graph import RoadGraph
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable
from tests.osm_files import road_graph

LAT, LON = 49.0, 8.4


def at(enu: Any) -> np.ndarray:
    """Degrees of (..., 2) metres east, north of the origin of the tests."""
    return lonlat_from_enu(LAT, LON, np.asarray(enu, dtype=np.float64).reshape(-1, 2))


def run(
    keyframes: Sequence[tuple[float, float]],
    detections: Sequence[tuple[int, float, float]] = (),
    intersections: Sequence[tuple[float, float]] = (),
    *,
    yaw_rad: Sequence[float] | None = None,
    world_yaw_in_enu_rad: float = 0.0,
    georeferenced: bool = True,
    config: dict[str, Any] | None = None,
) -> DriveResult:
    """Make a run of keyframes (east, north), detections (keyframe, east, north), intersections (east, north)."""
    key_enu = np.array(keyframes, dtype=np.float64).reshape(-1, 2)
    det = np.array(detections, dtype=np.float64).reshape(-1, 3)
    its_enu = np.array(intersections, dtype=np.float64).reshape(-1, 2)
    enu_yaw = np.zeros(len(key_enu)) if yaw_rad is None else np.array(yaw_rad, dtype=np.float64)
    row = det[:, 0].astype(np.int64)
    world = rotate_2d(key_enu - key_enu[:1], -world_yaw_in_enu_rad)
    count = len(its_enu)
    return DriveResult(
        drive="made-up",
        keyframes=KeyframeTable(
            frame=10 * np.arange(len(key_enu)),
            time_s=np.arange(len(key_enu), dtype=np.float64),
            world_xy=world,
            world_yaw_rad=enu_yaw - world_yaw_in_enu_rad,
            lonlat=at(key_enu) if georeferenced else None,
            enu_yaw_rad=enu_yaw if georeferenced else None,
        ),
        detections=DetectionTable(
            keyframe=row,
            lidar_xy=rotate_2d(det[:, 1:] - key_enu[row], -enu_yaw[row]),
            world_xy=rotate_2d(det[:, 1:] - key_enu[:1], -world_yaw_in_enu_rad),
            lonlat=at(det[:, 1:]) if georeferenced else None,
            bearings_deg=[np.array([0.0, 90.0, 180.0])] * len(det),
            score=np.ones(len(det)),
            intersection=np.full(len(det), -1, dtype=np.int64),
            widths_m=[np.full(3, np.nan)] * len(det),
            position_std_m=np.ones(len(det)),
        ),
        intersections=IntersectionTable(
            id=np.arange(1, count + 1),
            world_xy=rotate_2d(its_enu - key_enu[:1], -world_yaw_in_enu_rad),
            lonlat=at(its_enu) if georeferenced else None,
            position_std_m=np.full(count, 0.5),
            observations=np.full(count, 4, dtype=np.int64),
            confidence=np.ones(count),
            bearings_deg=[np.array([0.0, 90.0, 180.0])] * count,
            first_frame=np.zeros(count, dtype=np.int64),
            last_frame=np.zeros(count, dtype=np.int64),
            widths_m=[np.full(3, np.nan)] * count,
        ),
        trajectory_world_xy=world,
        trajectory_lonlat=at(key_enu) if georeferenced else None,
        run={"config": config or {}, "versions": {"interloc": "0.1.0"}, "timings_s": {"detect": 1.5}},
    )


def graph(crossings: Sequence[tuple[float, float]], *, arm_m: float = 50.0, **changes: Any) -> RoadGraph:
    """Make a map with one node of four residential arms at each (east, north)."""
    centres = np.array(crossings, dtype=np.float64).reshape(-1, 2)
    arms = arm_m * np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    enu = (centres[:, None, :] + arms).reshape(-1, 2)
    ways = [("residential", (5 * row, 5 * row + arm)) for row in range(len(centres)) for arm in (1, 2, 3, 4)]
    return replace(road_graph(at(enu), ways, 100, "made-up.osm"), **{"date": "2024-01-01T00:00:00Z", **changes})


def oxts_run(oxts: Path, node_lonlat: np.ndarray, *, noise_m: float) -> DriveResult:
    """Drive the real track of a KITTI sequence past nodes, seeing each of them within reach with some noise."""
    with gzip.open(oxts, "rt") as file:
        rows = np.loadtxt(file)
    enu = enu_from_lonlat(LAT, LON, rows[:, [1, 0]])
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(enu, axis=0).T))])
    keep = np.unique(np.searchsorted(travelled, np.arange(0.0, travelled[-1], 2.0)))
    key_enu, yaw = enu[keep], rows[keep, 5]
    rng = np.random.default_rng(0)
    node_enu = enu_from_lonlat(LAT, LON, node_lonlat)
    keyframe, node = np.nonzero(np.hypot(*(node_enu[None] - key_enu[:, None]).transpose(2, 0, 1)) < 35.0)
    seen = node_enu[node] + rng.normal(0.0, noise_m, (len(node), 2))
    fused = np.unique(node)
    return run(
        key_enu,
        np.column_stack([keyframe, seen]),
        node_enu[fused] + rng.normal(0.0, noise_m / 3.0, (len(fused), 2)),
        yaw_rad=yaw,
        world_yaw_in_enu_rad=float(yaw[0]),
        config={"bev": {"size_m": 120.0}, "branches": {"outer_radius_m": 40.0}},
    )
