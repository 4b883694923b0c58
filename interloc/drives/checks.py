"""Can labels, points and poses be those of one drive with a LiDAR? Judged from a few scans, and by sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.poses.motion import rows_apart
from interloc.geometry import invert_transform, rotation_angle, wrap_angle, yaw_of

MAX_STEP_M = 120.0
"""From scan to scan, the median: two scans further apart see no common road."""

_MAX_ROAD_RANGE_M, _MIN_ROAD_RANGE_M = 200.0, 0.2
_ABOVE_M = 0.5
"""Road higher than this over the sensor is seen by one that hangs upside down; on a hill only the far road is."""

_APART_M, _FOLLOWS = 60.0, 0.7
_PIECE_M = 6.0
_REVERSED_RAD = np.radians(90.0)
_TURNED_RAD = np.radians(40.0)
_TURNS_ALONG = 0.4

MAX_RISE_M, MAX_RISE_SLOPE = 0.6, 0.02
"""Allowed difference in height at no distance, and more for every metre between the scans. Real drives stay under 0.3 m
(scans 20 m apart); with the poses of the camera the road climbs one metre with every metre driven."""

MAX_TILT_RAD = np.radians(40.0)

NEAR_M = 25.0
"""Around the sensor, where heights are sure."""

_CELL_M = 1.0
_PAIR_STEP_M = 6.0
_FAR_M = 30.0
_PLACES = 3


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
    """Check that points are metres in the frame of a sensor that stands upright; `seen` is the road of some scans."""
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
    heights = [scan.height_m for scan in seen if np.isfinite(scan.height_m)]
    height_m = float(np.median(heights)) if heights else 0.0
    if height_m > _ABOVE_M:
        findings.refuse(
            folder,
            f"the road lies {height_m:.1f} m above the sensor: its z axis points down, and the map would be "
            "mirrored. Expected x forward, y left, z up. Usual cause: a sensor that is mounted upside down, or "
            "axes of NED or FRD. Turn points and poses by half a turn about x: y and z of the points change their "
            "signs, and each pose is multiplied by diag(1, -1, -1, 1) from the right.",
        )


def _follow_the_poses(T_world_lidar: FloatArray, seen: Sequence[RoadSeen]) -> bool:
    """Return whether the points of two scans lie as far apart as their poses, where that is far."""
    shares = []
    for one in seen:
        for other in seen[:1]:
            apart = float(np.linalg.norm(T_world_lidar[one.index, :3, 3] - T_world_lidar[other.index, :3, 3]))
            if apart > _APART_M:
                shares.append(float(np.linalg.norm(one.centre - other.centre)) / apart)
    return bool(shares) and _FOLLOWS < float(np.median(shares)) < 1 / _FOLLOWS


def check_motion(T_world_lidar: FloatArray, pose_file: str, findings: Findings) -> None:
    """Check that (N, 4, 4) poses are metres, and that the body turns with the path that it takes."""
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
    """Measure how a body turns where its path turns, by (N, 4, 4) poses in a world whose z axis is vertical.

    Returns the root of the sum of the squared turns of the path, radians, and the share of them by which the body turns
    too: 1 for a vehicle, 0 for a constant orientation, -1 for one that is mirrored.
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


def sample_indices(usable: IntArray, count: int) -> list[int]:
    """Return some of many positions, evenly spread from the first to the last."""
    if len(usable) <= count:
        return [int(index) for index in usable]
    return [int(usable[row]) for row in np.linspace(0, len(usable) - 1, count).round().astype(np.int64)]


