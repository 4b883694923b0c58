"""Can labels and poses be those of one drive with a LiDAR? Judged from a few scans, and by sizes."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.poses.frame import IMU_CALIBRATION
from interloc.geometry import invert_transform, rotation_angle, rows_apart, wrap_angle, yaw_of

MAX_STEP_M = 120.0
"""From scan to scan, the median: two scans further apart see no common road."""

_PIECE_M = 6.0
_REVERSED_RAD = np.radians(90.0)
_TURNED_RAD = np.radians(40.0)
_TURNS_ALONG = 0.4

MAX_RISE_M, MAX_RISE_SLOPE = 0.6, 0.02
"""Allowed difference in height at no distance, and more for every metre between the scans. Real drives stay under 0.3 m
(scans 20 m apart); with the poses of the camera the road climbs one metre with every metre driven."""

MAX_TILT_RAD = np.radians(40.0)

_NEAR_M = 25.0
"""Around the sensor, where heights are sure."""

_CELL_M = 1.0
_PAIR_STEP_M = 6.0
_FAR_M = 30.0
_PLACES = 3


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
    rows = np.linspace(0, len(usable) - 1, min(count, len(usable))).round().astype(np.int64)
    chosen: list[int] = usable[rows].tolist()
    return chosen


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
        return (
            "Poses were taken from OXTS. Usual cause: OXTS of another drive, angles in another convention, or a sensor "
            f"that is turned or tilted against them ({IMU_CALIBRATION} tells how)."
        )
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
    return road[np.hypot(road[:, 0], road[:, 1]) < _NEAR_M].astype(np.float64)


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
    west, south, width = column.min(), row.min(), int(np.ptp(row)) + 1
    member = (column - west) * width + row - south  # few cells: the points lie around one sensor
    count = np.bincount(member)
    cells = np.flatnonzero(count >= 3)
    heights = np.bincount(member, weights=points[:, 2])[cells] / count[cells]
    return (cells // width + west) * (1 << 32) + cells % width + south, heights


def _tilt(points: FloatArray) -> float | None:
    """Return the angle between the plane of (N, 3) points and the x-y plane, radians; None for too few or a line."""
    if len(points) < 50:
        return None
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    if values[1] < 1.0:  # a strip under a metre wide has no sure plane
        return None
    return float(np.arccos(min(1.0, abs(vectors[2, 0]))))
