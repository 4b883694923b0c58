"""What the method saw and did at one keyframe: all that the pictures show."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np

from interloc.arrays import FloatArray, Int32Array
from interloc.config import DetectorConfig
from interloc.detection.detector import Detector, KeyframeDetections, Steps, locate
from interloc.detection.image import Roi
from interloc.detection.keyframes import Keyframe, select_keyframes
from interloc.drive import Drive, DriveScan, GroundPoints, scans_of
from interloc.errors import ConfigError, DriveError
from interloc.explain.verdicts import Verdict, judge
from interloc.geometry import yaw_of
from interloc.kernels import grid


@dataclass(frozen=True)
class WindowScan:
    """One keyframe of the window.

    Attributes
    ----------
    frame : int
        Scan number.
    age : int
        Keyframes after (+) or before (-) the one explained.
    world_xy : (2,) float64
        Position of the LiDAR in W, metres.
    cells : (N, 2) int32
        Cell along x and y of W of each road point.
    """

    frame: int
    age: int
    world_xy: FloatArray
    cells: Int32Array


@dataclass(frozen=True)
class Evidence:
    """One keyframe, explained.

    Attributes
    ----------
    asked : int
        Scan number that was asked for.
    index : int
        Position of the keyframe among the scans of the drive.
    number, keyframe_count : int
        Position of the keyframe among the keyframes of the drive, from 0 on; how many there are.
    keyframe
    config
    points
        Of the keyframe's own scan, in L.
    window
        All keyframes accumulated, in the order of the drive.
    steps
        What the detector did.
    verdicts
        What became of each candidate, the nearest to the vehicle first.
    detections
        In the order of ``steps.junctions``.
    """

    asked: int
    index: int
    number: int
    keyframe_count: int
    keyframe: Keyframe
    config: DetectorConfig
    points: GroundPoints
    window: list[WindowScan]
    steps: Steps
    verdicts: list[Verdict]
    detections: KeyframeDetections

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

    def around(self, rows: FloatArray, cols: FloatArray) -> FloatArray:
        """Return x, y along the axes of W from the vehicle, metres, (..., 2), of image positions."""
        return self.roi.world(rows, cols) - self.vehicle


def gather(drive: Drive, frame: int, config: DetectorConfig) -> Evidence:
    """Run the method on the keyframe nearest to a scan number, and keep everything.

    Parameters
    ----------
    drive
    frame : int
        Scan number, within the drive.
    config

    Raises
    ------
    ConfigError
        The drive has no such scan.
    DriveError
        The drive is empty, or a scan of the window is damaged.
    """
    if not len(drive.frames):
        raise DriveError(f"{drive.name}: the drive holds no scans")
    low, high = int(drive.frames[0]), int(drive.frames[-1])
    if not low <= frame <= high:
        raise ConfigError(f"frame {frame}: {drive.name} has the scans {low} to {high}")
    keyframes = select_keyframes(drive.T_world_lidar, config.keyframes)
    number = int(np.argmin(np.abs(drive.frames[keyframes] - frame)))
    first = max(0, number - config.keyframes.window)
    scans = list(scans_of(drive, keyframes[first : number + config.keyframes.after + 1]))
    scan = scans[number - first]

    window = next(islice(Detector(config).completed(scans), number - first, None))
    steps, keyframe = window.steps(), window.keyframe
    return Evidence(
        asked=frame,
        index=scan.index,
        number=number,
        keyframe_count=len(keyframes),
        keyframe=keyframe,
        config=config,
        points=drive.ground_points(scan.index),
        window=[_window_scan(other, first + i - number, config) for i, other in enumerate(scans)],
        steps=steps,
        verdicts=judge(steps, keyframe.T_world_lidar[:2, 3], config.branches),
        detections=locate(steps, keyframe, config.score),
    )


def _window_scan(scan: DriveScan, age: int, config: DetectorConfig) -> WindowScan:
    pose = np.ascontiguousarray(scan.T_world_lidar, np.float64)
    points = np.ascontiguousarray(scan.road_points, np.float32)
    cells, _ = grid.cells_of(points, pose, config.bev.resolution_m, config.bev.max_range_m)
    return WindowScan(scan.frame, age, pose[:2, 3], cells)
