"""Times of the scans: seconds, or date and time."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.faults import Findings
from interloc.drives.files import is_number, read_text, shown
from interloc.drives.parts import DriveParts
from interloc.drives.rows import rows_by_frame


def read_times(parts: DriveParts, frames: IntArray, findings: Findings) -> FloatArray | None:
    """Read the time of every scan, seconds; None where there is none that fits."""
    if parts.times is None:
        return None
    name = shown(parts.times, parts.root)
    lines = [text.strip() for text in read_text(parts.times, parts.root).splitlines() if text.strip()]
    rows = rows_by_frame(frames, len(lines))
    if rows is None:
        findings.warning(name, f"{len(lines):,} times for the scans {frames[0]} to {frames[-1]}; times are not used.")
        return None
    chosen = [lines[row] for row in rows]
    times = np.array([_seconds(text) for text in chosen])
    if not np.isfinite(times).all():
        row = int(np.argmax(~np.isfinite(times)))
        findings.warning(name, f"line {rows[row] + 1}: {chosen[row][:40]!r} is no time; times are not used.")
        return None
    if (np.diff(times) < 0).any():
        row = int(np.argmax(np.diff(times) < 0))
        findings.warning(name, f"line {rows[row + 1] + 1}: time runs backwards; times are not used.")
        return None
    return times


def _seconds(text: str) -> float:
    """Read seconds, or a date and time with up to nanoseconds (KITTI raw); NaN where it is neither."""
    if is_number(text):
        return float(text)
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.fromisoformat(whole + "+00:00")
        return moment.timestamp() + (float("0." + fraction) if fraction else 0.0)
    except ValueError:
        return float("nan")
