"""Which row of a file without frame numbers belongs to which scan."""

from __future__ import annotations

import numpy as np

from interloc.arrays import IntArray


def rows_by_frame(frames: IntArray, rows: int) -> IntArray | None:
    """Map scans to rows by the frame number, or one to one where a drive starts later and has a row a scan.

    Parameters
    ----------
    frames : (N,) int64
        Scan numbers, ascending.
    rows : int
        Rows of the file.

    Returns
    -------
    (N,) int64 or None
        Row of every scan; None where there are too few.
    """
    if frames[-1] < rows:
        return frames
    if rows == len(frames) and frames[-1] - frames[0] == rows - 1:
        return np.arange(rows, dtype=np.int64)
    return None


def gaps(frames: IntArray) -> IntArray:
    """Return the numbers missing between the first and the last scan (of the first thousand gaps, to be shown)."""
    breaks = np.flatnonzero(np.diff(frames) > 1)[:1000]
    missing = [np.arange(frames[i] + 1, min(frames[i + 1], frames[i] + 1001)) for i in breaks]
    return np.concatenate(missing) if missing else np.empty(0, dtype=np.int64)
