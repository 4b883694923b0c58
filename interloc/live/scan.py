"""A scan on its way into a session: as it was measured, with its labels or sorted already, and where it was."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from interloc.arrays import Float32Array, FloatArray, UInt32Array
from interloc.config import DetectorConfig
from interloc.detection.keyframes import select_keyframes
from interloc.detection.scan import checked_points
from interloc.drive import Drive, DriveScan, Georeference, GroundPoints
from interloc.drives.labels import SEMANTICKITTI, LabelScheme
from interloc.errors import DriveError, GeoreferenceError
from interloc.geometry import wrap_longitude

_USUAL_HZ = 10.0
_OWN: tuple[Literal["C", "W"], ...] = ("C", "W")
"""Arrays as the kernels are compiled for: those of a message can only be read."""

Label = Callable[[Float32Array], UInt32Array]
"""Gives (N, 4) points, x y z in L and remission, their (N,) labels, as `label` of a network does."""


@dataclass(frozen=True)
class Fix:
    """Geodetic pose of the LiDAR at one scan."""

    lat_deg: float
    lon_deg: float
    alt_m: float
    """On WGS84."""
    R_enu_lidar: FloatArray
    """(3, 3) float64: axes of L in east, north, up."""
    position_std_m: float | None = None
    """One-sigma uncertainty along each horizontal axis, where the receiver states it."""

    @classmethod
    def of(cls, georeference: Georeference, row: int) -> "Fix":
        """Return the fix of one scan of a drive."""
        std = None if georeference.position_std_m is None else float(georeference.position_std_m[row])
        lat, lon, alt = (float(each[row]) for each in (georeference.lat_deg, georeference.lon_deg, georeference.alt_m))
        return cls(lat, lon, alt, georeference.R_enu_lidar[row], None if std is None or np.isnan(std) else std)

    def checked(self, frame: int) -> "Fix":
        """Return the fix, its longitude in [-180, 180).

        A `GeoreferenceError` says that it is no place on Earth, or its attitude no rotation.
        """
        R = self.R_enu_lidar
        numbers = np.array([self.lat_deg, self.lon_deg, self.alt_m, *R.ravel()])
        is_place = np.isfinite(numbers).all() and abs(self.lat_deg) <= 90 and abs(self.lon_deg) <= 360
        if not is_place or R.shape != (3, 3) or np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
            raise GeoreferenceError(
                f"scan {frame}: its fix ({self.lat_deg:g}, {self.lon_deg:g}) is no place on WGS84 with a rotation. "
                "Expected degrees, and the axes of the LiDAR in east, north, up. Usual cause: radians, or no fix yet."
            )
        return replace(self, lon_deg=float(wrap_longitude(self.lon_deg)))


def georeference_of(fixes: list[Fix]) -> Georeference:
    """Return fixes as columns."""
    std = [fix.position_std_m if fix.position_std_m and fix.position_std_m > 0 else np.nan for fix in fixes]
    return Georeference(
        lat_deg=np.array([fix.lat_deg for fix in fixes]),
        lon_deg=np.array([fix.lon_deg for fix in fixes]),
        alt_m=np.array([fix.alt_m for fix in fixes]),
        R_enu_lidar=np.array([fix.R_enu_lidar for fix in fixes]).reshape(-1, 3, 3),
        source="live fixes",
        position_std_m=np.array(std),
    )


@dataclass(frozen=True)
class LiveScan:
    """One scan as it comes from a sensor; its points are sorted only if it becomes a keyframe."""

    frame: int
    """Scan number; ascending."""
    T_world_lidar: FloatArray
    """(4, 4) float64: pose of the LiDAR in W."""
    points: Float32Array
    """(N, 4) or (N, 3) float32: x y z in L, metres, and remission from 0 to 1, which only a labeller needs."""
    labels: UInt32Array | None = None
    """(N,) uint32 or None: label ids; None where `road_count` is given, or where `label` gives them."""
    road_count: int | None = None
    """Where the points are sorted already: so many are road, those behind them sidewalk, parking and other ground."""
    time_s: float | None = None
    fix: Fix | None = None
    """Where it was on Earth, if that is known; then it is of every scan of a session."""
    scheme: LabelScheme = SEMANTICKITTI
    """Which labels are road."""
    label: Label | None = None
    """Gives the points their labels."""

    @property
    def nbytes(self) -> int:
        """Size of its points and labels."""
        return self.points.nbytes + (0 if self.labels is None else self.labels.nbytes)

    @cached_property
    def ground(self) -> GroundPoints:
        """The points that the method can use.

        A `DriveError` says that there are neither labels nor a way to label, that they are of other points, or that a
        point is not finite.
        """
        points = checked_points(self.points, self)
        if not 0 <= (self.road_count or 0) <= len(points):
            raise DriveError(f"scan {self.frame}: {self.road_count:,} of its {len(points):,} points are road.")
        if self.road_count is not None:
            ground = GroundPoints(np.require(points[:, :3], np.float32, _OWN), self.road_count)
            bad = np.flatnonzero(~np.isfinite(ground.xyz).all(axis=1))
            bad_point = int(bad[0]) if len(bad) else -1
        else:
            labels = self.labels if self.labels is not None or self.label is None else self.label(self.points)
            if labels is None:
                raise DriveError(
                    f"scan {self.frame}: it has no labels, and nothing gives it any. Expected one label per point, "
                    "points sorted into road and other ground, or a network (--model)."
                )
            if np.shape(labels) != (len(points),):
                raise DriveError(
                    f"scan {self.frame}: labels of shape {np.shape(labels)} for {len(points):,} points; each needs one."
                )
            from interloc.kernels.ground import select_points  # noqa: PLC0415 - slow to import

            points = points[:, :4] if points.shape[1] > 3 else np.pad(points, ((0, 0), (0, 1)))
            own = np.require(points, np.float32, _OWN), np.require(labels, np.uint32, _OWN)
            xyz, road_count, bad_point = select_points(*own, self.scheme.groups())
            ground = GroundPoints(xyz, road_count)
        if bad_point >= 0:
            raise DriveError(
                f"scan {self.frame}: point {bad_point:,} is not finite. Usual cause: points without a return that are "
                "NaN; leave them out, with their labels."
            )
        return ground

    @property
    def road_points(self) -> Float32Array:
        """(M, 3) float32 road points in L, metres."""
        return self.ground.road

    @property
    def other_points(self) -> Float32Array:
        """(M, 3) float32 points of sidewalk, parking and other ground in L, metres."""
        return self.ground.confusable


def live_scan(drive: Drive, row: int) -> LiveScan:
    """Read a scan of a drive as the sensor would have sent it: its points sorted, with pose, time and fix."""
    scan, fixes = DriveScan(drive, row), drive.georeference
    ground = drive.ground_points(row)
    return LiveScan(
        frame=scan.frame,
        T_world_lidar=scan.T_world_lidar,
        points=ground.xyz,
        road_count=ground.road_count,
        time_s=scan.time_s,
        fix=None if fixes is None else Fix.of(fixes, row),
    )


def play(
    drive: Drive,
    config: DetectorConfig,
    *,
    speed: float | None = None,
    after: int = -1,
    wait: Callable[[float], None] = time.sleep,
) -> Iterator[LiveScan]:
    """Yield the scans of a drive that are keyframes: a session looks at no others.

    At speed 1 they come at the times at which they were taken, at 2 twice as fast, at None as fast as they are taken.
    Scans up to `after` have arrived already. `wait` is called with the seconds until the next scan is due.
    """
    rows = select_keyframes(drive.T_world_lidar, config.keyframes)
    rows = rows[drive.frames[rows] > after]
    due_s = _times(drive)[rows]
    began = time.monotonic()
    for row, seconds in zip(rows.tolist(), due_s.tolist(), strict=True):
        scan = live_scan(drive, row)
        if speed is not None:
            wait(max(0.0, began + (seconds - due_s[0]) / speed - time.monotonic()))
        yield scan


def _times(drive: Drive) -> FloatArray:
    if drive.times_s is not None and np.isfinite(drive.times_s).all():
        return drive.times_s
    return np.asarray(drive.frames / _USUAL_HZ, np.float64)
