"""Georeference of the LiDAR at every scan: OXTS (GNSS/INS of KITTI) or geo.csv."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from interloc.arrays import IntArray
from interloc.drive import Georeference
from interloc.drives.files import GeoreferenceFile
from interloc.drives.findings import Findings
from interloc.drives.georeference.geo_csv import read_geo_csv
from interloc.drives.georeference.oxts import (
    georeference_of_lidar,
    raw_drive_of,
    raw_offset,
    read_oxts_folder,
    read_oxts_rows,
)
from interloc.drives.georeference.timestamps import rows_in_time
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.calibration import (
    IMU_CALIBRATION,
    KITTI_T_VELO_IMU,
    find_kitti360_imu,
    locate_calibration,
    read_rt,
)

AS_PUBLISHED = "lever arm as published by KITTI"
"""Of a georeference without a calib_imu_to_velo.txt."""


@dataclass(frozen=True)
class GeoreferenceFiles:
    """Where a georeference lies on disk."""

    kind: Literal["geo", "folder", "rows"]
    """{"geo", "folder", "rows"}: a geo.csv, a folder with one OXTS file per frame, or a file with one OXTS row per
    frame."""
    path: Path
    rows: IntArray | None = None
    """(N,) int64 or None: number of the OXTS file of each scan, where there is a folder of them."""
    odd: str = ""
    """What is odd about the times of these files, in words."""
    imu_calibration: Path | None = None
    """The calib_imu_to_velo.txt that goes with OXTS."""


def locate_georeference(parts: DriveParts, frames: IntArray, given: Path | None) -> GeoreferenceFiles | None:
    """Find the files of the georeference of a drive, without reading them.

    Parameters
    ----------
    parts : DriveParts
    frames : (N,) int64
        Scan numbers.
    given : Path or None
        A georeference from elsewhere (file with one row per frame, KITTI raw drive, geo.csv); it comes first.

    Returns
    -------
    GeoreferenceFiles or None
        None where the drive has none.

    Raises
    ------
    GeoreferenceError
        The given one does not exist, or belongs to another sequence.
    """
    if given is not None:
        return _locate_given(given, parts, frames)
    if parts.geo is not None:
        return GeoreferenceFiles("geo", parts.geo)
    if parts.oxts is None:
        return None
    imu = locate_calibration(parts, IMU_CALIBRATION)
    if parts.oxts.is_file():
        return GeoreferenceFiles("rows", parts.oxts, imu_calibration=imu)
    folder = _data_folder(parts.oxts)
    rows, odd = rows_in_time(folder, parts, frames)
    return GeoreferenceFiles("folder", folder, rows, odd, imu)


def read_georeference(
    parts: DriveParts, frames: IntArray, given: Path | None, findings: Findings | None = None
) -> Georeference | None:
    """Read the georeference of a drive; parameters as of `locate_georeference`.

    Raises
    ------
    GeoreferenceError
        It is damaged, has no fix for a scan, or belongs to another sequence.
    """
    files = locate_georeference(parts, frames, given)
    if files is None:
        return None
    file = GeoreferenceFile(files.path, parts.root)
    if files.kind == "geo":
        return read_geo_csv(file, frames)
    if files.odd and findings is not None:
        findings.warning("oxts", files.odd)
    rows = read_oxts_rows(file, frames) if files.rows is None else read_oxts_folder(file, files.rows)
    if files.imu_calibration is None and (T_lidar_imu := find_kitti360_imu(parts)) is not None:
        return georeference_of_lidar(rows, T_lidar_imu, f"{file.name}, lever arm of calib_cam_to_pose.txt")
    if files.imu_calibration is None:
        return georeference_of_lidar(rows, KITTI_T_VELO_IMU, f"{file.name}, {AS_PUBLISHED}")
    calibration = GeoreferenceFile(files.imu_calibration, parts.root)
    return georeference_of_lidar(rows, read_rt(calibration), f"{file.name}, lever arm of {calibration.name}")


def _locate_given(given: Path, parts: DriveParts, frames: IntArray) -> GeoreferenceFiles:
    if not given.exists():
        raise GeoreferenceFile(given, parts.root).fault(
            "does not exist. Expected a KITTI raw drive, a file of OXTS rows, or a geo.csv."
        )
    if given.is_dir():
        if (given / "geo.csv").is_file() and not (given / "oxts").exists():
            return GeoreferenceFiles("geo", given / "geo.csv")
        given = _raw_drive_in(given, parts)
        folder = _data_folder(given / "oxts" if (given / "oxts").is_dir() else given)
        first = raw_offset(given, parts.drive_name, frames)
        return GeoreferenceFiles("folder", folder, frames + first, imu_calibration=_imu_calibration_near(given, parts))
    if given.name.endswith((".csv", ".csv.gz")):
        return GeoreferenceFiles("geo", given)
    near = given.absolute().parent
    return GeoreferenceFiles("rows", given, imu_calibration=_imu_calibration_near(near, parts))


def _raw_drive_in(given: Path, parts: DriveParts) -> Path:
    """Return the KITTI raw drive that is meant by the folder of a day, which holds several; else the folder itself.

    Raises
    ------
    GeoreferenceError
        The folder holds several drives, and none is known to be that of the sequence.
    """
    drives = sorted(folder for folder in given.iterdir() if (folder / "oxts").is_dir())
    if (given / "oxts").is_dir() or (given / "data").is_dir() or not drives:
        return given
    wanted = raw_drive_of(parts.drive_name)
    chosen = drives if len(drives) == 1 else [folder for folder in drives if wanted and wanted in folder.name]
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join(folder.name for folder in drives[:5])
    raise GeoreferenceFile(given, parts.root).fault(
        f"holds {len(drives)} raw drives ({names}{', ...' if len(drives) > 5 else ''}): give one of them"
        + (f"; that of {parts.drive_name} is {wanted}." if wanted else ".")
    )


def _imu_calibration_near(folder: Path, parts: DriveParts) -> Path | None:
    """Return the calibration beside a georeference from elsewhere, or else that of the drive."""
    beside = (folder / IMU_CALIBRATION, folder.absolute().parent / IMU_CALIBRATION)
    return next((path for path in beside if path.is_file()), None) or locate_calibration(parts, IMU_CALIBRATION)


def _data_folder(folder: Path) -> Path:
    """Return the folder of OXTS files in oxts/ (itself, or its data/)."""
    return folder / "data" if (folder / "data").is_dir() else folder
