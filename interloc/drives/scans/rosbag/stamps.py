"""When the scans of a bag were taken, and in which order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.scans.rosbag.bag import Bag, BagTopic
from interloc.drives.scans.rosbag.wire import Wire, WireError, read_header

_MANY_BACKWARDS_S = 1.0


@dataclass(frozen=True)
class ScanTimes:
    """When the scans of a bag were taken.

    Attributes
    ----------
    order : (N,) int64
        Rows of the topic in the order of time: scan number to row.
    stamp_s, log_s : (N,) float64
        Time in the header, and time of recording, of each scan.
    """

    order: IntArray
    stamp_s: FloatArray
    log_s: FloatArray


def read_scan_times(bag: Bag, topic: BagTopic, findings: Findings) -> ScanTimes:
    """Read the stamps of all scans, from the first bytes of each, and number the scans by them."""
    assert topic.encoding is not None
    stamps = np.empty(len(topic), dtype=np.int64)
    for row, head in enumerate(bag.heads(topic)):
        try:
            stamps[row] = read_header(Wire(head, topic.encoding)).stamp_ns
        except WireError as error:
            raise DriveFileError(bag.name, f"{topic.name}, message {row}: {error}.") from error
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
    return ScanTimes(order, stamps[order] / 1e9, topic.log_ns[order] / 1e9)