def check_flat_road(
    drive: FolderDrive, usable: Sequence[int] | IntArray, pose_file: str, findings: Findings
) -> float | None:
    """Check that the road of neighbouring scans is one level surface: it is not if the poses are in another frame.

    Returns the median difference in height of the road of two of the usable scans (positions) in the same cells,
    metres, at the worst place; None where no two scans saw the same road.
    """
    position = drive.T_world_lidar[:, :3, 3]
    steps: list[tuple[float, float, int, int]] = []  # in height, its share of what is allowed, the two scans
    tilts: list[tuple[float, int]] = []
    for i, j in _pairs(drive.T_world_lidar, np.asarray(usable, dtype=np.int64)):
        with findings.stage():
            here, there = _near(drive.ground_points(i).road), _near(drive.ground_points(j).road)
            relative = invert_transform(drive.T_world_lidar[i]) @ drive.T_world_lidar[j]
            tilt = _tilt(here)
            if tilt is not None:
                tilts.append((tilt, i))
            step = _height_step(here, there @ relative[:3, :3].T + relative[:3, 3])
            if step is not None:
                distance = float(np.linalg.norm(position[j] - position[i]))
                steps.append((step, step / (MAX_RISE_M + MAX_RISE_SLOPE * distance), i, j))
    if steps:
        step, share, i, j = max(steps, key=lambda pair: pair[1])
        text = (
            f"scans {drive.frames[i]} and {drive.frames[j]}, {np.linalg.norm(position[j] - position[i]):.1f} m apart, "
            f"see the same road {step:.2f} m apart in height (usual: under 0.1 m). "
        )
        if np.median([pair[1] for pair in steps]) > 1:  # one bad place is a jump of the poses, most are a wrong frame
            findings.refuse(pose_file, f"the road is not flat: {text}{_pose_frame_complaint(drive)}")
        elif share > 1:
            findings.warning(pose_file, f"the poses jump: {text}Usual cause: an outage of GNSS or odometry there.")
    if tilts and min(tilts)[0] > MAX_TILT_RAD:
        tilt, i = min(tilts)
        findings.refuse(
            drive.scans.name(int(drive.frames[i])),
            f"its road is tilted by {np.degrees(tilt):.0f} degrees against the sensor. Expected points "
            "of a LiDAR with x forward, y left, z up. Usual cause: points in the frame of the camera, or labels of "
            "another scan.",
        )
    return max(step for step, *_ in steps) if steps else None


def _pose_frame_complaint(drive: FolderDrive) -> str:
    if drive.pose_frame == "oxts":
        return "Poses were taken from OXTS. Usual cause: OXTS of another drive, or angles in another convention."
    read_as = f"Poses were read as {drive.pose_frame} poses: {drive.pose_frame_reason}. Usual cause: "
    if drive.layout == "rosbag":
        return (
            f"{read_as}poses of another frame than that of the points, without the transform between the two (choose "
            "others with --poses), or inverted poses."
        )
    other = "lidar" if drive.pose_frame == "camera" else "camera"
    return (
        f"{read_as}a wrong pose frame (try {other!r}), a calib.txt of another vehicle, inverted poses, or scans of "
        "another drive."
    )


def _pairs(poses: FloatArray, usable: IntArray) -> list[tuple[int, int]]:
    """Choose pairs of scans some metres apart: at places spread over the drive, and where it turns most."""
    if len(usable) < 2:
        return []
    position = poses[usable, :3, 3]
    steps = rows_apart(position, _PAIR_STEP_M)
    if len(steps) < 2:
        return [(int(usable[0]), int(usable[-1]))]
    candidates = [
        (int(usable[a]), int(usable[b]))
        for a, b in pairwise(steps)
        if np.linalg.norm(position[b] - position[a]) < _FAR_M
    ]
    if not candidates:
        return []
    spread = [candidates[row] for row in np.linspace(0, len(candidates) - 1, _PLACES).round().astype(int)]
    turned = max(candidates, key=lambda pair: rotation_angle(poses[pair[0], :3, :3], poses[pair[1], :3, :3]))
    return sorted({*spread, turned})


def _near(road: Float32Array) -> FloatArray:
    """Return the road points around the sensor, where heights are sure."""
    return road[np.hypot(road[:, 0], road[:, 1]) < NEAR_M].astype(np.float64)


def _height_step(a: FloatArray, b: FloatArray) -> float | None:
    """Return the median difference in height of two (N, 3) sets of points in the cells that both cover, or None."""
    if not len(a) or not len(b):
        return None
    (cells_a, heights_a), (cells_b, heights_b) = _cell_heights(a), _cell_heights(b)
    _, at_a, at_b = np.intersect1d(cells_a, cells_b, assume_unique=True, return_indices=True)
    if len(at_a) < 5:
        return None
    return float(np.median(np.abs(heights_a[at_a] - heights_b[at_b])))


def _cell_heights(points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cells that hold at least three of (N, 3) points, and the mean height of each."""
    column, row = np.floor(points[:, :2] / _CELL_M).astype(np.int64).T
    cells, member, count = np.unique(column * (1 << 32) + row, return_inverse=True, return_counts=True)
    enough = count >= 3
    return cells[enough], (np.bincount(member, weights=points[:, 2]) / count)[enough]


def _tilt(points: FloatArray) -> float | None:
    """Return the angle between the plane of (N, 3) points and the x-y plane, radians; None for too few or a line."""
    if len(points) < 50:
        return None
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    if values[1] < 1.0:  # a strip under a metre wide has no sure plane
        return None
    return float(np.arccos(min(1.0, abs(vectors[2, 0]))))
