"""A scan as the detector takes it."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.errors import DriveError

_FARTHEST_M = 1e7  # from the origin of W: coordinates on Earth are smaller
_OFF_ROTATION = 1e-3  # as for poses in files
_RIGID = np.diag([1.0, 1.0, 1.0, 0.0])  # of the first three columns of a pose, with one another


class ScanLike(Protocol):
    """What `Detector.push` needs of a scan; the points may be read as late as they are asked for."""

    @property
    def frame(self) -> int: ...
    @property
    def T_world_lidar(self) -> FloatArray: ...
    @property
    def time_s(self) -> float | None: ...
    @property
    def road_points(self) -> Float32Array: ...
    @property
    def other_points(self) -> Float32Array | None: ...


@dataclass(frozen=True)
class Scan:
    """One scan in memory, for online use.

    Attributes
    ----------
    frame : int
        Scan number.
    T_world_lidar : (4, 4) float64
        Pose of the LiDAR in W.
    road_points : (N, 3) float32
        Points of the road in L, metres (paper, eq. 1).
    time_s : float or None
        Time of the scan, seconds.
    other_points : (M, 3) float32 or None
        Points of sidewalk, parking and other ground in L, metres, where known: they tell road from what is confused
        with it (`BevConfig.vote`).
    """

    frame: int
    T_world_lidar: FloatArray
    road_points: Float32Array
    time_s: float | None = None
    other_points: Float32Array | None = None


def checked_pose(scan: ScanLike) -> FloatArray:
    """Return the pose of a scan, (4, 4) float64.

    Raises
    ------
    DriveError
        It is no rigid transform of finite numbers. Taken in, it would lay the cells of the scan across the world.
    """
    pose = np.array(scan.T_world_lidar, np.float64)
    if pose.shape != (4, 4):
        raise DriveError(f"scan {scan.frame}: T_world_lidar has the shape {pose.shape}; expected (4, 4).")
    if not np.isfinite(pose).all():
        raise DriveError(
            f"scan {scan.frame}: T_world_lidar holds a number that is not finite. "
            "Usual cause: odometry that has lost its way. Leave the scan out."
        )
    if np.abs(pose[:3, 3]).max() > _FARTHEST_M:
        raise DriveError(
            f"scan {scan.frame}: T_world_lidar is more than {_FARTHEST_M / 1000.0:,.0f} km from the origin. "
            "Expected metres."
        )
    axes = pose[:, :3]
    if np.abs(axes @ axes.T - _RIGID).max() > _OFF_ROTATION or np.linalg.det(axes[:3]) < 0.0:
        raise DriveError(
            f"scan {scan.frame}: T_world_lidar is not a rotation and a shift over a row 0 0 0 1. "
            "Usual cause: a scale, a mirrored axis, a matrix written column by column, or one that was never filled."
        )
    return pose


def checked_points(points: Float32Array, scan: ScanLike) -> Float32Array:
    """Return points of a scan; those that are not finite are left out later.

    Raises
    ------
    DriveError
        They are no (N, 3) array.
    """
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] < 3:
        raise DriveError(f"scan {scan.frame}: its points have the shape {points.shape}; expected (N, 3).")
    return points
