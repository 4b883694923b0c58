"""Motion within a scan: a turn takes a tenth of a second, in which a car moves by a metre or more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, FloatArray

_TURN_RAD = np.radians(300)
"""A scan whose points turn by less while it is taken is not one of a spinning LiDAR."""

_STRAIGHT_RAD = np.radians(8)
"""So far the azimuth of a point may lie from that of its time: lasers are mounted at angles of their own."""

_NEAREST_M, _NEAR_M = 1.0, 20.0
_ENOUGH = 500  # points
_TELLING_RAD = np.radians(0.25)


@dataclass(frozen=True)
class Velocity:
    """How the LiDAR moves, constant for a while, in its own axes."""

    linear_mps: FloatArray
    """(3,) float64: metres per unit of time (seconds, or scans where no times are known)."""
    angular_radps: FloatArray
    """(3,) float64: rotation vector per unit of time."""

    @classmethod
    def between(cls, T_before_after: FloatArray, passed: float) -> Velocity:
        """Return the velocity that leads to a pose within some time."""
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import

        turned = Rotation.from_matrix(T_before_after[:3, :3]).as_rotvec()
        return cls(T_before_after[:3, 3] / passed, turned / passed)

    def after(self, passed: float) -> FloatArray:
        """Return the (4, 4) pose to which it leads within some time."""
        from scipy.spatial.transform import Rotation  # noqa: PLC0415

        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(self.angular_radps * passed).as_matrix()
        pose[:3, 3] = self.linear_mps * passed
        return pose

    def undo(self, xyz: Float32Array, times_s: Float32Array) -> Float32Array:
        """Move points to where they would have been seen at the time of the scan.

        Parameters
        ----------
        xyz : (N, 3) float32
            In the LiDAR at the time of each point, metres.
        times_s : (N,) float32
            When each was measured, seconds after the time of the scan (before it: negative).

        Returns
        -------
        (N, 3) float32
            In the LiDAR at the time of the scan.
        """
        speed = float(np.linalg.norm(self.angular_radps))
        moved: Float32Array = xyz + times_s[:, None] * self.linear_mps.astype(np.float32)
        if speed > 1e-6:  # Rodrigues' formula
            axis = (self.angular_radps / speed).astype(np.float32)
            angle = (times_s * np.float32(speed))[:, None]
            across = np.cross(axis, xyz)
            moved += np.sin(angle) * across + (1 - np.cos(angle)) * np.cross(axis, across)
        return moved


def is_bent(xyz: Float32Array, times_s: Float32Array, velocity: Velocity) -> bool | None:
    """Tell whether the motion within a scan is still in its points, or was taken out before.

    Parameters
    ----------
    xyz, times_s
        As of `Velocity.undo`.
    velocity : Velocity
        While the scan was taken.

    Returns
    -------
    bool or None
        None where the points do not tell: not of a spinning LiDAR, or it hardly moved.

    Notes
    -----
    A spinning LiDAR measures at an azimuth that grows evenly with time. Where the motion was taken out, near points
    deviate from that by as much as they were moved, and this is the slope of a line through deviation against motion:
    0 where they are as measured, 1 where they were moved.
    """
    near = np.flatnonzero(
        (np.abs(np.hypot(xyz[:, 0], xyz[:, 1]) - _NEAR_M / 2) < _NEAR_M / 2 - 1) & np.isfinite(times_s)
    )
    rows = near[np.argsort(times_s[near], kind="stable")]
    if len(rows) < _ENOUGH:
        return None
    points, at = xyz[rows].astype(np.float32), times_s[rows].astype(np.float32)
    azimuth = np.unwrap(_azimuths(points))
    steady = np.polynomial.Polynomial.fit(at, azimuth, 1)
    is_spinning = abs(steady(float(at[-1])) - steady(float(at[0]))) > _TURN_RAD
    if not is_spinning or np.median(np.abs(azimuth - steady(at))) > _STRAIGHT_RAD:
        return None
    shift = _wrapped(_azimuths(velocity.undo(points, at)) - _azimuths(points))
    even = np.stack([np.ones_like(at), at], axis=1).astype(np.float64)
    shift, deviation = (each - even @ np.linalg.lstsq(even, each)[0] for each in (shift, azimuth))
    if float(np.std(shift)) < _TELLING_RAD:
        return None
    return float(shift @ deviation) / float(shift @ shift) < 0.5


def _azimuths(xyz: Float32Array) -> FloatArray:
    return np.arctan2(xyz[:, 1], xyz[:, 0]).astype(np.float64)


def _wrapped(angles: FloatArray) -> FloatArray:
    wrapped: FloatArray = (angles + np.pi) % (2 * np.pi) - np.pi
    return wrapped
