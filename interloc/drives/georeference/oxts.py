"""OXTS: the GNSS/INS of KITTI, 30 values a frame, in one file a frame or one row a frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.files import list_numbered, listed, missing_numbers, numbers_of, read_text, rows_by_frame, shown
from interloc.drives.findings import GeoreferenceFileError
from interloc.drives.georeference.geodetic import checked_fixes

OXTS_VALUES = 30

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


def raw_offset(raw_drive: Path, sequence: str, frames: IntArray) -> int:
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


def read_oxts_folder(folder: Path, root: Path, frames: IntArray) -> FloatArray:
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
    return checked_fixes(rows, shown(folder, root), frames)


def read_oxts_rows(path: Path, root: Path, frames: IntArray) -> FloatArray:
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
    return checked_fixes(np.array(values), shown(path, root), frames)


def _oxts_values(fields: list[str], path: Path, root: Path, line: int) -> list[float]:
    """Return the 30 numbers of an OXTS row."""
    if len(fields) != OXTS_VALUES:
        raise GeoreferenceFileError(
            shown(path, root),
            f"line {line}: {len(fields)} values; expected {OXTS_VALUES} (lat lon alt roll pitch yaw ...). "
            "Usual cause: timestamps or poses under this name.",
        )
    return numbers_of(fields, path, root, line)
