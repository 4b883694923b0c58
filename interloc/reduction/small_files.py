"""The small files of a drive, and where each goes in a reduced one."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import GeoreferenceFile, list_numbered, os_reason
from interloc.drives.findings import DriveFileError
from interloc.drives.georeference.read import locate_georeference
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.calibration import (
    IMU_CALIBRATION,
    locate_camera_calibration,
    locate_camera_to_pose,
    locate_imu_calibration,
)

GEOREFERENCE_FOLDER = "georeference"
"""Where a georeference lies that came from outside of the drive."""


@dataclass
class SmallFileCopies:
    """Which files go where.

    Attributes
    ----------
    files : dict
        Their part of the manifest (`SmallFiles`).
    sources : dict of str to Path
        Path in the reduced drive -> the file as it lies now.
    """

    files: dict[str, Any] = field(default_factory=dict)
    sources: dict[str, Path] = field(default_factory=dict)

    def write_to(self, folder: Path) -> int:
        """Copy them to a reduced drive; those that lie there already stay.

        Returns
        -------
        int
            Bytes of all of them.

        Raises
        ------
        DriveError
            One of them cannot be read.
        """
        size = 0
        for name, source in self.sources.items():
            try:
                data = source.read_bytes()
            except OSError as error:
                raise DriveFileError(str(source), f"cannot be read: {os_reason(error)}.") from error
            target = folder / name
            if target != source:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            size += len(data)
        return size


def gather_small_files(parts: DriveParts, frames: IntArray, given: Path | None) -> SmallFileCopies:
    """Find all files that reading the drive needs besides scans and labels.

    Those inside the drive keep their paths. Of a KITTI raw drive that was given as georeference, the OXTS files of the
    drive's frames are taken, under the numbers of the drive.

    Parameters
    ----------
    parts : DriveParts
    frames : (N,) int64
        Scan numbers.
    given : Path or None
        A georeference from elsewhere.

    Raises
    ------
    GeoreferenceError, DriveError
        A georeference was given that does not exist, or its folder cannot be read.
    """
    copies = SmallFileCopies()

    def take(path: Path, otherwise: str = "") -> str:
        """Note a file under its path in the drive, or under another name where it lies outside."""
        name = path.relative_to(parts.root).as_posix() if _is_inside(path, parts.root) else otherwise or path.name
        copies.sources[name] = path
        return name

    found = locate_georeference(parts, frames, given)
    imu = locate_imu_calibration(parts) if found is None else found.imu_calibration
    calibrations = []
    if imu is not None:
        beside_given = given is not None and imu != locate_imu_calibration(parts)
        calibrations.append(take(imu, f"{GEOREFERENCE_FOLDER}/{IMU_CALIBRATION}" if beside_given else ""))
    cameras = (locate_camera_calibration(parts), locate_camera_to_pose(parts))
    calibrations += [take(path) for path in cameras if path is not None]

    oxts = geo = None
    if found is not None and found.kind == "folder":
        oxts = _take_folder(copies, found.path, found.first, frames, parts)
    elif found is not None:
        packed = ".gz" if found.path.suffix == ".gz" else ""
        name = "geo.csv" if found.kind == "geo" else "oxts.txt"
        place = take(found.path, f"{GEOREFERENCE_FOLDER}/{name}{packed}")
        oxts, geo = (None, place) if found.kind == "geo" else (place, None)
    copies.files = {
        "poses": None if parts.poses is None else take(parts.poses),
        "times": None if parts.times is None else take(parts.times),
        "calibration": calibrations,
        "oxts": oxts,
        "geo": geo,
    }
    return copies


def _take_folder(copies: SmallFileCopies, folder: Path, first: int, frames: IntArray, parts: DriveParts) -> str:
    """Note the OXTS files of the frames; return their folder in the reduced drive."""
    files = list_numbered(GeoreferenceFile(folder, parts.root), ".txt")
    if _is_inside(folder, parts.root) and first == 0:
        place = folder.relative_to(parts.root).as_posix()
        digits = files.digits
    else:
        place, digits = f"{GEOREFERENCE_FOLDER}/oxts", 10
    for frame in frames[np.isin(frames + first, files.numbers)]:  # a missing fix is the complaint of who reads them
        copies.sources[f"{place}/{int(frame):0{digits}d}.txt"] = files.path(int(frame) + first)
    return place


def _is_inside(path: Path, root: Path) -> bool:
    return path.is_relative_to(root) and ".." not in path.relative_to(root).parts
