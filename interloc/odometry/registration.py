"""Laying one scan onto another, or onto a map of those before it: GICP, by the package small_gicp."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from interloc.arrays import Float32Array, FloatArray, IntArray
from interloc.errors import DriveError, install

MIN_RANGE_M, MAX_RANGE_M = 2.5, 80.0
"""Nearer points are those of the vehicle itself; farther ones lie too thin to be matched."""

MIN_INLIER_SHARE = 0.5
"""Two real scans of a street up to 4 m apart reach 0.78 to 0.95, thin ones of 16 lasers 0.48 and more at the worst;
real scans 16 to 24 m apart that were laid wrongly 0.34 to 0.47."""

MIN_INFORMATION = 1.5
"""Two scans that were laid rightly have 1.8 and more in 99 of 100 cases, mostly 5 to 90; those that slid along a street
to a wrong place 0.7 to 1.5."""

_PLAIN = 0.5
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
    """How a scan lies on another one, or on a map."""

    T_target_source: FloatArray
    """(4, 4) float64: pose of the source in the target, metres."""
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
    rows: IntArray = np.flatnonzero((squared > MIN_RANGE_M**2) & (squared < MAX_RANGE_M**2)) * stride
    return rows


def register(
    source_points: Float32Array | FloatArray, target_points: Float32Array | FloatArray, guess: FloatArray | None = None
) -> Registration:
    """Lay one scan onto another.

    Parameters
    ----------
    source_points, target_points : (N, 3), (M, 3) float
        In the LiDAR at either scan, metres; points without a return (not finite, or zero) do not matter.
    guess : (4, 4) float64 or None
        T_target_source, within about 2 m and 10 degrees; None: the LiDAR has not moved.
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
            target.points,
            source.points,
            target.tree,
            pose,
            max_correspondence_distance=reach_m,
            max_iterations=_ITERATIONS,
        )
        pose = found.T_target_source
    return _registration(found, len(source))


@dataclass(frozen=True)
class Found:
    """What a search for an unknown motion ends with."""

    best: Registration
    lead: float
    """By how much its share of inliers is larger than that of any result more than 0.5 m from it."""

    @property
    def is_certain(self) -> bool:
        """Whether the scans fit at this place, and only there."""
        fits = self.best.inlier_share >= MIN_INLIER_SHARE and self.best.information >= MIN_INFORMATION
        return fits and self.lead >= MIN_LEAD


def search(source: Cloud, target: Cloud, guess: FloatArray, reach_m: float) -> Found:
    """Lay one scan onto another whose motion is not known, from guesses all around in the plane."""
    results = [register_clouds(source, target, guess)]
    for distance_m in np.arange(_REACHES_M[0], reach_m + 0.1, 1.5):
        for angle in np.linspace(0.0, 2 * np.pi, 8, endpoint=False):
            moved = guess.copy()
            moved[:2, 3] += distance_m * np.array([np.cos(angle), np.sin(angle)])
            results.append(register_clouds(source, target, moved))
    best = max(results, key=lambda each: each.inlier_share)
    place = best.T_target_source[:3, 3]
    others = (each for each in results if np.linalg.norm(each.T_target_source[:3, 3] - place) > _SAME_PLACE_M)
    return Found(best, best.inlier_share - max((each.inlier_share for each in others), default=0.0))


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
    held = (curvature - _PLAIN) * inliers
    is_unheld = bool(held[0] < _HARDLY_HELD)
    return Registration(pose, found.num_inliers / count, float(curvature[0]), axes[:, held < _HELD], is_unheld)


def require_small_gicp() -> Any:  # noqa: ANN401 - a module without types
    """Import small_gicp."""
    try:
        return importlib.import_module("small_gicp")
    except ImportError:
        raise DriveError(f"poses from points need small_gicp, which is not installed: {install('odometry')}") from None
