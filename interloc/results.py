"""What a run over a drive yields: keyframes, detections, fused intersections, as columns.

Bearings are degrees clockwise from north where the run is georeferenced, else clockwise from the +y axis of W.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class KeyframeTable:
    """The K keyframes of a run, in the order of the drive.

    Attributes
    ----------
    frame : (K,) int64
        Scan numbers, ascending.
    time_s : (K,) float64
        NaN where the drive has no times.
    world_xy : (K, 2) float64
        Position of the LiDAR in W, metres.
    world_yaw_rad : (K,) float64
        Heading of the LiDAR in W, counter-clockwise from +x.
    lonlat : (K, 2) float64 or None
        Longitude, latitude of the LiDAR, degrees; None without georeference.
    enu_yaw_rad : (K,) float64 or None
        Heading of the LiDAR, counter-clockwise from east; None without georeference.
    """

    frame: IntArray
    time_s: FloatArray
    world_xy: FloatArray
    world_yaw_rad: FloatArray
    lonlat: FloatArray | None = None
    enu_yaw_rad: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True)
class DetectionTable:
    """The D detections of a run, in the order of their keyframes.

    Attributes
    ----------
    keyframe : (D,) int64
        Row of the keyframe table.
    lidar_xy : (D, 2) float64
        Position in L of its keyframe (levelled), metres (paper, eq. 12).
    world_xy : (D, 2) float64
        Position in W, metres.
    lonlat : (D, 2) float64 or None
        Longitude, latitude, degrees, from the fix of its own keyframe (paper, eq. 13).
    bearings_deg : list of (B,) float64
        Bearing of each branch, leaving the intersection.
    score : (D,) float64
        0..1, how sure the detector is.
    intersection : (D,) int64
        Row of the fused intersection that the detection belongs to, -1 for none.
    """

    keyframe: IntArray
    lidar_xy: FloatArray
    world_xy: FloatArray
    lonlat: FloatArray | None
    bearings_deg: list[FloatArray]
    score: FloatArray
    intersection: IntArray

    def __len__(self) -> int:
        return len(self.keyframe)

    @property
    def number(self) -> IntArray:
        """(D,) int64 number of each detection at its keyframe, from 1."""
        return np.arange(len(self)) - np.searchsorted(self.keyframe, self.keyframe) + 1


@dataclass(frozen=True)
class IntersectionTable:
    """The M physical intersections that the detections were fused into.

    Attributes
    ----------
    id : (M,) int64
        1..M, in the order of first sight.
    world_xy : (M, 2) float64
        Position in W, metres; with georeference the W of the first observation (drift makes W ambiguous).
    lonlat : (M, 2) float64 or None
        Longitude, latitude, degrees.
    position_std_m : (M,) float64
        One-sigma uncertainty of the position (root of the mean variance of x and y of the estimate).
    observations : (M,) int64
        Number of detections fused.
    confidence : (M,) float64
        0..1, from how often it was seen when it could have been.
    bearings_deg : list of (B,) float64
    first_frame, last_frame : (M,) int64
        Scan numbers of the first and the last keyframe that saw it.
    """

    id: IntArray
    world_xy: FloatArray
    lonlat: FloatArray | None
    position_std_m: FloatArray
    observations: IntArray
    confidence: FloatArray
    bearings_deg: list[FloatArray]
    first_frame: IntArray
    last_frame: IntArray

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True)
class DriveResult:
    """Everything that `detect` found on a drive.

    Attributes
    ----------
    drive : str
        Name of the drive.
    trajectory_lonlat : (N, 2) float64 or None
        Longitude, latitude of the LiDAR at every scan, degrees.
    trajectory_world_xy : (N, 2) float64
        The same in W, metres.
    run : dict
        What `run.json` holds: configuration, versions, input identity, timings, peak memory.
    """

    drive: str
    keyframes: KeyframeTable
    detections: DetectionTable
    intersections: IntersectionTable
    trajectory_world_xy: FloatArray
    trajectory_lonlat: FloatArray | None
    run: dict[str, Any] = field(default_factory=dict)

    @property
    def is_georeferenced(self) -> bool:
        """True where positions have longitude and latitude."""
        return self.keyframes.lonlat is not None
