"""OXTS: the GNSS/INS of KITTI, 30 values per frame, in one file per frame or one row per frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile, list_numbered, listed, rows_by_frame
from interloc.drives.findings import GeoreferenceFileError
from interloc.drives.georeference.geodetic import checked_fixes
from interloc.geometry import invert_transform, lonlat_from_enu, rotation_from_rpy

OXTS_VALUES = 30

_POS_ACCURACY = 23  # column: standard deviation of the position north and east, metres; 0 where there is none

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


def raw_drive_of(sequence: str) -> str | None:
    """Return the KITTI raw drive of an odometry sequence; None where there is none."""
    return next((raw for raw, (theirs, *_) in ODOMETRY_OF_RAW.items() if theirs == sequence), None)


def raw_offset(raw_drive: Path, sequence: str, frames: IntArray) -> int:
    """Return the raw frame of frame 0 of an odometry sequence, from KITTI's published table.

    Raises
    ------
    GeoreferenceError
        The raw drive belongs to another sequence, or the sequence ends before the last scan.
    """
    found = (re.search(r"\d{4}_\d\d_\d\d_drive_\d{4}", part) for part in reversed(raw_drive.absolute().parts))
    match = next(filter(None, found), None)
    known = ODOMETRY_OF_RAW.get(match.group()) if match else None
    if known is None or match is None:
        return 0
    expected, first, last = known
    if re.fullmatch(r"(0\d|10)", sequence) and sequence != expected:
        theirs = raw_drive_of(sequence)
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


def read_oxts_folder(folder: SourceFile, frames: IntArray) -> FloatArray:
    """Read one OXTS file per frame.

    Returns
    -------
    (N, 30) float64

    Raises
    ------
    GeoreferenceError
        A frame has no file, or a file is damaged.
    """
    files = list_numbered(folder, ".txt")
    missing = np.setdiff1d(frames, files.numbers)
    if len(missing):
        raise folder.fault(
            f"{len(missing):,} of {len(frames):,} scans have no fix: frames {listed(missing)}. "
            "Expected one OXTS file per scan, under the number of the scan. Usual cause: the oxts of another drive."
        )
    rows = np.empty((len(frames), OXTS_VALUES))
    for row, frame in enumerate(frames):
        file = files.file(int(frame))
        rows[row] = _oxts_values(file, file.text().split(), 1)
    return checked_fixes(folder, rows, frames)


def read_oxts_rows(file: SourceFile, frames: IntArray | None = None) -> FloatArray:
    """Read a file with one OXTS row per frame, plain or .gz: the rows of some frames, or all.

    Returns
    -------
    (N, 30) float64

    Raises
    ------
    GeoreferenceError
        It has fewer rows than the drive has frames, or a row is damaged.
    """
    lines = file.lines()
    if frames is None:
        frames = np.arange(len(lines))
    wanted = rows_by_frame(frames, len(lines))
    if wanted is None:
        raise file.fault(
            f"{len(lines):,} rows, but the drive has the frames {frames[0]} to {frames[-1]} ({len(frames):,} scans). "
            "Expected one row per frame, the first for frame 0. Usual cause: the rows of another sequence."
        )
    values = [_oxts_values(file, lines[row].split(), int(row) + 1) for row in wanted]
    return checked_fixes(file, np.array(values), frames)


def _oxts_values(file: SourceFile, fields: list[str], line: int) -> list[float]:
    if len(fields) != OXTS_VALUES:
        raise file.fault(
            f"{len(fields)} values; expected {OXTS_VALUES} (lat lon alt roll pitch yaw ...). "
            "Usual cause: timestamps or poses under this name.",
            line,
        )
    return file.numbers(fields, line)


def georeference_of_lidar(rows: FloatArray, T_lidar_imu: FloatArray, source: str) -> Georeference:
    """Move fixes of the IMU to the LiDAR.

    Parameters
    ----------
    rows : (N, 30) float64
        OXTS: latitude, longitude in degrees, altitude in metres, roll, pitch, yaw of the IMU in radians, ...
    T_lidar_imu : (4, 4) float64
        Its lever arm.
    source : str
        Where both came from, in words.
    """
    T_imu_lidar = invert_transform(T_lidar_imu)
    R_enu_imu = rotation_from_rpy(rows[:, 3], rows[:, 4], rows[:, 5])
    offset = R_enu_imu @ T_imu_lidar[:3, 3]
    lonlat = lonlat_from_enu(rows[:, 0], rows[:, 1], offset[:, :2])
    accuracy = rows[:, _POS_ACCURACY]
    return Georeference(
        lat_deg=lonlat[:, 1].copy(),
        lon_deg=lonlat[:, 0].copy(),
        alt_m=rows[:, 2] + offset[:, 2],
        R_enu_lidar=R_enu_imu @ T_imu_lidar[:3, :3],
        source=source,
        position_std_m=np.where(accuracy > 0, accuracy, np.nan),
    )
