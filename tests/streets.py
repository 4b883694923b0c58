"""A street that turns left and right between houses, and what a LiDAR sees of it: drives whose scans hold structure."""

import os
import shutil
from functools import cache
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, UInt32Array
from tests.small_drives import SENSOR_HEIGHT_M, geo_csv, level_poses, pose_text, write_scan

STEP_M = 1.5
COUNT = 100
_RANGE_M = 30.0
_ROAD_M, _WALK_M = 4.0, 6.0


@cache
def poses() -> FloatArray:
    """Return (100, 4, 4) poses: 40 m ahead, a quarter turn to the left, 20 m, one to the right, and on."""
    distance = STEP_M * np.arange(COUNT)
    curvature = np.where((distance > 40) & (distance < 58), 1, 0) - np.where((distance > 78) & (distance < 96), 1, 0)
    speed_up = 1.0 + 0.3 * np.sin(distance / 17.0)  # no two steps are the same
    yaw = np.concatenate([[0.0], np.cumsum(curvature * np.pi / 2 / 18 * STEP_M * speed_up)[:-1]])
    along = STEP_M * speed_up[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return level_poses(*np.cumsum([[0.0, 0.0], *along[:-1]], axis=0).T, yaw)


@cache
def _world() -> tuple[FloatArray, UInt32Array]:
    """Return (N, 3) points of the ground and of house fronts in W, and their labels."""
    rng = np.random.default_rng(3)
    path = poses()[:, :2, 3]
    low, high = path.min(axis=0) - 40, path.max(axis=0) + 40
    x, y = np.meshgrid(np.arange(low[0], high[0], 0.6), np.arange(low[1], high[1], 0.6))
    ground = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.2, 0.2, (x.size, 2))
    off = np.min(np.linalg.norm(ground[:, None] - path[None, ::2], axis=2), axis=1)
    labels = np.where(off < _ROAD_M, 40, np.where(off < _WALK_M, 48, 72))
    pieces, ids = [np.column_stack([ground, np.full(len(ground), -SENSOR_HEIGHT_M)])[off < 20]], [labels[off < 20]]
    for corner in path[rng.integers(0, COUNT, 120)] + rng.uniform(-25, 25, (120, 2)):
        size = rng.uniform(3, 9, 2)
        if np.min(np.linalg.norm(corner + size / 2 - path, axis=1)) < 7 + size.max() / 2:
            continue
        along, up = np.arange(0, 1, 0.06), np.arange(-SENSOR_HEIGHT_M, 2.0, 0.4)
        for start, end in [((0, 0), (1, 0)), ((1, 0), (1, 1)), ((1, 1), (0, 1)), ((0, 1), (0, 0))]:
            foot = corner + (np.array(start) + along[:, None] * (np.array(end) - start)) * size
            wall = np.column_stack([np.repeat(foot, len(up), axis=0), np.tile(up, len(foot))])
            pieces.append(wall)
            ids.append(np.full(len(wall), 50))
    return np.concatenate(pieces), np.concatenate(ids).astype(np.uint32)


def scan_at(pose: FloatArray, seed: int = 0) -> tuple[FloatArray, UInt32Array]:
    """Return (N, 3) points in L within 30 m with a noise of 2 cm, and their labels."""
    rng = np.random.default_rng(seed)
    points, labels = _world()
    near = np.linalg.norm(points[:, :2] - pose[:2, 3], axis=1) < _RANGE_M
    local = (points[near] - pose[:3, 3]) @ pose[:3, :3]
    return local + rng.normal(0, 0.02, local.shape), labels[near]


@cache
def _scan(row: int, seed: int) -> tuple[FloatArray, UInt32Array]:
    return scan_at(poses()[row], seed)


def write_street(path: Path, *, written: FloatArray | None = None, rows: slice = slice(None)) -> Path:
    """Write the drive, or some of its scans, with LiDAR poses (other ones where they are given) and a times.txt."""
    true = poses()[rows]
    written = true if written is None else written
    for frame, row in enumerate(range(COUNT)[rows]):
        points, labels = _scan(row, frame)
        write_scan(path, frame, np.column_stack([points, np.full(len(points), 0.3)]), labels)
    (path / "poses.txt").write_text(pose_text(written))
    (path / "times.txt").write_text("".join(f"{0.2 * frame:.6e}\n" for frame in range(len(true))))
    return path


def linked(source: Path, path: Path) -> Path:
    """Copy a drive whose poses are written anew: its scans are those of the original, and must not be changed."""
    return Path(shutil.copytree(source, path, copy_function=os.link, ignore=shutil.ignore_patterns("poses.txt")))


def change_points(path: Path, change: FloatArray | None = None, *, poses_applied: FloatArray | None = None) -> None:
    """Apply a (3, 3) matrix to the points of all scans of a drive, or the pose of each."""
    for row, file in enumerate(sorted((path / "velodyne").iterdir())):
        values = np.fromfile(file, np.float32).reshape(-1, 4)
        file.unlink()  # it may be a link
        if change is not None:
            values[:, :3] = values[:, :3] @ change.T
        if poses_applied is not None:
            values[:, :3] = values[:, :3] @ poses_applied[row, :3, :3].T + poses_applied[row, :3, 3]
        values.tofile(file)


def write_geo(path: Path, true: FloatArray) -> None:
    """Put a geo.csv of the LiDAR beside a drive."""
    (path / "geo.csv").write_text(geo_csv(true))
