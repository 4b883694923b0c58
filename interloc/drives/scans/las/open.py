"""LAS and LAZ files as drives: which there are, whether they are one per scan, and reading of those that are.

Files of one scan each are in the coordinates of the sensor; everything else is mobile mapping (`mapping`).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.layouts import ENDINGS, POSE_FILES, SCAN_FOLDERS, DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.poses.files import looks_like_tum
from interloc.drives.scans.deskewed import point_times
from interloc.drives.scans.las.clouds import ROAD_SURFACE, Cloud, Points, all_of, open_cloud
from interloc.drives.scans.las.mapping import MAX_SCAN_POINTS, open_mapping
from interloc.drives.scans.las.tracks import find_tracks, is_table
from interloc.drives.scans.pcd import number_scans
from interloc.drives.scans.recorded import Recording, ScanPoints

SENSOR_RANGE_M = 1000.0
"""No LiDAR of a vehicle sees further; coordinates beyond are those of a map."""

_FOLDERS = (".", "las", "laz")
_MAX_FILES = 100_000
_SAMPLED = 5


def open_las(root: Path, options: DriveOptions, findings: Findings) -> Recording | None:
    """Open LAS or LAZ files: one per scan in sensor coordinates, or a cloud of mobile mapping with its trajectory.

    The root is one file, or a folder that holds such: directly, or in las/ or laz/. None where these are no LAS files.
    """
    other = any((root / folder).is_dir() for folder in SCAN_FOLDERS)  # a map may lie beside the scans
    if options.layout != "las" and (options.layout != "auto" or other):
        return None
    folder, paths = root.absolute().parent, [root.absolute()]
    if not root.is_file():
        places = [place for place in (root / each for each in _FOLDERS) if place.is_dir()]
        found = ((place, sorted(path for path in place.iterdir() if _is_las(path))) for place in places)
        folder, paths = next(((place, files) for place, files in found if files), (root, []))
    elif not _is_las(root):
        return None
    if not paths:
        return None
    if len(paths) > _MAX_FILES:
        raise DriveFileError(str(folder), f"holds {len(paths):,} LAS files; at most {_MAX_FILES:,} are read.")
    home = folder if root.is_file() else root
    name = options.name or (root.stem if root.is_file() else "")
    parts = replace(DriveParts.inside("las", home, folder, None), name=name)
    clouds = tuple(open_cloud(SourceFile(path, home)) for path in paths)
    if _is_one_per_scan(clouds, parts, options):
        return _open_scan_clouds(clouds, parts, options, findings)
    return open_mapping(clouds, parts, options, findings)


def _is_las(path: Path) -> bool:
    return path.suffix.lower() in ENDINGS["las"] and not path.name.startswith(".") and path.is_file()


def _is_one_per_scan(clouds: tuple[Cloud, ...], parts: DriveParts, options: DriveOptions) -> bool:
    """Return whether files hold one scan each: around the origin, with poses, not with the trajectory of a map."""
    if options.crs is not None or any(cloud.reach >= SENSOR_RANGE_M for cloud in clouds):
        return False
    path = _pose_file(parts, options)
    if not path.is_file():
        return len(clouds) > 1 and not (clouds[0].has_time and find_tracks([parts.root, parts.scans]))
    if len(clouds) > 1:
        return not is_table(path)
    return len(SourceFile(path, parts.root).head()[:4096].split()) in {8, 12, 13, 16, 17}


def _pose_file(parts: DriveParts, options: DriveOptions) -> Path:
    if options.poses is not None:
        given = Path(options.poses)
        return given if given.is_absolute() or given.exists() else parts.root / given
    beside = [folder / name for folder in (parts.root, parts.scans) for name in POSE_FILES]
    found = [path for path in beside if path.is_file()]
    return next((path for path in found if looks_like_tum(path)), found[0]) if found else beside[0]


def _open_scan_clouds(
    clouds: tuple[Cloud, ...], parts: DriveParts, options: DriveOptions, findings: Findings
) -> Recording:
    """Open the files of the scans, in the order of the numbers in their names."""
    folder = all_of(clouds)
    order, frames, times_s, how = number_scans([f"{cloud.file.path.stem}.pcd" for cloud in clouds])
    if how:
        findings.note(folder.name, how)
    clouds = tuple(clouds[row] for row in order)
    counts = np.array([cloud.points for cloud in clouds])
    usable = np.flatnonzero(counts <= MAX_SCAN_POINTS)
    for row in np.flatnonzero(counts > MAX_SCAN_POINTS):
        findings.error(
            clouds[row].file.fault(
                f"holds {counts[row]:,} points; a scan has at most {MAX_SCAN_POINTS:,}. "
                "Expected one file per scan. Usual cause: a map, or the whole drive in one file."
            )
        )
    has_road, has_intensity = False, False
    for row in np.intersect1d(np.linspace(0, len(clouds) - 1, _SAMPLED).astype(int), usable):
        with findings.stage():
            for points in clouds[row].read():
                has_road |= bool((points.labels == ROAD_SURFACE).any())
                has_intensity |= bool(points.intensity.any())
    if has_road:
        findings.note(folder.name, f"the classification of the points is their label ({ROAD_SURFACE}: road surface).")
    return Recording(
        replace(parts, poses=_pose_file(parts, options)),
        ScanClouds(clouds, frames, has_road),
        frames,
        scan_bytes=sum(cloud.size for cloud in clouds),
        usable=usable,
        point_counts=counts,
        carries_labels=has_road,
        scheme="las" if has_road else None,
        has_remission=has_intensity,
        has_times=clouds[0].has_time,
        carries_poses=False,
        times_s=times_s,
    )


@dataclass(frozen=True)
class ScanClouds:
    """One LAS file per scan; a `PointSource`."""

    clouds: tuple[Cloud, ...]
    """In the order of the scans."""
    frames: IntArray
    """(N,) int64: their scan numbers, ascending."""
    carries_labels: bool

    def _cloud(self, frame: int) -> Cloud:
        return self.clouds[int(np.searchsorted(self.frames, frame))]

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self._cloud(frame).file.name

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the file of a scan."""
        return (self._cloud(frame).file.path,)

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan; points that are marked as withheld stay in their place, with label 0."""
        cloud = self._cloud(frame)
        points = Points(*map(np.concatenate, zip(*cloud.read(), strict=True)))
        values = np.column_stack([points.xyz, points.intensity]).astype(np.float32)
        labels = np.where(points.withheld, 0, points.labels).astype(np.uint32) if self.carries_labels else None
        return ScanPoints(values, labels, point_times(points.times_s) if cloud.has_time else None)
