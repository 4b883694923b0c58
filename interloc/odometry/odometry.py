"""The odometry: scan by scan, by the motion so far and the map of the last scans."""

from __future__ import annotations

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.errors import DriveError
from interloc.geometry import invert_transform
from interloc.odometry.deskew import Velocity
from interloc.odometry.registration import (
    MIN_INFORMATION,
    MIN_INLIER_SHARE,
    Cloud,
    LocalMap,
    Registration,
    register_clouds,
    search,
    usable_rows,
)

MAX_STEP_M = 10.0
"""From scan to scan; real scans farther apart share too little."""

_SEARCHED_M = 5.0
_SURE_SHARE = 0.8  # of inliers on the map: what fits less is held against the scan before alone
_HELD_SHARE, _HELD_INFORMATION = 0.4, 1.0  # of a scan that lies on the one before it as expected
_FIRM_INFORMATION = 4.0  # of a scan that nothing holds on the map: rings on the road, which move along, reach 3.6
_MAX_BRIDGED_M = 25.0  # a car that brakes or speeds up as usual is then off by some metres
_MAX_CHANGE_M, _MAX_CHANGE, _MAX_CHANGE_RAD = 0.3, 0.25, np.radians(10)  # of the motion from scan to scan: m + share


class Odometry:
    """Poses of a LiDAR from its scans, one after the other.

    Parameters
    ----------
    deskew : bool
        Take the motion out of scans whose points carry times.

    Attributes
    ----------
    is_bridged : bool
        Nothing told the motion of the last scan along some direction, and the velocity was kept.

    Notes
    -----
    1. The motion from the first scan to the second is searched for: the LiDAR may stand or drive at any speed.
    2. A scan is expected where constant velocity leads; its points are moved to where they were at its time.
    3. It is laid onto the map of the scans before it, and added to that map.
    4. Along a direction in which nothing holds it, the velocity is kept, for some metres at most.
    5. Where it fits less well, or the motion jumps, it is held against the scan before alone, and its motion searched
       for anew where that does not agree; where that fails too, the odometry ends: no pose is made up.
    """

    def __init__(self, *, deskew: bool = True) -> None:
        self._deskew = deskew
        self._map = LocalMap()
        self._first: tuple[Float32Array, Float32Array | None] | None = None
        self._first_middle = 0.0
        self._before: Cloud | None = None
        self._velocity: Velocity | None = None
        self._pose, self._clock = np.eye(4), 0.0
        self._T_world_map = np.eye(4)
        self._unheld_m = 0.0
        self.is_bridged = False

    def add(self, xyz: Float32Array, clock: float, times_s: Float32Array | None = None) -> FloatArray:
        """Take the next scan.

        Parameters
        ----------
        xyz : (N, 3) float32
            Points in L, metres; those without a return (not finite, or zero) do not matter.
        clock : float
            Time of the scan: seconds, or its number where no times are known. It grows from scan to scan.
        times_s : (N,) float32 or None
            When each point was measured, in units of the clock after it.

        Returns
        -------
        (4, 4) float64
            T_world_lidar; W is the LiDAR at the first scan.
        """
        rows, middle = usable_rows(xyz), 0.0
        xyz, times_s = xyz[rows], None if times_s is None or not self._deskew or not len(rows) else times_s[rows]
        if times_s is not None:  # poses are those at the middle of a turn: there an error in velocity matters least
            middle = float(times_s.min() + times_s.max()) / 2
            times_s = times_s - np.float32(middle)
        if self._first is None:
            self._first, self._clock, self._first_middle = (xyz, times_s), clock + middle, middle
            return np.eye(4)
        passed, self._clock = clock + middle - self._clock, clock + middle
        if self._velocity is None:
            self._velocity = self._start(xyz, passed)
            self._T_world_map = self._velocity.after(self._first_middle)
        cloud = self._cloud(xyz, times_s)
        pose = self._follow(cloud, self._velocity.after(passed))
        self._map.add(cloud, pose)
        self._velocity = Velocity.between(invert_transform(self._pose) @ pose, passed)
        self._before, self._pose = cloud, pose
        return self._T_world_map @ pose @ self._velocity.after(-middle)

    def _start(self, xyz: Float32Array, passed: float) -> Velocity:
        """Search for the motion from the first scan to the second, and begin the map with the first."""
        assert self._first is not None
        start = _searched(Cloud.of(xyz), Cloud.of(self._first[0]), np.eye(4))
        self._velocity = Velocity.between(start, passed)
        self._before = self._cloud(*self._first)
        self._map.add(self._before, self._pose)
        return self._velocity

    def _cloud(self, xyz: Float32Array, times_s: Float32Array | None) -> Cloud:
        if times_s is None or self._velocity is None:
            return Cloud.of(xyz)
        return Cloud.of(self._velocity.undo(xyz, times_s))

    def _follow(self, cloud: Cloud, expected: FloatArray) -> FloatArray:
        """Return the pose of a scan, (4, 4), given the motion that is expected since the scan before."""
        assert self._before is not None
        found, step, self.is_bridged = self._laid_on_map(cloud, expected)
        if found.inlier_share < _SURE_SHARE or _is_far(step, expected):
            alone = register_clouds(cloud, self._before, step)
            is_held = alone.inlier_share >= _HELD_SHARE and alone.information >= _HELD_INFORMATION
            if not is_held or _is_far(alone.T_target_source, step):
                try:
                    searched = _searched(cloud, self._before, expected)
                except _UnheldError:
                    _check(found, expected)
                    self.is_bridged = True
                    self._count(expected)
                    return self._pose @ expected
                found, step, self.is_bridged = self._laid_on_map(cloud, searched)
                if _is_far(step, searched):
                    raise DriveError(
                        f"laid onto the scan before it, it moved by {_length(searched):.1f} m, laid onto all before "
                        f"it by {_length(step):.1f} m: one of them is wrong. Usual cause: missing scans, or a "
                        "place where nothing stands out (a tunnel, an open field)."
                    )
        _check(found, step)
        self._count(step)
        pose = self._pose @ step
        pose[:3, :3] = found.T_target_source[:3, :3]  # which is a rotation to the last digit
        return pose

    def _laid_on_map(self, cloud: Cloud, expected: FloatArray) -> tuple[Registration, FloatArray, bool]:
        """Return how a scan lies on the map, the motion since the scan before, and whether that is partly expected.

        Along directions in which the map hardly holds it, the motion is that against the scan before alone, whose lines
        of points are not smeared; where that does not hold it either, the expected one.
        """
        assert self._before is not None
        found = self._map.register(cloud, self._pose @ expected)
        step: FloatArray = invert_transform(self._pose) @ found.T_target_source
        if not found.weak.size:
            return found, step, False
        alone = register_clouds(cloud, self._before, expected)
        needed = _FIRM_INFORMATION if found.is_unheld else MIN_INFORMATION
        is_held = alone.inlier_share >= _HELD_SHARE and alone.information >= needed
        if is_held or found.is_unheld:
            better = alone.T_target_source if is_held else expected
            axes = step[:3, :3] @ found.weak
            step[:3, 3] += axes @ (axes.T @ (better[:3, 3] - step[:3, 3]))
        return found, step, found.is_unheld and not is_held

    def _count(self, step: FloatArray) -> None:
        """Count the metres over which a direction was not held, less those over which all were; end at too many."""
        self._unheld_m = max(0.0, self._unheld_m + (1 if self.is_bridged else -1) * _length(step))
        if self._unheld_m > _MAX_BRIDGED_M:
            raise DriveError(
                f"for {self._unheld_m:.0f} m nothing has told how far the vehicle moved. Usual cause: points on the "
                "ground only, a tunnel, or an open field; give poses."
            )


