"""Poses of the LiDAR from its points alone: each scan is laid onto those before it, by GICP of small_gicp."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray
from interloc.errors import DriveError, install
from interloc.geometry import invert_transform

MAX_STEP_M = 10.0
"""From scan to scan; real scans farther apart share too little."""

_SEARCHED_M = 5.0
_SURE_SHARE = 0.8  # of inliers on the map: what fits less is held against the scan before alone
_HELD_SHARE, _HELD_INFORMATION = 0.4, 1.0  # of a scan that lies on the one before it as expected
_FIRM_INFORMATION = 4.0  # of a scan that nothing holds on the map: rings on the road, which move along, reach 3.6
_MAX_BRIDGED_M = 25.0  # a car that brakes or speeds up as usual is then off by some metres
_TOO_FAR = "Usual cause: scans more than some metres apart (keyframes of a drive, or scans that are missing)"
_MAX_CHANGE_M, _MAX_CHANGE, _MAX_CHANGE_RAD = 0.3, 0.25, np.radians(10)  # of the motion from scan to scan: m + share


class Odometry:
    """Poses of a LiDAR from its scans, one after the other; `deskew` takes the motion out of scans with times.

    1. The motion from the first scan to the second is searched for: the LiDAR may stand or drive at any speed.
    2. A scan is expected where constant velocity leads; its points are moved to where they were at its time.
    3. It is laid onto the map of the scans before it, and added to that map.
    4. Along a direction in which nothing holds it (`is_bridged`), the velocity is kept, for some metres at most.
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
        """Take the (N, 3) points, in L, of the next scan, and return T_world_lidar; W is the LiDAR at the first scan.

        Points without a return (not finite, or zero) do not matter. The clock grows from scan to scan: seconds, or the
        number of the scan where no times are known; `times_s` tells when each point was measured, in its units after
        it.
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
    """Return the motion between two scans, searched for from guesses all around the expected one in the plane."""
    results = [register_clouds(cloud, before, expected)]
    for distance_m in np.arange(_REACHES_M[0], _SEARCHED_M + 0.1, 1.5):
        for angle in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
            moved = expected.copy()
            moved[:2, 3] += distance_m * np.array([np.cos(angle), np.sin(angle)])
            results.append(register_clouds(cloud, before, moved))
    best = max(results, key=lambda each: each.inlier_share)
    place = best.T_target_source[:3, 3]
    others = (each for each in results if np.linalg.norm(each.T_target_source[:3, 3] - place) > _SAME_PLACE_M)
    lead = best.inlier_share - max((each.inlier_share for each in others), default=0.0)
    if best.inlier_share < MIN_INLIER_SHARE or best.information < MIN_INFORMATION or lead < MIN_LEAD:
        _check(best, best.T_target_source)
        if best.information < MIN_INFORMATION:
            raise _UnheldError(
                "little in it tells how far it is from the scan before it. Usual cause: points on the ground only, a "
                f"tunnel, an open field, or scans more than {_SEARCHED_M:.0f} m apart; give poses, or all scans."
            )
        raise DriveError(
            f"it fits the scan before it at several places ({100 * best.inlier_share:.0f} % of its points do "
            f"{_length(best.T_target_source):.1f} m from it, {100 * (best.inlier_share - lead):.0f} % elsewhere). "
            f"{_TOO_FAR}, or a place where nothing stands out; give all scans, or poses."
        )
    return best.T_target_source


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


# Laying one scan onto another, or onto a map of those before it


MIN_RANGE_M, MAX_RANGE_M = 2.5, 80.0
"""Nearer points are those of the vehicle itself; farther ones lie too thin to be matched."""

MIN_INLIER_SHARE = 0.5
"""Two real scans of a street up to 4 m apart reach 0.78 to 0.95, thin ones of 16 lasers 0.48 and more at the worst;
real scans 16 to 24 m apart that were laid wrongly 0.34 to 0.47."""

MIN_INFORMATION = 1.5
"""Two scans that were laid rightly have 1.8 and more in 99 of 100 cases, mostly 5 to 90; those that slid along a street
to a wrong place 0.7 to 1.5."""

_HELD, _HARDLY_HELD = 3000.0, 1500.0
"""Of a direction: its information beyond that of a plain surface, 0.5, times the inliers. On twins whose streets have
nothing beside them the motion was wrong up to 1,300; real streets have 4,700 and more."""

MIN_LEAD = 0.1
"""So much larger than that of any other place is the share of inliers where two scans belong together: 0.15 at least in
real streets; 0.06 among rows of equal houses."""

_MAX_POINTS = 25_000  # before the grid thins them: more take time and gained nothing
_RESOLUTION_M = 0.5
_NEIGHBOURS = 10
_REACHES_M = (2.0, 0.5)
_SAME_PLACE_M = 0.5
_CELL_M = 1.0
_FORGET_AFTER = 100  # scans that did not touch a cell
_ITERATIONS = 30


@dataclass(frozen=True)
class Registration:
    """How a scan lies on another one, or on a map, by the (4, 4) pose of the source in the target."""

    T_target_source: FloatArray
    inlier_share: float
    """Share of the points of the source, one per 0.5 m, with a point of the target within 0.5 m; on a map, with a cell
    of 1 m of the map around them."""
    information: float
    """How firmly the least certain direction of the motion is held, as the curvature of GICP's cost per inlier: 1.5 to
    90 in streets, 0.5 where nothing stands beside a plain road."""
    weak: FloatArray
    """(3, K) float64: directions in the source, of length 1, along which little holds it: there the pattern of the
    lasers on the road counts, which moves along with them."""
    is_unheld: bool
    """Nothing holds it along one of them."""


@dataclass(frozen=True)
class Cloud:
    """A scan ready to be laid onto others: one point per 0.5 m, each with the shape of the surface around it."""

    points: Any
    tree: Any

    @classmethod
    def of(cls, xyz: Float32Array | FloatArray) -> Cloud:
        """Prepare (N, 3) points in L, metres, of which `usable_rows` were taken."""
        return cls(*require_small_gicp().preprocess_points(xyz.astype(np.float64), _RESOLUTION_M, _NEIGHBOURS, 1))

    def __len__(self) -> int:
        return int(self.points.size())


def usable_rows(xyz: Float32Array | FloatArray) -> IntArray:
    """Return the (M,) int64 rows of (N, 3) points in L that are used: some 25,000 within range, evenly spread."""
    stride = len(xyz) // _MAX_POINTS | 1  # odd: an even one would leave out whole lasers of scans in columns
    with np.errstate(invalid="ignore", over="ignore"):
        squared = np.square(xyz[::stride]).sum(axis=1)
    return np.flatnonzero((squared > MIN_RANGE_M**2) & (squared < MAX_RANGE_M**2)) * stride


def register(
    source_points: Float32Array | FloatArray, target_points: Float32Array | FloatArray, guess: FloatArray | None = None
) -> Registration:
    """Lay one scan onto another: (N, 3) and (M, 3) points in L at either, where those without a return do not matter.

    The guess of T_target_source has to be within about 2 m and 10 degrees; without one the LiDAR has not moved.
    """
    source, target = (Cloud.of(xyz[usable_rows(xyz)]) for xyz in (source_points, target_points))
    return register_clouds(source, target, np.eye(4) if guess is None else guess)


def register_clouds(source: Cloud, target: Cloud, guess: FloatArray) -> Registration:
    """Lay one scan onto another, as `register`: first within a reach of 2 m, then within 0.5 m."""
    if not len(source) or not len(target):
        return Registration(guess, 0.0, 0.0, np.eye(3), is_unheld=True)
    pose, found = guess, None
    for reach_m in _REACHES_M:
        found = require_small_gicp().align(
            *(target.points, source.points, target.tree, pose),
            max_correspondence_distance=reach_m,
            max_iterations=_ITERATIONS,
        )
        pose = found.T_target_source
    return _registration(found, len(source))


class LocalMap:
    """What the last scans saw, in cells of 1 m; cells that no scan has touched for long are forgotten."""

    def __init__(self) -> None:
        self._map = require_small_gicp().GaussianVoxelMap(_CELL_M)
        self._map.set_lru(_FORGET_AFTER, 10)

    def __len__(self) -> int:
        return int(self._map.size())

    def add(self, cloud: Cloud, T_map_cloud: FloatArray) -> None:
        """Add a scan by its pose."""
        self._map.insert(cloud.points, T_map_cloud)

    def register(self, cloud: Cloud, guess: FloatArray) -> Registration:
        """Lay a scan onto the map, from a (4, 4) guess of its pose."""
        if not len(cloud):
            return Registration(guess, 0.0, 0.0, np.eye(3), is_unheld=True)
        found = require_small_gicp().align(
            self._map, cloud.points, guess, max_correspondence_distance=_REACHES_M[0], max_iterations=_ITERATIONS
        )
        return _registration(found, len(cloud))


def _registration(found: Any, count: int) -> Registration:  # noqa: ANN401 - small_gicp has no types
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - slow to import

    pose = np.array(found.T_target_source)
    pose[:3, :3] = Rotation.from_matrix(pose[:3, :3]).as_matrix()  # its errors of rounding would add up
    inliers = max(1, found.num_inliers)
    curvature, axes = np.linalg.eigh(found.H[3:, 3:] / inliers)  # rows 0 to 2 are the rotation
    held = (curvature - 0.5) * inliers
    is_unheld = bool(held[0] < _HARDLY_HELD)
    return Registration(pose, found.num_inliers / count, float(curvature[0]), axes[:, held < _HELD], is_unheld)


def require_small_gicp() -> Any:  # noqa: ANN401 - a module without types
    """Import small_gicp."""
    try:
        return importlib.import_module("small_gicp")
    except ImportError:
        raise DriveError(f"poses from points need small_gicp, which is not installed: {install('odometry')}") from None


# Motion within a scan: a turn takes a tenth of a second, in which a car moves by a metre or more


_TURN_RAD = np.radians(300)
"""A scan whose points turn by less while it is taken is not one of a spinning LiDAR."""

_STRAIGHT_RAD = np.radians(8)
"""So far the azimuth of a point may lie from that of its time: lasers are mounted at angles of their own."""

_NEAR_M = 20.0
_ENOUGH = 500  # points
_TELLING_RAD = np.radians(0.25)


@dataclass(frozen=True)
class Velocity:
    """How the LiDAR moves, constant for a while, in its own axes; time counts in scans where no times are known."""

    linear_mps: FloatArray
    """(3,) metres per unit of time."""
    angular_radps: FloatArray
    """(3,) rotation vector per unit of time."""

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
        """Move (N, 3) points, in the LiDAR at the time of each, to where they would have been seen at that of the scan.

        `times_s` tells when each was measured, seconds after the time of the scan (before it: negative).
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

    It is None where the points do not tell: the LiDAR does not spin, or it hardly moved. A spinning LiDAR measures at
    an azimuth that grows evenly with time. Where the motion was taken out, near points deviate from that by as much as
    they were moved, and this is the slope of a line through deviation against motion: 0 where they are as measured, 1
    where they were moved.
    """
    distance_m = np.hypot(xyz[:, 0], xyz[:, 1])
    near = np.flatnonzero((np.abs(distance_m - _NEAR_M / 2) < _NEAR_M / 2 - 1) & np.isfinite(times_s))
    rows = near[np.argsort(times_s[near], kind="stable")]
    if len(rows) < _ENOUGH:
        return None
    points, at = xyz[rows].astype(np.float32), times_s[rows].astype(np.float32)
    azimuth = np.unwrap(_azimuths(points))
    steady = np.polynomial.Polynomial.fit(at, azimuth, 1)
    is_spinning = abs(steady(float(at[-1])) - steady(float(at[0]))) > _TURN_RAD
    if not is_spinning or np.median(np.abs(azimuth - steady(at))) > _STRAIGHT_RAD:
        return None
    shift = (_azimuths(velocity.undo(points, at)) - _azimuths(points) + np.pi) % (2 * np.pi) - np.pi
    even = np.stack([np.ones_like(at), at], axis=1).astype(np.float64)
    shift, deviation = (each - even @ np.linalg.lstsq(even, each)[0] for each in (shift, azimuth))
    if float(np.std(shift)) < _TELLING_RAD:
        return None
    return float(shift @ deviation) / float(shift @ shift) < 0.5


def _azimuths(xyz: Float32Array) -> FloatArray:
    return np.arctan2(xyz[:, 1], xyz[:, 0]).astype(np.float64)
