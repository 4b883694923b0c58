"""Georeference of the LiDAR at every scan: OXTS (GNSS/INS of KITTI), geo.csv, or the world of KITTI-360's poses."""

import math
import re
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import GeoreferenceFile, SourceFile, list_numbered, rows_by_frame, seconds_of
from interloc.drives.findings import Findings, GeoreferenceFileError
from interloc.drives.georeference.fixes import known_shift
from interloc.drives.georeference.geodetic import checked_fixes
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.frame import (
    IMU_CALIBRATION,
    KITTI_T_VELO_IMU,
    find_kitti360_imu,
    locate_calibration,
    read_rt,
)
from interloc.errors import InterLocError
from interloc.files import write_file
from interloc.geometry import WGS84_A_M, invert_transform, lonlat_from_enu, rotation_from_rpy, rpy_from_rotation
from interloc.wording import listed

AS_PUBLISHED = "lever arm as published by KITTI"
"""Of a georeference without a calib_imu_to_velo.txt."""

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

_TOGETHER = 0.5
"""Of the time from scan to scan: so far apart the two may be, and the row of the next scan is not nearer."""

_EPOCH_S = 1e8
_STEADY_S = 0.05
_MOST = 0.9

GEO_COLUMNS = ("frame", "lat_deg", "lon_deg", "alt_m", "roll_rad", "pitch_rad", "yaw_rad")

STD_COLUMN = "position_std_m"
"""Optional: one-sigma uncertainty of the position along each horizontal axis, metres; empty where it is unknown."""

_DIGITS = (".9f", ".9f", ".3f", ".6f", ".6f", ".6f")
_STD_DIGITS = ".4f"

ORIGIN_LAT_DEG, ORIGIN_LON_DEG = 48.9843445, 8.4295857
"""Where the x and y of its poses are 0, and the projection has scale 1 (devkit of KITTI-360)."""

MIN_ALT_M, MAX_ALT_M = 50.0, 400.0
"""Bounds of the median height of a drive in that world, generous: it was driven at 100 to 250 m."""


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
    """Find the files of the georeference of a drive, without reading them; None where it has none.

    The given one comes first: a file with one row per frame, a KITTI raw drive, or a geo.csv.
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
    """Read the georeference of a drive; parameters as of `locate_georeference`."""
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
        if not any((given / name).is_dir() for name in ("oxts", "data")) and any(given.glob("*/oxts")):
            wanted = raw_drive_of(parts.drive_name)
            raise GeoreferenceFile(given, parts.root).fault(
                f"holds raw drives: give one of them{f' ({wanted})' if wanted else ''}."
            )
        folder = _data_folder(given / "oxts" if (given / "oxts").is_dir() else given)
        first = raw_offset(given, parts.drive_name, frames)
        return GeoreferenceFiles("folder", folder, frames + first, imu_calibration=_imu_calibration_near(given, parts))
    if given.name.endswith((".csv", ".csv.gz")):
        return GeoreferenceFiles("geo", given)
    near = given.absolute().parent
    return GeoreferenceFiles("rows", given, imu_calibration=_imu_calibration_near(near, parts))


def _imu_calibration_near(folder: Path, parts: DriveParts) -> Path | None:
    """Return the calibration beside a georeference from elsewhere, or else that of the drive."""
    beside = (folder / IMU_CALIBRATION, folder.absolute().parent / IMU_CALIBRATION)
    return next((path for path in beside if path.is_file()), None) or locate_calibration(parts, IMU_CALIBRATION)


def _data_folder(folder: Path) -> Path:
    """Return the folder of OXTS files in oxts/ (itself, or its data/)."""
    return folder / "data" if (folder / "data").is_dir() else folder


def raw_drive_of(sequence: str) -> str | None:
    """Return the KITTI raw drive of an odometry sequence; None where there is none."""
    return next((raw for raw, (theirs, *_) in ODOMETRY_OF_RAW.items() if theirs == sequence), None)


def raw_offset(raw_drive: Path, sequence: str, frames: IntArray) -> int:
    """Return the raw frame of frame 0 of an odometry sequence, from KITTI's published table."""
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
    """Read one OXTS file per frame: (N, 30) float64."""
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
    """Read a file with one OXTS row per frame, plain or .gz: (N, 30) float64 of some frames, or of all."""
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
            "Usual cause: timestamps, poses, or positions of another receiver (NMEA, RTKLIB); geo.csv takes these.",
            line,
        )
    return file.numbers(fields, line)


