"""Can points and poses be those of a LiDAR on a road vehicle? Judged by sizes alone: units, frames, which way is up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.drives.findings import Findings
from interloc.drives.poses.motion import rows_apart
from interloc.geometry import wrap_angle, yaw_of

MAX_STEP_M = 120.0
"""From scan to scan, the median: two scans further apart see no common road."""

_MAX_ROAD_RANGE_M, _MIN_ROAD_RANGE_M = 200.0, 0.2
_ABOVE_M = 0.5
"""Road higher than this over the sensor is seen by one that hangs upside down; on a hill only the far road is."""

_FAR_M, _FOLLOWS = 60.0, 0.7
_PIECE_M = 6.0
_REVERSED_RAD = np.radians(90.0)
_TURNED_RAD = np.radians(40.0)
_TURNS_ALONG = 0.4


@dataclass(frozen=True)
class RoadSeen:
    """Where the road points of one scan lie, as they were read."""

    index: int
    """Position of the scan."""
    centre: FloatArray
    """(3,) float64: median of the points, in their own frame."""
    range_m: float
    """Median horizontal distance from the origin."""
    height_m: float
    """Median height of the points around the origin over it; NaN where there are none."""

    @classmethod
    def of(cls, index: int, road: Float32Array, near_m: float) -> RoadSeen:
        """Measure (N, 3) road points, at least one."""
        distance = np.hypot(road[:, 0], road[:, 1])
        near = road[distance < near_m, 2]
        height_m = float(np.median(near)) if len(near) else float("nan")
        return cls(index, np.median(road, axis=0).astype(np.float64), float(np.median(distance)), height_m)


def check_points(T_world_lidar: FloatArray, seen: Sequence[RoadSeen], folder: str, findings: Findings) -> None:
    """Check that points are metres in the frame of a sensor that stands upright.

    Parameters
    ----------
    T_world_lidar : (N, 4, 4) float64
    seen : sequence of RoadSeen
        Of some scans.
    folder : str
        Of the scans, in messages.
    """
    if not seen:
        return
    if _follow_the_poses(T_world_lidar, seen):
        findings.refuse(
            folder,
            "the points move along with the poses: they are in the frame of the world already. Expected points as "
            "the sensor saw them, x y z from the sensor. Usual cause: registered clouds of an odometry or SLAM "
            "(cloud_registered, poses applied); write them in the frame of the sensor, or apply the inverse of "
            "each pose.",
        )
        return
    range_m = float(np.median([scan.range_m for scan in seen]))
    if not _MIN_ROAD_RANGE_M < range_m < _MAX_ROAD_RANGE_M:
        findings.refuse(
            folder,
            f"half of the road points are {'over' if range_m > 1 else 'under'} {range_m:,.3g} m from the sensor "
            "(usual: 8 to 25 m). Expected x y z in metres. Usual cause: points in millimetres or centimetres, or "
            "divided by their range.",
        )
        return
    height_m = float(np.nanmedian([scan.height_m for scan in seen])) if _any_height(seen) else 0.0
    if height_m > _ABOVE_M:
        findings.refuse(
            folder,
            f"the road lies {height_m:.1f} m above the sensor: its z axis points down, and the map would be "
            "mirrored. Expected x forward, y left, z up. Usual cause: a sensor that is mounted upside down, or "
            "axes of NED or FRD. Turn points and poses by half a turn about x: y and z of the points change their "
            "signs, and each pose is multiplied by diag(1, -1, -1, 1) from the right.",
        )


def _any_height(seen: Sequence[RoadSeen]) -> bool:
    return any(np.isfinite(scan.height_m) for scan in seen)


def _follow_the_poses(T_world_lidar: FloatArray, seen: Sequence[RoadSeen]) -> bool:
    """Return whether the points of two scans lie as far apart as their poses, where that is far."""
    shares = []
    for one in seen:
        for other in seen[:1]:
            apart = float(np.linalg.norm(T_world_lidar[one.index, :3, 3] - T_world_lidar[other.index, :3, 3]))
            if apart > _FAR_M:
                shares.append(float(np.linalg.norm(one.centre - other.centre)) / apart)
    return bool(shares) and _FOLLOWS < float(np.median(shares)) < 1 / _FOLLOWS


def check_motion(T_world_lidar: FloatArray, pose_file: str, findings: Findings) -> None:
    """Check that poses are metres, and that the body turns with the path that it takes.

    Parameters
    ----------
    T_world_lidar : (N, 4, 4) float64
    pose_file : str
        Name of the pose file in messages.
    """
    steps = np.linalg.norm(np.diff(T_world_lidar[:, :3, 3], axis=0), axis=1)
    if len(steps) and (step_m := float(np.median(steps))) > MAX_STEP_M:
        findings.refuse(
            pose_file,
            f"from scan to scan it moves by {step_m:,.0f} m (usual: under 20 m). Expected positions in metres. "
            "Usual cause: poses in millimetres or centimetres, or degrees of latitude and longitude.",
        )
        return
    turned, share = turning_with_path(T_world_lidar)
    if turned > _TURNED_RAD and share < _TURNS_ALONG:
        what = "the other way" if share < -_TURNS_ALONG else f"by {share:.0%} of that"
        findings.refuse(
            pose_file,
            f"the path turns by {np.degrees(turned):.0f} degrees in all, the orientation {what}: these are "
            "positions, not poses. Expected the orientation of the sensor in every pose. Usual cause: an "
            "orientation that nobody fills in (0 0 0 1, as of navsat_transform's /odometry/gps), quaternions in "
            "the order w x y z, or angles of another convention.",
        )


def turning_with_path(T_world_body: FloatArray) -> tuple[float, float]:
    """Measure how a body turns where its path turns.

    Parameters
    ----------
    T_world_body : (N, 4, 4) float64
        The vertical of the world is its z axis.

    Returns
    -------
    turned : float
        Root of the sum of the squared turns of the path, radians.
    share : float
        Share of them by which the body turns too: 1 for a vehicle, 0 for a constant orientation, -1 for one that is
        mirrored.
    """
    rows = rows_apart(T_world_body[:, :2, 3] @ np.eye(2, 3), _PIECE_M)
    if len(rows) < 3:
        return 0.0, 1.0
    step = np.diff(T_world_body[rows, :2, 3], axis=0)
    path = wrap_angle(np.diff(np.arctan2(step[:, 1], step[:, 0])))
    yaw = np.unwrap(yaw_of(T_world_body[rows, :3, :3]))
    body = wrap_angle((yaw[2:] - yaw[:-2]) / 2)
    forward = np.abs(path) < _REVERSED_RAD
    turned = float(np.sqrt((path[forward] ** 2).sum()))
    share = float((path[forward] * body[forward]).sum()) / max(turned**2, 1e-12)
    return turned, share
