"""When each point of a scan was measured, and scans whose points are moved to where they were at one instant.

Drivers write the times in units and from zeros of their own; the motion is that of the drive.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from interloc.arrays import Float32Array, FloatArray, IntArray
from interloc.drives.findings import Findings
from interloc.drives.options import DriveOptions
from interloc.drives.scans.recording import ChangedScans, Recording, ScanPoints
from interloc.drives.trajectory import Trajectory
from interloc.geometry import invert_transform
from interloc.odometry import Velocity, is_bent

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time", "time_offset", "point_time", "ts")
"""Names, in lower case, under which drivers write the time of a point."""

_USUAL_SCAN_S = 0.1
_SCAN_S = (0.01, 1.0)
_FAR_SPANS, _MIN_VALID = 2.0, 0.75
"""Beyond so many times the span of the middle four fifths a time is that of another scan; a share of the points."""

_FEW = 0.002  # of the points: not worth a word
_UNITS = 4  # seconds, ms, microseconds, ns
_SAME_CLOCK_S = 1.0

_MAX_GAP_S = 1.0
"""Between scans farther apart in time the velocity is not known."""

_SAMPLED = 12  # scans, evenly spread


def point_times(values: NDArray[Any], stamp_s: float | None = None) -> Float32Array | None:
    """Return the (N,) float32 times of the points of a scan, seconds after the time of the scan.

    A scan takes about a tenth of a second, which tells seconds from milli-, micro- and nanoseconds. Times of the clock
    of `stamp_s`, the time of the scan, count from there; those of another clock from the first point. Points whose time
    is far from that of most have NaN: late, or not set. None where these are no times of a scan: all the same, or over
    longer than any scan takes.
    """
    times = values.astype(np.float64)
    finite = np.isfinite(times)
    if not finite.any():
        return None
    low, high = np.percentile(times[finite], (10, 90))
    with np.errstate(invalid="ignore"):
        valid = finite & (times >= low - _FAR_SPANS * (high - low)) & (times <= high + _FAR_SPANS * (high - low))
    if np.count_nonzero(valid) < _MIN_VALID * len(times):
        return None
    found = _times_of_scan(times[valid], stamp_s)
    if found is None or valid.all():
        return found
    every = np.full(len(times), np.nan, np.float32)
    every[valid] = found
    return every


def _times_of_scan(times: FloatArray, stamp_s: float | None) -> Float32Array | None:
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


@dataclass(frozen=True)
class DeskewedScans(ChangedScans):
    """Scans without the motion within them; a `PointSource`."""

    frames: IntArray
    """(N,) int64: scan numbers, ascending."""
    velocities: tuple[tuple[Velocity | None, Velocity | None], ...]
    """tuple of (Velocity or None, Velocity or None): before and after the time of each scan; None where it is not
    known: then its points stay as they are."""

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan, and take the motion within it out of them."""
        points = self.source.read(frame)
        times_s = points.times_s
        if times_s is None:
            return points
        values = points.values.copy()
        row = int(np.searchsorted(self.frames, frame))
        for velocity, is_part in zip(self.velocities[row], (times_s < 0, times_s > 0), strict=True):
            if velocity is not None:
                values[is_part, :3] = velocity.undo(values[is_part, :3], times_s[is_part])
        return replace(points, values=values)


def is_to_deskew(recording: Recording, options: DriveOptions, findings: Findings) -> bool:
    """Tell whether `deskewed` may have something to do."""
    if options.deskew == "on" and not recording.has_times:
        name = recording.parts.file(recording.parts.scans).name
        findings.warning(name, "cannot be deskewed: its points carry no times.")
    return options.deskew != "off" and recording.has_times


def deskewed(recording: Recording, trajectory: Trajectory, options: DriveOptions, findings: Findings) -> Recording:
    """Return a recording whose points are without the motion within scans, as the option `deskew` asks for.

    "auto" does that where it is certain: points and scans carry times, the scans are turns of a spinning LiDAR, and the
    points show that no driver has done it before.
    """
    source, frames, poses, times_s = recording.points, recording.frames, trajectory.poses, trajectory.times_s
    if poses is None or len(frames) < 2:
        return recording
    name = recording.parts.file(recording.parts.scans).name
    if times_s is None:
        say = findings.warning if options.deskew == "on" else findings.note
        say(name, "cannot be deskewed: its points carry times, but those of the scans are not known.")
        return recording
    velocities = _velocities(poses.T_world_lidar, times_s)
    found = DeskewedScans(source, frames, velocities)
    rows = np.unique(np.linspace(0, len(frames) - 1, _SAMPLED).astype(int))
    sampled = [source.read(int(frames[row])) for row in rows]
    longest_s = 1.5 * float(np.median(np.diff(times_s)))  # a turn does not outlast the step to the next scan
    timed = [each.times_s for each in sampled if each.times_s is not None]
    bad = [float(np.isnan(each).mean()) for each in timed if np.ptp(np.nan_to_num(each)) < longest_s]
    if bad and np.mean(bad) > _FEW:
        findings.warning(
            name,
            f"{np.mean(bad):.1%} of the points looked at have times far from those of their scan: they stay where they "
            "were measured. Usual cause: points that are late, or whose time was not set.",
        )
    if options.deskew == "auto":
        bent = [_is_bent(points, velocities[row][1]) for row, points in zip(rows, sampled, strict=True) if bad]
        if not bent.count(True) > bent.count(False):
            why = "the points show that it was taken out before" if False in bent else "the points do not show any"
            if not bad:
                why = "their times are those of no scan (all the same, or spread further than to the next scan)"
            findings.note(name, f"the points carry times, and the motion within scans is left in: {why} (--deskew on).")
            return recording
    findings.note(name, "the motion within each scan is taken out of its points by their times (--deskew off).")
    return replace(recording, points=found)


def _is_bent(points: ScanPoints, velocity: Velocity | None) -> bool | None:
    if points.times_s is None or velocity is None:
        return None
    return is_bent(points.values[:, :3], np.nan_to_num(points.times_s), velocity)


def _velocities(T_world_lidar: FloatArray, times_s: FloatArray) -> tuple[tuple[Velocity | None, Velocity | None], ...]:
    """Return the velocity before and after each scan."""
    steps = invert_transform(T_world_lidar[:-1]) @ T_world_lidar[1:]
    between = [
        Velocity.between(step, passed) if 0 < passed <= _MAX_GAP_S else None
        for step, passed in zip(steps, np.diff(times_s).tolist(), strict=True)
    ]
    return tuple(
        (before or after, after or before) for before, after in zip([None, *between], [*between, None], strict=True)
    )
