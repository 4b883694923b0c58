"""When each point of a scan was measured: drivers write it in units and from zeros of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import Float32Array

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time", "time_offset", "point_time", "ts")
"""Names, in lower case, under which drivers write the time of a point."""

_USUAL_SCAN_S = 0.1
_SCAN_S = (0.01, 1.0)
_UNITS = 4  # seconds, ms, microseconds, ns
_SAME_CLOCK_S = 1.0


def point_times(values: NDArray[Any], stamp_s: float | None = None) -> Float32Array | None:
    """Return the times of the points of a scan, seconds after the time of the scan.

    Parameters
    ----------
    values : (N,) number
        As they are stored. A scan takes about a tenth of a second, which tells seconds from milli-, micro- and
        nanoseconds.
    stamp_s : float or None
        Time of the scan, where it is known: times of the same clock count from there. Those of another clock count
        from the first point.

    Returns
    -------
    (N,) float32 or None
        None where these are no times of a scan: all the same, not finite, or over longer than any scan takes.
    """
    times = values.astype(np.float64)
    if not len(times) or not np.isfinite(times).all():
        return None
    first, span = float(times.min()), float(np.ptp(times))
    if span <= 0:
        return None
    power = round(float(np.log(span / _USUAL_SCAN_S) / np.log(1000.0)))
    unit = 1000.0**power
    if not 0 <= power < _UNITS or not _SCAN_S[0] <= span / unit <= _SCAN_S[1]:
        return None
    if stamp_s is not None and abs(first / unit - stamp_s) < _SAME_CLOCK_S:
        zero = stamp_s * unit
    elif -1.5 * span <= first <= 0.5 * span:  # counted from the time of the scan
        zero = 0.0
    else:
        zero = first
    return ((times - zero) / unit).astype(np.float32)
