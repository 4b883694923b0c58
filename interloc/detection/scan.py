"""A scan as the detector takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from interloc.arrays import Float32Array, FloatArray


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
