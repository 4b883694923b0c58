"""Do labels and poses of a drive fit together? Judged from a few scans."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.poses.motion import rows_apart
from interloc.geometry import invert_transform, rotate_2d, rotation_angle, yaw_of

MAX_STEP_M, MAX_STEP_SLOPE = 0.6, 0.02
"""Allowed difference in height at no distance, and more for every metre between the scans. Real drives stay under 0.3 m
(scans 20 m apart); with the poses of the camera the road climbs one metre with every metre driven."""

MAX_TILT_RAD = np.radians(40.0)

NEAR_M = 25.0
"""Around the sensor, where heights are sure."""

_CELL_M = 1.0
_PAIR_STEP_M = 6.0
_FAR_M = 30.0
_PLACES = 3

_TURNS = 5
_TURN_RAD = np.radians(12.0)
_MAX_CURVATURE, _NOISE_RAD = np.radians(15.0), np.radians(5.0)  # per metre: no vehicle turns faster; a jump does
_OVERLAP_M = 15.0
_OTHER_TURNS_DEG = np.arange(-60.0, 61.0, 4.0)
_AROUND_OPPOSITE_DEG = np.arange(-8.0, 9.0, 4.0)
_AS_POSES = len(_OTHER_TURNS_DEG) // 2
_EXPLAINED, _BETTER, _SAME_TURN_DEG = 0.7, 0.15, 10.0


def sample_indices(usable: IntArray, count: int) -> list[int]:
    """Return some of many positions, evenly spread from the first to the last."""
    if len(usable) <= count:
        return [int(index) for index in usable]
    return [int(usable[row]) for row in np.linspace(0, len(usable) - 1, count).round().astype(np.int64)]


def check_flat_road(
    drive: FolderDrive, usable: Sequence[int] | IntArray, pose_file: str, findings: Findings
) -> float | None:
    """Check that the road of neighbouring scans is one level surface: it is not if the poses are in another frame.

    Parameters
    ----------
    usable : sequence of int
        Positions of the scans that can be read.
    pose_file : str
        Name of the pose file in messages.

    Returns
    -------
    float or None
        Median difference in height of the road of two scans in the same cells, metres, at the worst place; None where
        no two scans saw the same road.
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
                steps.append((step, step / (MAX_STEP_M + MAX_STEP_SLOPE * distance), i, j))
    if steps:
        step, share, i, j = max(steps, key=lambda pair: pair[1])
        text = (
            f"scans {drive.frames[i]} and {drive.frames[j]}, {np.linalg.norm(position[j] - position[i]):.1f} m apart, "
            f"see the same road {step:.2f} m apart in height (usual: under 0.1 m). "
        )
        if np.median([pair[1] for pair in steps]) > 1:  # one bad place is a jump of the poses, most are a wrong frame
            findings.error(DriveFileError(pose_file, f"the road is not flat: {text}{_pose_frame_complaint(drive)}"))
        elif share > 1:
            findings.warning(pose_file, f"the poses jump: {text}Usual cause: an outage of GNSS or odometry there.")
    if tilts and min(tilts)[0] > MAX_TILT_RAD:
        tilt, i = min(tilts)
        findings.error(
            DriveFileError(
                drive.scans.name(int(drive.frames[i])),
                f"its road is tilted by {np.degrees(tilt):.0f} degrees against the sensor. Expected points "
                "of a LiDAR with x forward, y left, z up. Usual cause: points in the frame of the camera, or labels of "
                "another scan.",
            )
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


def check_turns(
    drive: FolderDrive, usable: Sequence[int] | IntArray, pose_file: str, findings: Findings, *, suspected: bool = False
) -> None:
    """Check that, where the poses turn most, the road in the scans turns as much: else they are of another drive.

    Parameters
    ----------
    usable : sequence of int
        Positions of the scans that can be read.
    pose_file : str
        Name of the pose file in messages.
    suspected : bool
        Something else about the poses is odd: then more places are looked at, and one is enough; else it takes two.

    Notes
    -----
    The road of one scan is laid on that of another some metres on, turned as the poses say, and by other angles. With
    the right poses no other angle fits better by more than 3 % of the road; with those of another drive most do by 20
    to 80 %.
    """
    poses = drive.T_world_lidar
    others: list[tuple[float, float, int, int]] = []  # turned by the poses, by the road; the two scans
    pairs = _moving_pairs(poses, np.asarray(usable, dtype=np.int64), everywhere=suspected)
    better = _BETTER / 2 if suspected else _BETTER
    for i, j in pairs:
        with findings.stage():
            here, there = _near(drive.ground_points(i).road), _near(drive.ground_points(j).road)
            relative = invert_transform(poses[i]) @ poses[j]
            opposite = -2.0 * float(np.degrees(yaw_of(relative[:3, :3])))  # as of poses that are mirrored
            others_deg = np.concatenate([_OTHER_TURNS_DEG, opposite + _AROUND_OPPOSITE_DEG])
            fits = _road_overlap(here, there, relative, np.radians(others_deg))
            best = int(np.argmax(fits))
            turn = float(np.degrees(yaw_of(relative[:3, :3])))
            other = float(others_deg[best])
            if fits[best] > _EXPLAINED and fits[best] - fits[_AS_POSES] > better and abs(other) > _SAME_TURN_DEG:
                others.append((turn, turn + other, i, j))
    if len(others) < (1 if suspected else 2):
        return
    turn, seen, i, j = others[0]
    mirrored = sum(abs(turn + seen) < _SAME_TURN_DEG for turn, seen, *_ in others) > len(others) / 2
    usual = (
        "poses in a frame with z down (NED, FRD), whose left is the right of the points"
        if mirrored
        else "poses of another sequence, or scans and poses that start at other frames"
    )
    findings.error(
        DriveFileError(
            pose_file,
            f"the scans do not move as the poses do: from scan {drive.frames[i]} to {drive.frames[j]} the poses turn "
            f"by {turn:.0f} degrees, the road in the scans by {seen:.0f} ({len(others)} of {len(pairs)} places looked "
            f"at are like that). Usual cause: {usual}.",
        )
    )


def _moving_pairs(poses: FloatArray, usable: IntArray, *, everywhere: bool) -> list[tuple[int, int]]:
    """Choose pairs of scans some metres apart where the poses turn most, but do not jump; some spread evenly too."""
    if len(usable) < 2:
        return []
    position = poses[usable, :3, 3]
    turned, length = (np.zeros(len(usable)) for _ in range(2))
    steps = np.einsum("nji,njk->nik", poses[usable[:-1], :3, :3], poses[usable[1:], :3, :3])
    turned[1:] = np.arccos(np.clip((np.trace(steps, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    length[1:] = np.linalg.norm(np.diff(position, axis=0), axis=1)
    jumps = turned > _MAX_CURVATURE * length + _NOISE_RAD
    rows = rows_apart(position, _PAIR_STEP_M)
    candidates = [
        (rotation_angle(poses[usable[a], :3, :3], poses[usable[b], :3, :3]), a, b)
        for a, b in pairwise(rows)
        if np.linalg.norm(position[b] - position[a]) < 2 * _PAIR_STEP_M and not jumps[a + 1 : b + 1].any()
    ]
    chosen = [pair for pair in sorted(candidates, reverse=True)[:_TURNS] if pair[0] > _TURN_RAD]
    if everywhere and candidates:
        rows_spread = np.linspace(0, len(candidates) - 1, _TURNS).round().astype(np.int64).tolist()
        chosen += [candidates[row] for row in rows_spread if candidates[row] not in chosen]
    return list(dict.fromkeys((int(usable[a]), int(usable[b])) for _, a, b in chosen))


def _road_overlap(here: FloatArray, there: FloatArray, relative: FloatArray, others_rad: FloatArray) -> FloatArray:
    """Return which share of the road near one scan lies on the road of another, turned by each of some angles more.

    Parameters
    ----------
    here, there : (N, 3), (M, 3) float64
        Road points of the two scans, metres.
    relative : (4, 4) float64
        Pose of the second scan in the first.
    others_rad : (K,) float64

    Returns
    -------
    (K,) float64
    """
    size = 2 * int(NEAR_M + 2)
    covered = np.pad(_covered(here, size), 1)
    road: BoolArray = np.logical_or.reduce(sliding_window_view(covered, (3, 3)), axis=(2, 3))  # a cell more all around
    near = there[np.hypot(there[:, 0], there[:, 1]) < _OVERLAP_M]
    if not len(near):
        return np.zeros(len(others_rad))
    cells = np.argwhere(_covered(near, size)).astype(np.float64) - size // 2 + 0.5
    yaw = yaw_of(relative[:3, :3])
    shares = np.zeros(len(others_rad))
    for number, other in enumerate(others_rad):
        seen = rotate_2d(cells, yaw + other) + rotate_2d(relative[:2, 3], other / 2)  # as if driven along an arc
        at = np.floor(seen).astype(np.int64) + size // 2
        inside = ((at >= 0) & (at < size)).all(axis=1)
        shares[number] = np.count_nonzero(road[at[inside, 0], at[inside, 1]]) / len(cells)
    return shares


def _covered(points: FloatArray, size: int) -> BoolArray:
    """Return which cells of 1 m, (size, size) around the sensor, hold some of (N, 3) points."""
    covered = np.zeros((size, size), dtype=np.bool_)
    row, column = (np.floor(points[:, :2]).astype(np.int64) + size // 2).T
    covered[row, column] = True
    return covered


def _tilt(points: FloatArray) -> float | None:
    """Return the angle between the plane of (N, 3) points and the x-y plane, radians; None for too few or a line."""
    if len(points) < 50:
        return None
    centred = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / len(points))
    if values[1] < 1.0:  # a strip under a metre wide has no sure plane
        return None
    return float(np.arccos(min(1.0, abs(vectors[2, 0]))))
