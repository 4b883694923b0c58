"""The track of a drive in the plane: levelled, and resampled by distance driven."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import rotate_2d, yaw_of

_CHORD_M = 4.0  # of driving, by whose ends the direction of motion is known


@dataclass(frozen=True)
class Track:
    """Where a drive went, in its own horizontal plane V: origin at the first scan, x axis ahead of it."""

    xy: FloatArray
    """(N, 2) float64: position of the LiDAR at every scan, metres."""
    z_m: FloatArray
    """(N,) float64: its height over the first scan."""
    R_level_lidar: FloatArray
    """(N, 3, 3) float64: its attitude in V."""
    at_m: FloatArray
    """(N,) float64: distance driven up to every scan."""

    @property
    def length_m(self) -> float:
        """Distance driven."""
        return float(self.at_m[-1])

    @property
    def yaw_rad(self) -> FloatArray:
        """(N,) float64 heading of the LiDAR, counter-clockwise from the x axis of V."""
        return yaw_of(self.R_level_lidar)

    def mirrored(self) -> Track:
        """Return the same track seen in a mirror: every left turn a right turn."""
        flip = np.diag([1.0, -1.0, 1.0])
        return Track(self.xy * [1.0, -1.0], self.z_m, flip @ self.R_level_lidar @ flip, self.at_m)


def track_of(T_world_lidar: FloatArray) -> Track:
    """Return the track of (N, 4, 4) poses; "up" is the mean of the upward axes of the LiDAR."""
    up = T_world_lidar[:, :3, 2].mean(axis=0)
    up /= np.linalg.norm(up)
    ahead = T_world_lidar[0, :3, 0] - up * (up @ T_world_lidar[0, :3, 0])
    ahead /= np.linalg.norm(ahead)
    R_level_world = np.stack([ahead, np.cross(up, ahead), up])
    position = (T_world_lidar[:, :3, 3] - T_world_lidar[0, :3, 3]) @ R_level_world.T
    steps = np.linalg.norm(np.diff(position[:, :2], axis=0), axis=1)
    at_m = np.concatenate([[0.0], np.cumsum(steps)])
    return Track(position[:, :2], position[:, 2], R_level_world @ T_world_lidar[:, :3, :3], at_m)


@dataclass(frozen=True)
class TrackPoints:
    """A track resampled by distance driven."""

    at_m: FloatArray
    """(P,) float64: distance driven, equally spaced."""
    xy: FloatArray
    """(P, 2) float64: positions in V, metres."""
    heading_rad: FloatArray
    """(P,) float64: direction of motion in V; continuous, not wrapped."""

    def __len__(self) -> int:
        return len(self.at_m)

    @property
    def columns(self) -> FloatArray:
        """(P, 3) float64 x, y, heading."""
        return np.column_stack([self.xy, self.heading_rad])

    def relative_to(self, row: int) -> FloatArray:
        """Return (P, 3) x, y, heading seen from the point of a row: that one lies at 0, 0, 0."""
        turn = float(self.heading_rad[row])
        return np.column_stack([rotate_2d(self.xy - self.xy[row], -turn), self.heading_rad - turn])


def resample(track: Track, step_m: float) -> TrackPoints:
    """Return points of a track every `step_m`, with the direction of motion over `_CHORD_M` around each.

    A scan that is no farther than the one before (the vehicle stands) adds nothing.
    """
    moved = np.concatenate([[True], np.diff(track.at_m) > 1e-6])
    at, xy = track.at_m[moved], track.xy[moved]
    along = np.arange(0.0, at[-1] + 1e-9, step_m)

    def place(distance: FloatArray) -> FloatArray:
        return np.column_stack([np.interp(distance, at, xy[:, 0]), np.interp(distance, at, xy[:, 1])])

    before, after = np.clip(along - _CHORD_M / 2, 0.0, at[-1]), np.clip(along + _CHORD_M / 2, 0.0, at[-1])
    chord = place(after) - place(before)
    heading = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
    return TrackPoints(along, place(along), heading)
