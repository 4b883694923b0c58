"""Georeference of the LiDAR at every scan: OXTS (GNSS/INS of KITTI) or geo.csv."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from interloc.drives.calibration import KITTI_T_VELO_IMU, find_imu_calibration, read_imu_calibration
from interloc.drives.drive import Georeference
from interloc.drives.faults import GeoreferenceFileError
from interloc.drives.files import list_numbered, listed, missing_numbers, numbers_of, read_text, shown
from interloc.drives.parts import DriveParts
from interloc.drives.rows import rows_by_frame
from interloc.errors import DriveError
from interloc.geometry import WGS84_A_M, WGS84_E2, invert_transform, lonlat_from_enu, rotation_from_rpy

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

OXTS_VALUES = 30
GEO_COLUMNS = ("frame", "lat_deg", "lon_deg", "alt_m", "roll_rad", "pitch_rad", "yaw_rad")

ODOMETRY_OF_RAW = {
    "2011_10_03_drive_0027": ("00", 0, 4540),
    "2011_10_03_drive_0042": ("01", 0, 1100),
    "2011_10_03_drive_0034": ("02", 0, 4660),
    "2011_09_30_drive_0016": ("04", 0, 270),
    "2011_09_30_drive_0018": ("05", 0, 2760),
    "2011_09_30_drive_0020": ("06", 0, 1100),
    "2011_09_30_drive_0027": ("07", 0, 1100),
    "2011_09_30_drive_0028": ("08", 1100, 5170),
    "2011_09_30_drive_0033": ("09", 0, 1590),
    "2011_09_30_drive_0034": ("10", 0, 1200),
}
"""KITTI raw drive -> odometry sequence, first and last raw frame (devkit of the odometry benchmark; 03: none)."""

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
            return _of_lidar(rows, _lever_arm(parts), shown(_data_folder(parts.oxts), parts.root))
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
        return _of_lidar(rows, _lever_arm(parts, given), shown(folder, parts.root))
    if given.name.endswith((".csv", ".csv.gz")):
        return read_geo_csv(given, parts.root, frames)
    rows = read_oxts_rows(given, parts.root, frames)
    return _of_lidar(rows, _lever_arm(parts, given.absolute().parent), name)


def raw_offset(raw_drive: Path, sequence: str, frames: Integers) -> int:
    """Return the raw frame of frame 0 of an odometry sequence, from KITTI's published table.

    Raises
    ------
    GeoreferenceError
        The raw drive belongs to another sequence, or the sequence ends before the last scan.
    """
    names = [part for part in reversed(raw_drive.absolute().parts) if re.search(r"\d{4}_\d\d_\d\d_drive_\d{4}", part)]
    match = re.search(r"\d{4}_\d\d_\d\d_drive_\d{4}", names[0]) if names else None
    known = ODOMETRY_OF_RAW.get(match.group()) if match else None
    if known is None or match is None:
        return 0
    expected, first, last = known
    if re.fullmatch(r"(0\d|10)", sequence) and sequence != expected:
        theirs = next((raw for raw, (seq, *_) in ODOMETRY_OF_RAW.items() if seq == sequence), None)
        right = (
            f"the raw drive of {sequence} is {theirs}" if theirs else f"the raw drive of {sequence} was never published"
        )
        raise GeoreferenceFileError(
            str(raw_drive), f"is the raw drive of odometry sequence {expected}, not of {sequence}; {right}."
        )
    if sequence != expected:
        return 0
    if frames[-1] > last - first:
        raise GeoreferenceFileError(
            str(raw_drive),
            f"sequence {expected} has the frames 0 to {last - first}, but the drive has frame {frames[-1]}.",
        )
    return first


def _data_folder(folder: Path) -> Path:
    """Return the folder of OXTS files in oxts/ (itself, or its data/)."""
    return folder / "data" if (folder / "data").is_dir() else folder


def read_oxts_folder(folder: Path, root: Path, frames: Integers) -> Array:
    """Read one OXTS file a frame.

    Returns
    -------
    (N, 30) float64

    Raises
    ------
    DriveError
        A frame has no file, or a file is damaged.
    """
    files = list_numbered(folder, ".txt", root)
    missing = missing_numbers(files.numbers, frames)
    if len(missing):
        raise GeoreferenceFileError(
            shown(folder, root),
            f"{len(missing):,} of {len(frames):,} scans have no fix: frames {listed(missing)}. "
            "Expected one OXTS file a scan, under the number of the scan. Usual cause: the oxts of another drive.",
        )
    rows = np.empty((len(frames), OXTS_VALUES))
    for row, frame in enumerate(frames):
        path = files.path(int(frame))
        rows[row] = _oxts_values(read_text(path, root).split(), path, root, 1)
    return _checked(rows, shown(folder, root), frames)


def read_oxts_rows(path: Path, root: Path, frames: Integers) -> Array:
    """Read a file with one OXTS row a frame, plain or .gz.

    Returns
    -------
    (N, 30) float64

    Raises
    ------
    DriveError
        It has fewer rows than the drive has frames, or a row is damaged.
    """
    lines = read_text(path, root).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    wanted = rows_by_frame(frames, len(lines))
    if wanted is None:
        raise GeoreferenceFileError(
            shown(path, root),
            f"{len(lines):,} rows, but the drive has the frames {frames[0]} to {frames[-1]} ({len(frames):,} scans). "
            "Expected one row a frame, the first for frame 0. Usual cause: the rows of another sequence.",
        )
    values = [_oxts_values(lines[row].split(), path, root, int(row) + 1) for row in wanted]
    return _checked(np.array(values), shown(path, root), frames)


def _oxts_values(fields: list[str], path: Path, root: Path, line: int) -> list[float]:
    """Return the 30 numbers of an OXTS row."""
    if len(fields) != OXTS_VALUES:
        raise GeoreferenceFileError(
            shown(path, root),
            f"line {line}: {len(fields)} values; expected {OXTS_VALUES} (lat lon alt roll pitch yaw ...). "
            "Usual cause: timestamps or poses under this name.",
        )
    return numbers_of(fields, path, root, line)


def read_geo_csv(path: Path, root: Path, frames: Integers) -> Georeference:
    """Read a geo.csv: frame, position and attitude of the LiDAR itself.

    Raises
    ------
    DriveError
        Its columns are others, a row is damaged, or a scan has none.
    """
    name = shown(path, root)
    lines = read_text(path, root).splitlines()
    header = tuple(column.strip() for column in lines[0].split(","))
    missing_columns = [column for column in GEO_COLUMNS if column not in header]
    if missing_columns:
        raise GeoreferenceFileError(
            name, f"line 1: no column {', '.join(missing_columns)}. Expected the header {','.join(GEO_COLUMNS)}."
        )
    columns = [header.index(column) for column in GEO_COLUMNS]
    rows = []
    for number, text in enumerate(lines[1:], start=2):
        if not text.strip():
            continue
        fields = text.split(",")
        if len(fields) != len(header):
            raise GeoreferenceFileError(
                name, f"line {number}: {len(fields)} fields; expected {len(header)} as in the header."
            )
        rows.append(numbers_of([fields[column] for column in columns], path, root, number))
    if not rows:
        raise GeoreferenceFileError(name, "holds a header only. Expected one row a scan.")
    values = np.array(rows)
    numbers, first = np.unique(values[:, 0].astype(np.int64), return_index=True)
    missing = missing_numbers(numbers, frames)
    if len(missing):
        raise GeoreferenceFileError(
            name,
            f"{len(missing):,} of {len(frames):,} scans have no row: frames {listed(missing)}. Expected one a scan.",
        )
    chosen = values[first[np.searchsorted(numbers, frames)]]
    poses = _checked(chosen[:, 1:], name, frames)
    return Georeference(
        lat_deg=poses[:, 0].copy(),
        lon_deg=poses[:, 1].copy(),
        alt_m=poses[:, 2].copy(),
        R_enu_lidar=rotation_from_rpy(poses[:, 3], poses[:, 4], poses[:, 5]),
        source=f"{name} (poses of the LiDAR)",
    )


def _checked(rows: Array, name: str, frames: Integers) -> Array:
    """Refuse positions that are none on Earth, and angles in degrees."""
    lat, lon, alt, angles = np.abs(rows[:, 0]), np.abs(rows[:, 1]), np.abs(rows[:, 2]), np.abs(rows[:, 3:6])
    off = (lat > 89) | (lon > 360) | (alt > 20_000)
    if off.any():
        row = int(np.argmax(off))
        raise GeoreferenceFileError(
            name,
            f"frame {frames[row]}: latitude {rows[row, 0]:g}, longitude {rows[row, 1]:g}, altitude {rows[row, 2]:g} "
            "is no place to drive. Expected degrees and metres. Usual cause: projected coordinates.",
        )
    if ((lat == 0) & (lon == 0)).any():
        row = int(np.argmax((lat == 0) & (lon == 0)))
        raise GeoreferenceFileError(
            name, f"frame {frames[row]}: latitude and longitude are 0: the receiver had no fix."
        )
    if (angles > 2 * np.pi).any():
        row = int(np.argmax((angles > 2 * np.pi).any(axis=1)))
        raise GeoreferenceFileError(
            name, f"frame {frames[row]}: an angle of {angles[row].max():g}. Expected radians. Usual cause: degrees."
        )
    return rows


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


def _of_lidar(rows: Array, lever_arm: tuple[Array, str], name: str) -> Georeference:
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


def poses_of(georeference: Georeference) -> Array:
    """Return (N, 4, 4) T_world_lidar of a georeference, exact on the ellipsoid; W is the LiDAR at the first fix."""
    T_ecef_lidar = ecef_poses(georeference)
    relative: Array = invert_transform(T_ecef_lidar[0]) @ T_ecef_lidar
    return relative


def ecef_poses(georeference: Georeference) -> Array:
    """Return (N, 4, 4) poses of the LiDAR in the earth-centred, earth-fixed frame of WGS84, metres."""
    lat, lon = np.radians(georeference.lat_deg), np.radians(georeference.lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    prime_vertical = WGS84_A_M / np.sqrt(1 - WGS84_E2 * sin_lat**2)
    height = prime_vertical + georeference.alt_m
    poses = np.zeros((len(lat), 4, 4))
    poses[:, 0, 3] = height * cos_lat * cos_lon
    poses[:, 1, 3] = height * cos_lat * sin_lon
    poses[:, 2, 3] = (height - WGS84_E2 * prime_vertical) * sin_lat
    poses[:, 3, 3] = 1
    zero = np.zeros_like(lat)
    east = np.stack([-sin_lon, cos_lon, zero], axis=1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=1)
    poses[:, :3, :3] = np.stack([east, north, up], axis=2) @ georeference.R_enu_lidar
    return poses
