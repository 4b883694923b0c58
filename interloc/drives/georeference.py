"""Georeference of the LiDAR at every scan: OXTS (GNSS/INS of KITTI) or geo.csv."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from interloc.drives.calibration import KITTI_T_VELO_IMU, find_imu_calibration, read_imu_calibration
from interloc.drives.drive import Georeference
from interloc.drives.faults import GeoreferenceFileError
from interloc.drives.files import shown
from interloc.drives.geo_csv import read_geo_csv
from interloc.drives.oxts import raw_offset, read_oxts_folder, read_oxts_rows
from interloc.drives.parts import DriveParts
from interloc.errors import DriveError
from interloc.geometry import invert_transform, lonlat_from_enu, rotation_from_rpy

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


_log = logging.getLogger(__name__)


def read_georeference(parts: DriveParts, frames: Integers, given: Path | None) -> Georeference | None:
    """Read the georeference of a drive.

    Parameters
    ----------
    parts : DriveParts
    frames : (N,) int64
        Scan numbers.
    given : Path or None
        A georeference from elsewhere (file with a row a frame, KITTI raw drive, geo.csv); it comes first.

    Returns
    -------
    Georeference or None
        None where the drive has none.

    Raises
    ------
    GeoreferenceError
        It is damaged, has no fix for a scan, or belongs to another sequence.
    """
    try:
        if given is not None:
            return _read_given(given, parts, frames)
        if parts.geo is not None:
            return read_geo_csv(parts.geo, parts.root, frames)
        if parts.oxts is not None:
            rows = read_oxts_folder(_data_folder(parts.oxts), parts.root, frames)
            return georeference_of_lidar(rows, _lever_arm(parts), shown(_data_folder(parts.oxts), parts.root))
    except GeoreferenceFileError:
        raise
    except DriveError as error:
        path, message = error.args if len(error.args) == 2 else ("", str(error))
        raise GeoreferenceFileError(path, message) from error
    return None


def _read_given(given: Path, parts: DriveParts, frames: Integers) -> Georeference:
    """Read a georeference that was named by the user."""
    name = shown(given, parts.root)
    if not given.exists():
        raise GeoreferenceFileError(
            name, "does not exist. Expected a KITTI raw drive, a file of OXTS rows, or a geo.csv."
        )
    if given.is_dir():
        if (given / "geo.csv").is_file() and not (given / "oxts").exists():
            return read_geo_csv(given / "geo.csv", parts.root, frames)
        folder = _data_folder(given / "oxts" if (given / "oxts").is_dir() else given)
        rows = read_oxts_folder(folder, parts.root, frames + raw_offset(given, parts.root.name, frames))
        return georeference_of_lidar(rows, _lever_arm(parts, given), shown(folder, parts.root))
    if given.name.endswith((".csv", ".csv.gz")):
        return read_geo_csv(given, parts.root, frames)
    rows = read_oxts_rows(given, parts.root, frames)
    return georeference_of_lidar(rows, _lever_arm(parts, given.absolute().parent), name)


def _data_folder(folder: Path) -> Path:
    """Return the folder of OXTS files in oxts/ (itself, or its data/)."""
    return folder / "data" if (folder / "data").is_dir() else folder


def _lever_arm(parts: DriveParts, given: Path | None = None) -> tuple[Array, str]:
    """Return T_lidar_imu and where it came from."""
    folders = () if given is None else (given, given.absolute().parent)
    for folder in folders:
        if (path := folder / "calib_imu_to_velo.txt").is_file():
            return read_imu_calibration(path, parts.root), f"lever arm of {shown(path, parts.root)}"
    found = find_imu_calibration(parts)
    if found is not None:
        return found[1], f"lever arm of {shown(found[0], parts.root)}"
    _log.info("%s: no calib_imu_to_velo.txt; the lever arm that KITTI publishes is used", parts.root.name)
    return KITTI_T_VELO_IMU, "lever arm as published by KITTI"


def georeference_of_lidar(rows: Array, lever_arm: tuple[Array, str], name: str) -> Georeference:
    """Move fixes of the IMU to the LiDAR.

    Parameters
    ----------
    rows : (N, 30) float64
        OXTS: latitude, longitude in degrees, altitude in metres, roll, pitch, yaw of the IMU in radians, ...
    lever_arm : tuple of (4, 4) float64 and str
        T_lidar_imu and where it came from.
    name : str
        Source of the rows.
    """
    T_lidar_imu, arm_source = lever_arm
    T_imu_lidar = invert_transform(T_lidar_imu)
    R_enu_imu = rotation_from_rpy(rows[:, 3], rows[:, 4], rows[:, 5])
    offset = R_enu_imu @ T_imu_lidar[:3, 3]
    lonlat = lonlat_from_enu(rows[:, 0], rows[:, 1], offset[:, :2])
    return Georeference(
        lat_deg=lonlat[:, 1].copy(),
        lon_deg=lonlat[:, 0].copy(),
        alt_m=rows[:, 2] + offset[:, 2],
        R_enu_lidar=R_enu_imu @ T_imu_lidar[:3, :3],
        source=f"{name}, {arm_source}",
    )
