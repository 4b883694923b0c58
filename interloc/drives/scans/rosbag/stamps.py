"""When the scans of a bag were taken, and in which order."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.clocks import ClockShift, known_shift
from interloc.drives.findings import Findings
from interloc.drives.scans.rosbag.bag import Bag, BagTopic
from interloc.drives.scans.rosbag.pointcloud2 import first_points
from interloc.drives.scans.rosbag.wire import Encoding, Header, Wire, read_header

_MANY_BACKWARDS_S = 1.0
_MANY_IDLE = 0.05
_ALIKE_S, _AHEAD_S = 0.5, 0.1


def clock_lead_s(stamps_ns: IntArray, log_ns: IntArray) -> float:
    """Return by how much the stamps of messages are ahead of the times at which they were recorded, the median."""
    return float(np.median(stamps_ns - log_ns)) / 1e9 if len(stamps_ns) else float("nan")


def clock_shift(lead_s: float, other_lead_s: float) -> ClockShift | None:
    """Compare the clocks of two topics that were recorded together.

    Parameters
    ----------
    lead_s, other_lead_s : float
        `clock_lead_s` of both; NaN where it is not known.

    Returns
    -------
    ClockShift or None
        None where the clocks are the same, or where one topic may only have been computed or recorded later.
    """
    ahead_s = lead_s - other_lead_s
    if not abs(ahead_s) > _ALIKE_S:
        return None
    if (known := known_shift(ahead_s)) is not None:
        return known
    latest_s = max(lead_s, other_lead_s)
    if latest_s > _AHEAD_S and min(lead_s, other_lead_s) < _AHEAD_S:  # nothing is recorded before it happens
        return ClockShift(ahead_s, "a clock that is not synchronised")
    return None


@dataclass(frozen=True)
class ScanTimes:
    """When the scans of a bag were taken."""

    order: IntArray
    """(N,) int64: rows of the topic in the order of time: scan number to row."""
    stamp_s: FloatArray
    log_s: FloatArray
    """(N,) float64: time in the header, and time of recording, of each scan."""
    frame_ids: tuple[str, ...] = ()
    """The coordinate frames of the points, those of the most scans first."""

    @property
    def lead_s(self) -> float:
        """By how much the stamps are ahead of the times of recording, the median; 0 where these are the stamps."""
        return float(np.median(self.stamp_s - self.log_s))


def read_scan_times(bag: Bag, topic: BagTopic, findings: Findings) -> ScanTimes:
    """Read the stamps of all scans, from the first bytes of each, and number the scans by them."""

    def decode(head: bytes, encoding: Encoding) -> tuple[Header, bytes | None]:
        return read_header(Wire(head, encoding)), first_points(head, topic.type, encoding)

    stamps = np.empty(len(topic), dtype=np.int64)
    frame_ids: Counter[str] = Counter()
    empty = repeated = 0
    before = b""
    for row, (header, points) in enumerate(bag.decoded(topic, decode, heads=True)):
        stamps[row] = header.stamp_ns
        frame_ids[header.frame_id] += 1
        empty += points == b""
        repeated += bool(points) and points == before
        before = points or b""
    _tell_idle(bag, topic, empty, repeated, findings)
    unset = int(np.count_nonzero(stamps <= 0))
    constant = len(stamps) > 2 and len(np.unique(stamps)) <= len(stamps) // 2
    if unset or constant:
        what = f"{unset:,} of {len(stamps):,} scans have a stamp of 0" if unset else "most scans have the same stamp"
        findings.note(bag.name, f"{topic.name}: {what}; the times at which they were recorded are used.")
        stamps = topic.log_ns
    recorded = np.argsort(topic.log_ns, kind="stable")
    steps = np.diff(stamps[recorded])
    if (steps < 0).any():
        back_s = float(-steps.min() / 1e9)
        say = findings.warning if back_s > _MANY_BACKWARDS_S else findings.note
        say(
            bag.name,
            f"{topic.name}: the stamps of the scans run backwards {np.count_nonzero(steps < 0):,} times, by up to "
            f"{back_s:.3f} s; the scans are numbered by their stamps. Usual cause: two sensors on one topic, or a "
            "clock that was set while recording.",
        )
    order = recorded[np.argsort(stamps[recorded], kind="stable")]
    frames = tuple(frame for frame, _ in frame_ids.most_common())
    return ScanTimes(order, stamps[order] / 1e9, topic.log_ns[order] / 1e9, frames)


def _tell_idle(bag: Bag, topic: BagTopic, empty: int, repeated: int, findings: Findings) -> None:
    """Tell of scans without points, and of scans that repeat the one before."""
    for count, what, usual in (
        (empty, "hold no points", "a sensor or network that was overloaded"),
        (repeated, "repeat the scan before under a new stamp", "a driver that hung"),
    ):
        if count:
            say = findings.warning if count > _MANY_IDLE * len(topic) else findings.note
            say(bag.name, f"{count:,} of {len(topic):,} scans of {topic.name} {what}. Usual cause: {usual}.")
