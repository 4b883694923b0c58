"""LAS files that hold one scan each, in the coordinates of the sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.findings import Findings
from interloc.drives.layouts import POSE_FILES, DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.poses.tum import looks_like_tum
from interloc.drives.scans.las.clouds import ROAD_SURFACE, CloudFile, Field, all_of
from interloc.drives.scans.las.slices import MAX_SCAN_POINTS
from interloc.drives.scans.las.tracks import find_tracks, is_table
from interloc.drives.scans.pcd import number_scans
from interloc.drives.scans.point_times import point_times
from interloc.drives.scans.recorded import Recording, ScanPoints

SENSOR_RANGE_M = 1000.0
"""No LiDAR of a vehicle sees further; coordinates beyond are those of a map."""

_FIELDS: frozenset[Field] = frozenset({"xyz", "labels", "intensity", "time"})
_SAMPLED = 5


@dataclass(frozen=True)
class ScanClouds:
    """One LAS file per scan; a `PointSource`."""

    clouds: tuple[CloudFile, ...]
    """In the order of the scans."""
    frames: IntArray
    """(N,) int64: their scan numbers, ascending."""
    carries_labels: bool

    def _cloud(self, frame: int) -> CloudFile:
        return self.clouds[int(np.searchsorted(self.frames, frame))]

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self._cloud(frame).file.name

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of a scan."""
        return (self._cloud(frame).file.path,)

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan; points that are marked as withheld stay in their place, with label 0.

        Raises
        ------
        DriveError
            The file is missing or damaged.
        """
        cloud = self._cloud(frame)
        values = np.empty((cloud.points, 4), np.float32)
        labels = np.empty(cloud.points, np.uint32)
        times: list[FloatArray] = []
        at = 0
        for block in cloud.read(fields=_FIELDS):
            rows = slice(at, at + len(block.withheld))
            values[rows, :3], values[rows, 3] = block.xyz, block.intensity
            labels[rows] = np.where(block.withheld, 0, block.labels)
            times.append(block.times_s)
            at = rows.stop
        times_s = point_times(np.concatenate(times)) if cloud.has_time and times else None
        return ScanPoints(values, labels if self.carries_labels else None, times_s)


def is_one_per_scan(clouds: tuple[CloudFile, ...], parts: DriveParts, options: DriveOptions) -> bool:
    """Return whether files hold one scan each: all around the origin, and several or with a single pose beside.

    Of a map in local coordinates the same may be true; what tells it is a trajectory in place of poses.
    """
    around = all(
        max(abs(value) for value in (*cloud.minimum[:2], *cloud.maximum[:2])) < SENSOR_RANGE_M for cloud in clouds
    )
    if not around or options.crs is not None:
        return False
    path = _pose_file(parts, options)
    if not path.is_file():
        return len(clouds) > 1 and not (clouds[0].has_time and find_tracks([parts.root, parts.scans]))
    return not is_table(path) if len(clouds) > 1 else _holds_one_pose(path)


def _holds_one_pose(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return len(file.read(4096).split()) in {8, 12, 13, 16, 17}
    except OSError:
        return False


def open_scan_clouds(
    clouds: tuple[CloudFile, ...], parts: DriveParts, options: DriveOptions, findings: Findings
) -> Recording:
    """Open the files of the scans, in the order of the numbers in their names.

    Raises
    ------
    DriveError
        A file holds more points than any scan, or one that is looked into is damaged; where `findings` stops at it.
    """
    parts = replace(parts, poses=_pose_file(parts, options))
    folder = all_of(clouds)
    order, frames, times_s, how = number_scans([f"{cloud.file.path.stem}.pcd" for cloud in clouds])
    if how:
        findings.note(folder.name, how)
    clouds = tuple(clouds[row] for row in order)
    for cloud in clouds:
        if cloud.points > MAX_SCAN_POINTS:
            findings.error(
                cloud.file.fault(
                    f"holds {cloud.points:,} points; a scan has at most {MAX_SCAN_POINTS:,}. "
                    "Expected one file per scan. Usual cause: a map, or the whole drive in one file."
                )
            )
    counts = np.array([cloud.points for cloud in clouds])
    has_road, has_intensity = False, False
    sampled = np.unique(np.linspace(0, len(clouds) - 1, _SAMPLED).astype(int))
    for row in sampled[counts[sampled] <= MAX_SCAN_POINTS]:
        with findings.stage():
            for block in clouds[row].read(fields=frozenset({"labels", "intensity"})):
                has_road |= bool((block.labels == ROAD_SURFACE).any())
                has_intensity |= bool(block.intensity.any())
    if has_road:
        findings.note(folder.name, f"the classification of the points is their label ({ROAD_SURFACE}: road surface).")

    return Recording(
        parts,
        ScanClouds(clouds, frames, has_road),
        frames,
        scan_bytes=sum(cloud.size for cloud in clouds),
        usable=np.flatnonzero(counts <= MAX_SCAN_POINTS),
        point_counts=counts,
        carries_labels=has_road,
        scheme="las" if has_road else None,
        has_remission=has_intensity,
        has_times=clouds[0].has_time,
        carries_poses=False,
        times_s=times_s,
    )


def _pose_file(parts: DriveParts, options: DriveOptions) -> Path:
    if options.poses is not None:
        given = Path(options.poses)
        return given if given.is_absolute() or given.exists() else parts.root / given
    beside = [folder / name for folder in (parts.root, parts.scans) for name in POSE_FILES]
    found = [path for path in beside if path.is_file()]
    return next((path for path in found if looks_like_tum(path)), found[0]) if found else beside[0]