def georeference_of_lidar(rows: FloatArray, T_lidar_imu: FloatArray, source: str) -> Georeference:
    """Move the fixes of the IMU, (N, 30) OXTS rows, to the LiDAR by its lever arm; both came from `source`."""
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


def rows_in_time(oxts: Path, parts: DriveParts, frames: IntArray) -> tuple[IntArray, str]:
    """Choose the row of OXTS for each scan: that of the same number, or the nearest in time where they disagree.

    Returns also what is odd about the times; empty where they agree, or where one of the two is not known.
    """
    theirs = parts.times is not None and parts.times.parent == oxts.parent
    rows_s = None if theirs else _times(oxts.parent / "timestamps.txt")
    scans_s = None if rows_s is None else _times(parts.times)
    if scans_s is None or rows_s is None or len(rows_s) < 2:
        return frames, ""
    at = rows_by_frame(frames, len(scans_s))
    if at is None or len(frames) < 2 or not (oxts / f"{0:010d}.txt").is_file():  # files of a part keep their numbers
        return frames, ""
    scan_s = scans_s[at]
    step_s = float(np.median(np.diff(scan_s) / np.diff(frames)))
    same = frames[frames < len(rows_s)]
    ahead = rows_s[same] - scan_s[: len(same)]
    if len(same) == len(frames) and np.mean(np.abs(ahead) <= _TOGETHER * step_s) >= _MOST:
        return frames, ""
    after = np.clip(np.searchsorted(rows_s, scan_s), 1, len(rows_s) - 1)
    nearest = after - (scan_s - rows_s[after - 1] < rows_s[after] - scan_s)
    if np.mean(np.abs(rows_s[nearest] - scan_s) <= _TOGETHER * step_s) >= _MOST:
        off_s = float(np.max(np.abs(ahead), initial=0.0))
        return nearest.astype(np.int64), (
            f"the rows of OXTS are up to {off_s:.1f} s off the scans of the same number, by the two timestamps.txt: "
            "the rows nearest in time are used. Usual cause: OXTS at another rate (an unsynchronised recording), or "
            "rows that start at another frame."
        )
    middle_s = float(np.median(ahead)) if len(ahead) else float("nan")
    shift = known_shift(middle_s)
    steady = len(ahead) and float(np.median(np.abs(ahead - middle_s))) < _STEADY_S
    usual = shift.why if shift is not None and steady else "the two files are of different drives, or their clocks"
    return frames, (
        f"by the two timestamps.txt, OXTS is {middle_s:+,.1f} s off the scans, and there is no row at their times: "
        f"rows and scans are matched by their numbers. Usual cause: {usual}."
    )


def _times(path: Path | None) -> FloatArray | None:
    """Return the (K,) times of a file, seconds since 1970; None where it is not one of dates in ascending order."""
    if path is None:
        return None
    try:
        lines = SourceFile(path, path.parent).lines()
    except InterLocError:
        return None
    times = np.array([seconds_of(line.strip()) for line in lines])
    is_clock = np.isfinite(times).all() and times[0] > _EPOCH_S and (np.diff(times) >= 0).all()
    return times if is_clock else None


