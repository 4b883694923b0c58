"""The clocks of a cloud and of its trajectory: which of the usual ones they are, found out by where the points lie.

GPS times come as seconds of the week, as seconds since 6 January 1980, as these less 1e9 (adjusted standard time of
LAS), and as seconds since 1970 with or without leap seconds. Headers name the clock of a cloud, often wrongly, and
trajectories do not name theirs: so each is tried, and the one taken by which the vehicle was where the points are.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.las.clouds import ADJUSTED_OFFSET_S

MAX_DISTANCE_M = 300.0
"""Median horizontal distance of the points from the vehicle at their time; scanners of streets see 100 to 200 m."""

_WEEK_S = 604_800.0
_GPS_EPOCH_UNIX_S = 315_964_800.0
_LEAP_SECONDS = (  # UNIX time from which on GPS is ahead of UTC by so much (IERS, Bulletin C)
    (0.0, 13),
    (1_136_073_600.0, 14),
    (1_230_768_000.0, 15),
    (1_341_100_800.0, 16),
    (1_435_708_800.0, 17),
    (1_483_228_800.0, 18),
)
_COVERED = 0.5


@dataclass(frozen=True)
class Sample:
    """Some points of a cloud."""

    times_s: FloatArray
    """(N,) float64: in the clock of the cloud."""
    xyz: FloatArray
    """(N, 3) float64: easting, northing, height."""
    time_offset_s: float = ADJUSTED_OFFSET_S
    """What was subtracted from adjusted standard time."""


@dataclass(frozen=True)
class ClockMatch:
    """How the clock of a trajectory is turned into that of the cloud."""

    offset_s: float
    """To be added to the times of the trajectory."""
    reason: str
    """Which clocks these are."""
    distance_m: float
    """Median horizontal distance of the points from the vehicle."""


def match_clocks(sample: Sample, times_s: FloatArray, xy: FloatArray, file: SourceFile, cloud: str) -> ClockMatch:
    """Find the clock by which the vehicle was where the points are.

    Parameters
    ----------
    sample : Sample
    times_s : (P,) float64
        Of the trajectory, ascending.
    xy : (P, 2) float64
        Easting, northing of the vehicle.
    file : SourceFile
        The trajectory.
    cloud : str
        How messages call the cloud.

    Raises
    ------
    DriveError
        The times have nothing in common in any clock, or the points lie elsewhere.
    """
    matches = []
    for offset, reason in _candidates(float(np.median(sample.times_s)), times_s, sample.time_offset_s).items():
        shifted = sample.times_s - offset
        inside = (shifted >= times_s[0]) & (shifted <= times_s[-1])
        if inside.mean() < _COVERED:
            continue
        at = np.stack([np.interp(shifted[inside], times_s, axis) for axis in xy.T], axis=1)
        distance = float(np.median(np.linalg.norm(sample.xyz[inside, :2] - at, axis=1)))
        matches.append(ClockMatch(offset, reason, distance))
    if not matches:
        low, high = float(sample.times_s.min()), float(sample.times_s.max())
        raise file.fault(
            f"covers {times_s[0]:.3f} s to {times_s[-1]:.3f} s, and the points of {cloud} were measured from "
            f"{low:.3f} s to {high:.3f} s. They have nothing in common as seconds of the GPS week, adjusted standard "
            "time or UNIX time. Usual cause: the trajectory of another drive or day."
        )
    best = min(matches, key=lambda match: match.distance_m)
    if best.distance_m > MAX_DISTANCE_M:
        raise file.fault(
            f"was {best.distance_m:,.0f} m away from the points of {cloud} when they were measured (median, in the "
            f"best clock: {best.reason}); expected at most {MAX_DISTANCE_M:g} m. Usual cause: the trajectory of "
            "another drive, or a cloud in another coordinate system than stated (--crs)."
        )
    return best


def _candidates(middle_s: float, times_s: FloatArray, time_offset_s: float) -> dict[float, str]:
    """Return offsets that would lead from the clock of a trajectory to that of a cloud, the likeliest first."""
    first = float(times_s[0])
    leap = float(_LEAP_SECONDS[bisect_right(_LEAP_SECONDS, (first, 99)) - 1][1])
    clocks = {  # what turns each into the seconds of GPS since 1980
        "GPS seconds since 1980": 0.0,
        "adjusted standard time": time_offset_s,
        "UNIX time (UTC)": leap - _GPS_EPOCH_UNIX_S,
        "UNIX time without leap seconds": -_GPS_EPOCH_UNIX_S,
    }
    candidates = {0.0: "the same clock"}
    for seconds in (leap, -leap, 18.0, -18.0):
        candidates.setdefault(seconds, f"clocks that differ by {seconds:+g} leap seconds")
    for theirs, to_gps in clocks.items():
        for ours, of_cloud in clocks.items():
            candidates.setdefault(to_gps - of_cloud, f"the trajectory in {theirs}, the cloud in {ours}")
        if 0 <= middle_s <= _WEEK_S + 3600:
            weeks = np.round((middle_s - first - to_gps) / _WEEK_S)
            candidates.setdefault(
                to_gps + weeks * _WEEK_S, f"the trajectory in {theirs}, the cloud in seconds of the GPS week"
            )
        if 0 <= first <= _WEEK_S + 3600:
            weeks = np.round((middle_s + to_gps - first) / _WEEK_S)
            candidates.setdefault(
                weeks * _WEEK_S - to_gps, f"the trajectory in seconds of the GPS week, the cloud in {theirs}"
            )
    return candidates
