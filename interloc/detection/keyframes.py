"""Keyframe selection (paper, section III-B.2)."""

import math
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.config import KeyframeConfig
from interloc.geometry import rotation_angle


@dataclass(frozen=True)
class Keyframe:
    """A scan that was chosen, without its points."""

    frame: int
    """Scan number."""
    T_world_lidar: FloatArray
    """(4, 4) float64."""
    time_s: float | None
    is_doubtful: bool = False
    """Its labels may be wrong."""


class KeyframeSelector:
    """Takes a scan when its pose has changed enough since the last one taken; the first always.

    Fed with keyframes only, it takes them all: a drive can therefore leave out the scans in between.
    """

    def __init__(self, config: KeyframeConfig) -> None:
        self._distance_m = config.distance_m
        self._angle_rad = math.radians(config.angle_deg)
        self._last: FloatArray | None = None

    def is_keyframe(self, T_world_lidar: FloatArray) -> bool:
        """Tell whether the scan at this pose is a keyframe, and remember it if so."""
        if self._last is not None:
            is_near = math.dist(T_world_lidar[:3, 3], self._last[:3, 3]) <= self._distance_m
            if is_near and rotation_angle(self._last[:3, :3], T_world_lidar[:3, :3]) <= self._angle_rad:
                return False
        self._last = T_world_lidar
        return True


def select_keyframes(T_world_lidar: FloatArray, config: KeyframeConfig) -> IntArray:
    """Return the positions of the keyframes among (N, 4, 4) poses."""
    selector = KeyframeSelector(config)
    return np.array([i for i, pose in enumerate(T_world_lidar) if selector.is_keyframe(pose)], np.int64)