def _length(step: FloatArray) -> float:
    return float(np.linalg.norm(step[:3, 3]))


def _is_far(step: FloatArray, other: FloatArray) -> bool:
    between = invert_transform(other) @ step
    turned = np.arccos(np.clip((np.trace(between[:3, :3]) - 1) / 2, -1, 1))
    return _length(between) > _MAX_CHANGE_M + _MAX_CHANGE * _length(other) or bool(turned > _MAX_CHANGE_RAD)


class _UnheldError(DriveError):
    """Nothing tells the motion along some direction."""


def _searched(cloud: Cloud, before: Cloud, expected: FloatArray) -> FloatArray:
    """Return the motion between two scans, wherever around the expected one it is."""
    found = search(cloud, before, expected, _SEARCHED_M)
    if not found.is_certain:
        _check(found.best, found.best.T_target_source)
        if found.best.information < MIN_INFORMATION:
            raise _UnheldError(
                "little in it tells how far it is from the scan before it. Usual cause: points on the ground only, a "
                f"tunnel, an open field, or scans more than {_SEARCHED_M:.0f} m apart; give poses, or all scans."
            )
        best, other = 100 * found.best.inlier_share, 100 * (found.best.inlier_share - found.lead)
        raise DriveError(
            f"it fits the scan before it at several places ({best:.0f} % of its points do "
            f"{_length(found.best.T_target_source):.1f} m from it, {other:.0f} % elsewhere). {_TOO_FAR}, or a "
            "place where nothing stands out; give all scans, or poses."
        )
    return found.best.T_target_source


_TOO_FAR = "Usual cause: scans more than some metres apart (keyframes of a drive, or scans that are missing)"


def _check(found: Registration, step: FloatArray) -> None:
    """Raise DriveError where a registration cannot be trusted."""
    if found.inlier_share < MIN_INLIER_SHARE:
        raise DriveError(
            f"it does not fit the scans before it: {100 * found.inlier_share:.0f} % of its points do, at least "
            f"{100 * MIN_INLIER_SHARE:.0f} % were expected. {_TOO_FAR}; give all scans, or poses."
        )
    if _length(step) > MAX_STEP_M:
        raise DriveError(
            f"it was taken {_length(step):.1f} m from the scan before it; at most {MAX_STEP_M:.0f} m can be bridged. "
            "Give all scans, or poses."
        )
