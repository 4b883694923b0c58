"""The clocks of a cloud and of its trajectory: which of the usual ones they are, found out by where the points lie.

GPS times come as seconds of the week, as seconds since 6 January 1980, as these less 1e9 (adjusted standard time of
LAS), and as seconds since 1970 with or without leap seconds. Headers name the clock of a cloud, often wrongly, and
trajectories do not name theirs: so each is tried, and the one taken by which the vehicle was where the points are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.las.clouds import Cloud

MAX_DISTANCE_M = 300.0
"""Median horizontal distance of the points from the vehicle at their time; scanners of streets see 100 to 200 m."""

_WEEK_S = 604_800.0
_GPS_EPOCH_UNIX_S = 315_964_800.0
_FIRST_LEAP_SECONDS = 13  # by which GPS is ahead of UTC before the first of these, and one more from each on (IERS)
_LEAPS_S = (1_136_073_600.0, 1_230_768_000.0, 1_341_100_800.0, 1_435_708_800.0, 1_483_228_800.0)  # UNIX time
_COVERED = 0.5


class ClockMatch(NamedTuple):
    """How the clock of a trajectory is turned into that of the cloud."""

    distance_m: float
    """Median horizontal distance of the points from the vehicle."""
    offset_s: float
    """To be added to the times of the trajectory."""
    reason: str
    """Which clocks these are."""


def match_clocks(
    times_s: FloatArray, points: FloatArray, cloud: Cloud, track_s: FloatArray, track_xy: FloatArray, file: SourceFile
) -> ClockMatch:
    """Find the clock by which the vehicle was where the points are.

    Parameters
    ----------
    times_s : (N,) float64
        Of some points of a cloud, in its clock.
    points : (N, 3) float64
        Their easting, northing, height.
    cloud : Cloud
    track_s : (P,) float64
        Of the trajectory, ascending.
    track_xy : (P, 2) float64
        Easting, northing of the vehicle.
    file : SourceFile
        The trajectory.

    Raises
    ------
    DriveError
        The times have nothing in common in any clock, or the points lie elsewhere.
    """
    matches = []
    for offset, reason in _candidates(float(np.median(times_s)), float(track_s[0]), cloud.time_offset_s).items():
        shifted = times_s - offset
        inside = (shifted >= track_s[0]) & (shifted <= track_s[-1])
        if inside.mean() >= _COVERED:
            at = np.stack([np.interp(shifted[inside], track_s, axis) for axis in track_xy.T], axis=1)
            distance = float(np.median(np.linalg.norm(points[inside, :2] - at, axis=1)))
            matches.append(ClockMatch(distance, offset, reason))
    if not matches:
        raise file.fault(
            f"covers {track_s[0]:.3f} s to {track_s[-1]:.3f} s, and the points of {cloud.file.name} were measured from "
            f"{times_s.min():.3f} s to {times_s.max():.3f} s. They have nothing in common as seconds of the GPS week, "
            "adjusted standard time or UNIX time. Usual cause: the trajectory of another drive or day."
        )
    best = min(matches, key=lambda match: match.distance_m)
    if best.distance_m > MAX_DISTANCE_M:
        raise file.fault(
            f"was {best.distance_m:,.0f} m away from the points of {cloud.file.name} when they were measured (median, "
            f"in the best clock: {best.reason}); expected at most {MAX_DISTANCE_M:g} m. Usual cause: the trajectory "
            "of another drive, or a cloud in another coordinate system than stated (--crs)."
        )
    return best


def _candidates(middle_s: float, first_s: float, time_offset_s: float) -> dict[float, str]:
    """Return offsets that would lead from the clock of a trajectory to that of a cloud, the likeliest first."""
    leap = float(_FIRST_LEAP_SECONDS + np.searchsorted(_LEAPS_S, first_s, side="right"))
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
            weeks = round((middle_s - first_s - to_gps) / _WEEK_S)
            candidates.setdefault(
                to_gps + weeks * _WEEK_S, f"the trajectory in {theirs}, the cloud in seconds of the GPS week"
            )
        if 0 <= first_s <= _WEEK_S + 3600:
            weeks = round((middle_s + to_gps - first_s) / _WEEK_S)
            candidates.setdefault(
                weeks * _WEEK_S - to_gps, f"the trajectory in seconds of the GPS week, the cloud in {theirs}"
            )
    return candidates
