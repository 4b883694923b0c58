"""What the method needs of a drive, whatever its layout on disk."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray
from interloc.errors import DriveError


@dataclass(frozen=True)
class GroundPoints:
    """The points of one scan that the method can use."""

    xyz: Float32Array
    """(N, 3) float32: points in L, metres: road points first, then the points most often confused with them."""
    road_count: int
    """How many of them are road; the rest is sidewalk, parking and other ground."""
    is_doubtful: bool = False
    """Labels made by geometry say that they may be wrong here."""

    @classmethod
    def split(cls, xyz: Float32Array, is_road: BoolArray) -> "GroundPoints":
        """Sort (N, 3) points into road and the rest by a (N,) mask."""
        return cls(np.concatenate([xyz[is_road], xyz[~is_road]]), int(np.count_nonzero(is_road)))

    @property
    def road(self) -> Float32Array:
        """(M, 3) float32 road points in L, metres (paper, section III-B.1); a view."""
        return self.xyz[: self.road_count]

    @property
    def confusable(self) -> Float32Array:
        """(N - M, 3) float32 points of sidewalk, parking and other ground in L, metres; a view."""
        return self.xyz[self.road_count :]

    @property
    def is_road(self) -> BoolArray:
        """(N,) bool, True for road."""
        return np.arange(len(self.xyz)) < self.road_count


@dataclass(frozen=True)
class Georeference:
    """Geodetic pose of the LiDAR at every scan of a drive."""

    lat_deg: FloatArray
    lon_deg: FloatArray
    alt_m: FloatArray
    """(N,) float64: position of the LiDAR on WGS84."""
    R_enu_lidar: FloatArray
    """(N, 3, 3) float64: attitude, L axes in the local east-north-up frame at the fix."""
    source: str
    """Where it came from, in words ("oxts/data, lever arm of calib_imu_to_velo.txt")."""
    position_std_m: FloatArray | None = None
    """(N,) float64 or None: one-sigma uncertainty of the position along each horizontal axis, as its source states it;
    NaN where it does not."""

    @property
    def lonlat(self) -> FloatArray:
        """(N, 2) float64: longitude and latitude."""
        return np.stack([self.lon_deg, self.lat_deg], axis=-1)

    def part(self, rows: slice | IntArray) -> "Georeference":
        """Return that of some of the scans."""
        std_m = self.position_std_m
        return replace(
            self,
            lat_deg=self.lat_deg[rows],
            lon_deg=self.lon_deg[rows],
            alt_m=self.alt_m[rows],
            R_enu_lidar=self.R_enu_lidar[rows],
            position_std_m=None if std_m is None else std_m[rows],
        )


@runtime_checkable
class Drive(Protocol):
    """A drive: poses up front, points on demand.

    One whose scans take long to read (a network labels them) may say so by an attribute `is_slow`, True: several are
    then read at once.
    """

    @property
    def name(self) -> str: ...
    @property
    def frames(self) -> IntArray: ...
    @property
    def T_world_lidar(self) -> FloatArray: ...
    @property
    def times_s(self) -> FloatArray | None: ...
    @property
    def georeference(self) -> Georeference | None: ...

    def ground_points(self, index: int) -> GroundPoints:
        """Read the scan at a position 0..N-1 of the drive; a DriveError says what is wrong with its files."""


@dataclass(frozen=True)
class DriveScan:
    """One scan of a drive on its way into the detector; its points are read when first asked for."""

    drive: Drive
    index: int

    @property
    def frame(self) -> int:
        """Scan number."""
        return int(self.drive.frames[self.index])

    @property
    def T_world_lidar(self) -> FloatArray:
        """(4, 4) float64 pose of the LiDAR in W."""
        pose: FloatArray = self.drive.T_world_lidar[self.index]
        return pose

    @property
    def time_s(self) -> float | None:
        """Time of the scan, seconds, where the drive knows it."""
        return None if self.drive.times_s is None else float(self.drive.times_s[self.index])

    @cached_property
    def _points(self) -> GroundPoints:
        return self.drive.ground_points(self.index)

    @property
    def road_points(self) -> Float32Array:
        """(M, 3) float32 road points in L, metres."""
        return self._points.road

    @property
    def other_points(self) -> Float32Array:
        """(N, 3) float32 points of sidewalk, parking and other ground in L, metres."""
        return self._points.confusable

    @property
    def is_doubtful(self) -> bool:
        """Whether the labels of the scan may be wrong."""
        return self._points.is_doubtful


def check_columns(drive: Drive) -> None:
    """Refuse (DriveError) a drive whose columns do not belong together: one of a user's own may be anything."""
    poses, times, count = drive.T_world_lidar, drive.times_s, len(drive.frames)
    is_whole = isinstance(poses, np.ndarray) and poses.shape == (count, 4, 4) and (times is None or len(times) == count)
    if not (isinstance(drive.name, str) and is_whole and (np.diff(drive.frames) > 0).all()):
        raise DriveError(
            f"{drive.name}: a drive has a text as name, N ascending frames, an array T_world_lidar of (N, 4, 4), and N "
            "times or none. Usual mistake: scans were left out of one of them, or two passes joined."
        )


def is_slow(drive: Drive) -> bool:
    """Return whether several scans of a drive should be read at once."""
    return bool(getattr(drive, "is_slow", False))


def read_ahead(scans: Iterable[DriveScan], threads: int) -> Iterator[DriveScan]:
    """Yield scans in their order, while threads read the points of the next ones.

    Only as many scans as there are threads wait to be used, so memory does not grow with the drive. What is wrong with
    a scan is raised where its points are used.
    """
    with ThreadPoolExecutor(threads, "read ahead") as pool:
        waiting: deque[tuple[DriveScan, Future[GroundPoints]]] = deque()
        try:
            for scan in scans:
                waiting.append((scan, pool.submit(_points_of, scan)))
                if len(waiting) > threads:
                    yield _ready(*waiting.popleft())
            while waiting:
                yield _ready(*waiting.popleft())
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _points_of(scan: DriveScan) -> GroundPoints:
    # Before Python 3.12 a cached property lets one thread in at a time, whichever object it is of.
    points = scan.drive.ground_points(scan.index)
    vars(scan)["_points"] = points
    return points


def _ready(scan: DriveScan, reading: Future[GroundPoints]) -> DriveScan:
    wait([reading])
    return scan


def scans_of(drive: Drive, indices: Iterable[int] | None = None) -> Iterator[DriveScan]:
    """Yield the scans of a drive (all, or those at the given positions) in order, without reading any points."""
    for index in range(len(drive.frames)) if indices is None else indices:
        yield DriveScan(drive, int(index))
