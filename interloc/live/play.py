"""A drive played as it was driven: its scans at their times, or as fast as they are taken."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from interloc.arrays import FloatArray
from interloc.config import DetectorConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drive import Drive
from interloc.live.scan import LiveScan, live_scan

_USUAL_HZ = 10.0


def play(
    drive: Drive,
    config: DetectorConfig,
    *,
    speed: float | None = None,
    after: int = -1,
    wait: Callable[[float], None] = time.sleep,
) -> Iterator[LiveScan]:
    """Yield the scans of a drive that are keyframes: a session looks at no others.

    At speed 1 they come at the times at which they were taken, at 2 twice as fast, at None as fast as they are taken.
    Scans up to `after` have arrived already. `wait` is called with the seconds until the next scan is due.
    """
    rows = select_keyframes(drive.T_world_lidar, config.keyframes)
    rows = rows[drive.frames[rows] > after]
    due_s = _times(drive)[rows]
    began = time.monotonic()
    for row, seconds in zip(rows.tolist(), due_s.tolist(), strict=True):
        scan = live_scan(drive, row)
        if speed is not None:
            wait(max(0.0, began + (seconds - due_s[0]) / speed - time.monotonic()))
        yield scan


def _times(drive: Drive) -> FloatArray:
    if drive.times_s is not None and np.isfinite(drive.times_s).all():
        return drive.times_s
    return np.asarray(drive.frames / _USUAL_HZ, np.float64)
