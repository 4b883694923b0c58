"""The times of scans and of OXTS, each in a timestamps.txt (KITTI raw): rows of one number are of one time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.clocks import known_shift
from interloc.drives.files import SourceFile, rows_by_frame, seconds_of
from interloc.drives.layouts import DriveParts
from interloc.errors import InterLocError

_TOGETHER = 0.5
"""Of the time from scan to scan: so far apart the two may be, and the row of the next scan is not nearer."""

_EPOCH_S = 1e8
_STEADY_S = 0.05
_MOST = 0.9


def rows_in_time(oxts: Path, parts: DriveParts, frames: IntArray) -> tuple[IntArray, str]:
    """Choose the row of OXTS for each scan: that of the same number, or the nearest in time where they disagree.

    Parameters
    ----------
    oxts : Path
        Folder of the rows, beside their timestamps.txt.
    frames : (N,) int64

    Returns
    -------
    rows : (N,) int64
    why : str
        What is odd about the times; empty where they agree, or where one of the two is not known.
    """
    theirs = parts.times is not None and parts.times.parent == oxts.parent
    rows_s = None if theirs else _times(oxts.parent / "timestamps.txt")
    scans_s = None if rows_s is None else _times(parts.times)
    if scans_s is None or rows_s is None or len(rows_s) < 2:
        return frames, ""
    at = rows_by_frame(frames, len(scans_s))
    if at is None or len(frames) < 2:
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
