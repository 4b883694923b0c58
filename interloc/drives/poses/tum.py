"""Poses in the format of the TUM RGB-D benchmark: time, position and quaternion, one pose per line.

Its relatives are read too: with commas, with a first line of column names, with times in nanoseconds, or in seconds and
nanoseconds as two columns.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.files import SourceFile, is_number
from interloc.drives.poses.lines import CUT_OFF, read_rows, refuse_far
from interloc.drives.poses.timed import TimedPoses, rotations_from_quaternions
from interloc.geometry import rigid_transforms

TUM_FIELDS = 8
"""Numbers of a line: time x y z qx qy qz qw."""

_SPLIT_FIELDS = 9
"""Numbers of a line of the Newer College data set and others: sec nsec x y z qx qy qz qw."""

_STAMPS_US, _STAMPS_NS = 1e14, 1e17
"""Times from here on are microseconds and nanoseconds, not seconds, since 1970."""

_OFF_UNIT = 1e-2
_HEAD_BYTES = 65536


def looks_like_tum(path: Path) -> bool:
    """Return whether the first line of a file that is neither blank nor a comment holds 8 numbers.

    A file that cannot be read does not: its reader will say why.
    """
    try:
        with path.open("rb") as file:
            return is_tum(file.read(_HEAD_BYTES))
    except OSError:
        return False


def is_tum(head: bytes) -> bool:
    """Return the same of the first bytes of a file."""
    for line in _plain(head.decode("utf-8-sig", errors="replace").splitlines()):
        fields = line.split()
        if fields and not fields[0].startswith("#"):
            split = len(fields) == _SPLIT_FIELDS and "." not in "".join(fields[:2])
            return (len(fields) == TUM_FIELDS or split) and all(map(is_number, fields))
    return False


def _plain(lines: list[str]) -> list[str]:
    """Write lines with spaces instead of commas, and a first line of column names as a comment."""
    lines = [line.replace(",", " ") for line in lines]
    first = next((row for row, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if first is not None and not any(map(is_number, lines[first].split())):
        lines[first] = f"# {lines[first]}"
    return lines


def read_tum(file: SourceFile) -> TimedPoses:
    """Read and check the lines ``time x y z qx qy qz qw`` of a file; lines that start with # are comments.

    Returns
    -------
    TimedPoses
        Times in seconds; poses from the frame of the body into the world of the file, metres.

    Raises
    ------
    DriveError
        The file is missing or unreadable, a line does not hold 8 finite numbers, a position is absurd, a quaternion is
        not of length 1, or times run backwards. A line that is there twice counts once.
    """
    if not file.path.exists():
        raise file.fault("is missing. Expected one line per pose: time x y z qx qy qz qw (TUM).")
    values, lines = read_rows(file, (TUM_FIELDS, _SPLIT_FIELDS), _length_complaint, plain=_plain)
    if values.shape[1] == _SPLIT_FIELDS:
        values = np.column_stack([values[:, 0] + values[:, 1] * 1e-9, values[:, 2:]])
    elif values[0, 0] > _STAMPS_US:
        values = np.column_stack([values[:, 0] * (1e-6 if values[0, 0] < _STAMPS_NS else 1e-9), values[:, 1:]])
    values, lines = _without_repetitions(values, lines, file)
    refuse_far(values[:, 1:4], lines, file)
    norm = np.linalg.norm(values[:, 4:], axis=1)
    wrong = np.abs(norm - 1) > _OFF_UNIT
    if wrong.any():
        row = int(np.argmax(wrong))
        raise file.fault(
            f"the quaternion is {norm[row]:.4g} long; expected 1. Expected time x y z qx qy qz qw. "
            "Usual cause: another order of the columns, or angles instead of a quaternion.",
            lines[row],
        )
    poses = rigid_transforms(rotations_from_quaternions(values[:, 4:]), values[:, 1:4])
    return TimedPoses(values[:, 0].copy(), poses, file.name)


def _without_repetitions(values: FloatArray, lines: IntArray, file: SourceFile) -> tuple[FloatArray, IntArray]:
    """Leave out lines that repeat the one before; refuse times that do not ascend."""
    repeated = (np.diff(values, axis=0) == 0).all(axis=1)
    kept = np.concatenate([[True], ~repeated])
    values, lines = values[kept], lines[kept]
    steps = np.diff(values[:, 0])
    if (steps <= 0).any():
        row = int(np.argmax(steps <= 0)) + 1
        before, after = values[row - 1, 0], values[row, 0]
        what = "has the time of the line before, but another pose" if before == after else "runs backwards in time"
        raise file.fault(
            f"{what} ({before:.6f} s, then {after:.6f} s). Expected ascending times, in seconds. "
            "Usual cause: two recordings in one file, or times written with too few digits.",
            lines[row],
        )
    return values, lines


def _length_complaint(fields: list[str], length: int) -> str:
    """Return what is wrong with the count of numbers in a line (all lines before are of the one length)."""
    usual = CUT_OFF
    if len(fields) in {12, 13, 16, 17} and not length:
        usual = "poses as matrices (KITTI), which are read under their own format"
    return f"{len(fields)} numbers; expected {TUM_FIELDS}: time x y z qx qy qz qw (TUM). Usual cause: {usual}."