def read_geo_csv(file: GeoreferenceFile, frames: IntArray) -> Georeference:
    """Read a geo.csv: frame, position and attitude of the LiDAR, and if known the uncertainty of the position."""
    lines = file.lines()
    header = tuple(column.strip() for column in lines[0].split(","))
    missing_columns = [column for column in GEO_COLUMNS if column not in header]
    if missing_columns:
        separator = next((name for sign, name in ((";", "semicolons"), ("\t", "tabs")) if sign in lines[0]), None)
        if separator is not None:
            raise file.fault(
                f"its columns are separated by {separator}. Expected commas, and decimals with a point: "
                f"{','.join(GEO_COLUMNS)}. Usual cause: a spreadsheet's export where numbers are written with a comma.",
                1,
            )
        raise file.fault(f"no column {', '.join(missing_columns)}. Expected the header {','.join(GEO_COLUMNS)}.", 1)
    columns = [header.index(column) for column in GEO_COLUMNS]
    std_column = header.index(STD_COLUMN) if STD_COLUMN in header else None
    rows, stds = array("d"), array("d")
    for number, text in enumerate(lines[1:], start=2):
        if not text.strip():
            continue
        fields = text.split(",")
        if len(fields) != len(header):
            raise file.fault(f"{len(fields)} fields; expected {len(header)} as in the header.", number)
        rows.extend(file.numbers([fields[column] for column in columns], number))
        if std_column is not None:
            stds.extend(file.numbers([fields[std_column]], number) if fields[std_column].strip() else [math.nan])
    if not rows:
        raise file.fault("holds a header only. Expected one row per scan.")
    values = np.frombuffer(rows).reshape(-1, len(columns))
    numbers, first, rows_of = np.unique(values[:, 0], return_index=True, return_counts=True)
    if (rows_of > 1).any() or (numbers % 1 != 0).any():
        odd = numbers[(rows_of > 1) | (numbers % 1 != 0)][0]
        raise file.fault(f"frame {odd:.15g} has two rows, or is no whole number. Expected one row per scan.")
    missing = np.setdiff1d(frames, numbers)
    if len(missing):
        raise file.fault(
            f"{len(missing):,} of {len(frames):,} scans have no row: frames {listed(missing)}. Expected one per scan."
        )
    chosen = first[np.searchsorted(numbers, frames)]
    poses = checked_fixes(file, values[chosen, 1:], frames)
    std = None if std_column is None else np.frombuffer(stds)[chosen]
    return Georeference(
        lat_deg=poses[:, 0].copy(),
        lon_deg=poses[:, 1].copy(),
        alt_m=poses[:, 2].copy(),
        R_enu_lidar=rotation_from_rpy(poses[:, 3], poses[:, 4], poses[:, 5]),
        source=f"{file.name} (poses of the LiDAR)",
        position_std_m=None if std is None else np.where(std > 0, std, np.nan),
    )


def geo_csv_text(frames: IntArray, georeference: Georeference, *, exact: bool = False) -> str:
    """Return the text of a geo.csv with one row per scan: all digits (`exact`), or a tenth of a millimetre."""
    columns = (georeference.lat_deg, georeference.lon_deg, georeference.alt_m)
    angles = rpy_from_rotation(georeference.R_enu_lidar)
    stds = [] if georeference.position_std_m is None else georeference.position_std_m.tolist()
    rows = [",".join([*GEO_COLUMNS, *([STD_COLUMN] if stds else [])])]
    for row, (frame, *values) in enumerate(np.column_stack([frames, *columns, angles]).tolist()):
        texts = list(map(repr, values) if exact else map(format, values, _DIGITS))
        if stds:
            std = stds[row]
            texts.append("" if math.isnan(std) else repr(std) if exact else format(std, _STD_DIGITS))
        rows.append(",".join([str(int(frame)), *texts]))
    return "\n".join(rows) + "\n"


def write_geo_csv(path: Path, frames: IntArray, georeference: Georeference) -> None:
    """Write a geo.csv, whole or not at all; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, geo_csv_text(frames, georeference))


def georeference_of_kitti360(T_file_lidar: FloatArray, source: str) -> Georeference:
    """Place (N, 4, 4) poses of the LiDAR in the world of KITTI-360 (x east, y north, z altitude) on the ellipsoid.

    The projection keeps angles, and its y axis looks north everywhere: rotations are those in the local east-north-up
    frame. It is that of a sphere: distances in the file are 0.2 % shorter to the east and 0.1 % longer to the north
    than on the ellipsoid, which adds up to metres within kilometres of the origin, and is undone here.
    """
    scale = np.cos(np.radians(ORIGIN_LAT_DEG)) * WGS84_A_M
    x, y, z = T_file_lidar[:, :3, 3].T
    mercator = np.arcsinh(np.tan(np.radians(ORIGIN_LAT_DEG))) + y / scale
    return Georeference(
        lat_deg=np.degrees(np.arctan(np.sinh(mercator))),
        lon_deg=ORIGIN_LON_DEG + np.degrees(x / scale),
        alt_m=z.copy(),
        R_enu_lidar=T_file_lidar[:, :3, :3].copy(),
        source=source,
    )


def is_karlsruhe(fixes: Georeference) -> bool:
    """Return whether fixes lie at heights where KITTI-360 was driven: poses from the identity do not."""
    return bool(MIN_ALT_M < np.median(fixes.alt_m) < MAX_ALT_M)
