"""A street as points, and what a LiDAR in it sees, standing, driving and while it turns."""

from functools import cache
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from tests.small_drives import level_poses

TURN_S = 0.1
SENSOR_HEIGHT_M = 1.7


@cache
def street(seed: int = 0) -> FloatArray:
    """Ground, and fronts of houses that stand back by ever other depths: (N, 3) points, metres, the street along x."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(-40, 80, 1.0), np.arange(-8, 8, 1.0))
    pieces = [np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)]
    for side in (-1, 1):
        for begin in range(-40, 80, 9):
            depth = side * rng.uniform(7, 12)
            along, up = np.meshgrid(np.arange(begin, begin + 8, 0.6), np.arange(0, rng.uniform(4, 7), 0.6))
            pieces.append(np.stack([along, np.full_like(along, depth), up], axis=-1).reshape(-1, 3))
            aside, up = np.meshgrid(np.arange(0, 4, 0.6), np.arange(0, 6, 0.6))
            pieces.append(np.stack([np.full_like(up, begin), depth + side * aside, up], axis=-1).reshape(-1, 3))
    world = np.concatenate(pieces)
    return world + rng.normal(0, 0.03, world.shape)


def poses_along(steps_m: FloatArray, turn_rad: float = 0.0) -> FloatArray:
    """(N + 1, 4, 4) poses of a LiDAR that drives these steps along the street, turning by so much at each."""
    yaw = turn_rad * np.arange(len(steps_m) + 1)
    x, y = (np.append(0.0, np.cumsum(steps_m * part(yaw[:-1]))) for part in (np.cos, np.sin))
    poses = level_poses(x, y, yaw)
    poses[:, 2, 3] = SENSOR_HEIGHT_M
    return poses


def seen(world: FloatArray, T_world_lidar: FloatArray) -> Float32Array:
    """(N, 3) points within 35 m, in the LiDAR."""
    points = (world - T_world_lidar[:3, 3]) @ T_world_lidar[:3, :3]
    return points[np.linalg.norm(points, axis=1) < 35].astype(np.float32)


def seen_driving(world: FloatArray, T_world_lidar: FloatArray, speed_mps: float) -> tuple[Float32Array, Float32Array]:
    """The same by a LiDAR that turns within 0.1 s while it drives ahead, and the time of each point."""
    still = seen(world, T_world_lidar).astype(np.float64)
    points, times = still, np.zeros(len(still))
    for _ in range(5):
        times = (np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * TURN_S
        points = still - times[:, None] * [speed_mps, 0.0, 0.0]
    return points.astype(np.float32), times.astype(np.float32)


def write_scans(root: Path, scans: list[Float32Array]) -> Path:
    """Write scans as a drive of KITTI's layout that holds nothing else."""
    (root / "velodyne").mkdir(parents=True)
    for number, xyz in enumerate(scans):
        np.column_stack([xyz, np.zeros(len(xyz), np.float32)]).tofile(root / f"velodyne/{number:06d}.bin")
    return root
