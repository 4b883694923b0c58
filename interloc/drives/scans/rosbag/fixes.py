"""The georeference of a bag: its GNSS fixes, and the motion that tells the attitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.findings import Findings
from interloc.drives.georeference.fixes import (
    MIN_EXTENT_M,
    MIN_FIXES,
    Fixes,
    Shift,
    extent_m,
    fit_shift,
    georeference_from_fixes,
    misfit_m,
)
from interloc.drives.georeference.geodetic import check_georeference, in_degrees
from interloc.drives.scans.rosbag.bag import Bag, BagTopic
from interloc.drives.scans.rosbag.messages import NO_FIX, read_fix
from interloc.drives.scans.rosbag.motion import FrameTree, LidarMotion, latest_of_each
from interloc.drives.scans.rosbag.topics import clock_lead_s, clock_shift
from interloc.geometry import enu_from_lonlat, from_first

_ARM_STD_M = 1.0
"""Along each axis, of a place on a car that is not known."""

_GRID_S, _MAX_GRID = 0.2, 20_000


@dataclass(frozen=True)
class BagFixes:
    """The fixes of one topic."""

    bag: Bag
    topic: BagTopic
    points_frame: str
    """Frame of the points."""
    tree: FrameTree
    by_log: bool = False
    """Times are those of recording, not those of the headers."""

    def georeference(
        self, motion: LidarMotion, times_s: FloatArray, world: FloatArray, findings: Findings
    ) -> tuple[Georeference | None, str]:
        """Lay the motion on the fixes; None, and why, where that cannot be.

        Parameters
        ----------
        times_s : (N,) float64
            Times of the scans, seconds.
        world : (N, 4, 4) float64
            Poses of the LiDAR at the scans, in the world of the motion.
        """
        found, reason = self._within(motion, times_s, world, findings)
        if found is None:
            return None, reason
        fixes, distance_m = found
        georeference, reason = self._laid_on(fixes, distance_m, world)
        if georeference is None and fixes.swapped is not None:
            georeference, _ = self._laid_on(fixes.swapped, distance_m, world)
            if georeference is not None:
                findings.warning(
                    self.bag.name,
                    f"{self.topic.name}: latitude and longitude are exchanged, and are read the other way round: so "
                    "the motion is that of the poses.",
                )
        if georeference is None:
            findings.warning(self.bag.name, reason)
        return georeference, reason

    def _laid_on(self, fixes: Fixes, distance_m: FloatArray, world: FloatArray) -> tuple[Georeference | None, str]:
        source = f"{self.topic.name} (GNSS), heading from the motion"
        georeference, doubts = georeference_from_fixes(fixes, world, distance_m, source), Findings(stop_at_first=False)
        check_georeference(from_first(world), georeference, doubts)
        return (None, f"{self.topic.name} {doubts.found[0].message}") if doubts.found else (georeference, "")

    def _within(
        self, motion: LidarMotion, scan_times_s: FloatArray, world: FloatArray, findings: Findings
    ) -> tuple[tuple[Fixes, FloatArray] | None, str]:
        """Return the fixes within the poses, and the distance driven until every scan; or why there are none."""
        name, messages = self.topic.name, list(self.bag.decoded(self.topic, read_fix))
        stamps = np.array([fix.header.stamp_ns for fix in messages], dtype=np.int64)
        log_s = self.topic.log_ns / 1e9
        times_s = log_s if self.by_log or bool((stamps <= 0).any()) else stamps / 1e9
        shift = None if times_s is log_s else clock_shift(clock_lead_s(stamps, self.topic.log_ns), motion.lead_s)
        if shift is not None:
            times_s = times_s - shift.ahead_s
            findings.warning(
                self.bag.name,
                f"the stamps of {name} are {shift.ahead_s:+.3f} s off those of the poses, by the times at which both "
                f"were recorded: the fixes are put right by that. Usual cause: {shift.why}.",
            )
        positions = np.array([fix.position for fix in messages], dtype=np.float64).reshape(-1, 3)
        positions[:, 0], positions[:, 1], is_e7 = in_degrees(positions[:, 0], positions[:, 1])
        if is_e7:
            findings.warning(self.bag.name, f"{name}: positions are multiples of 1e-7 degrees, and are read as such.")
        status = np.array([fix.status for fix in messages])
        sound = _sound_fixes(positions, status)
        if not sound.any():
            return None, f"{name}: none of {len(messages):,} fixes has a position{_why_unsound(positions, status)}"
        positions[~np.isfinite(positions[:, 2]), 2] = 0.0
        late = self._late(motion, times_s[sound], positions[sound], findings)
        if late is not None and not late.is_sure:
            return None, (
                f"{name}: the fixes are late or early against the poses, by {abs(late.late):.0f} s or so (about "
                f"{late.metres:.0f} m): that is not sure enough to put it right. Usual cause: two clocks"
            )
        if late is not None:
            times_s = times_s - late.late
            findings.warning(
                self.bag.name,
                f"{name}: the fixes are {abs(late.late):.2f} s {'late' if late.late > 0 else 'early'} against the "
                f"poses (so put right they lie {late.after_m:.1f} m off the path, else {late.before_m:.1f} m; about "
                f"{late.metres:.0f} m along the road). Usual cause: a receiver that tells its positions late, or two "
                "clocks.",
            )
        covered = sound & motion.covers(times_s)
        if not covered.any() and (by_log := sound & motion.covers(log_s)).any():
            findings.warning(
                self.bag.name, f"the stamps of {name} are of another clock; the times of recording are used."
            )
            times_s, covered = log_s, by_log
        rows = np.flatnonzero(covered)[latest_of_each(times_s[covered])]
        if len(rows) < MIN_FIXES:
            return None, (
                f"{name}: {len(rows)} of {len(messages):,} fixes have a position while the pose is known; expected at "
                f"least {MIN_FIXES}"
            )
        at_fixes = motion.at(times_s[rows])
        antenna_frame = messages[int(rows[0])].header.frame_id
        T_lidar_antenna = self.tree.between(self.points_frame, antenna_frame) if antenna_frame else None
        antenna = np.zeros(3) if T_lidar_antenna is None else T_lidar_antenna[:3, 3]
        if T_lidar_antenna is None:
            findings.note(
                self.bag.name,
                f"{name}: where the antenna is on the vehicle is not known (no transform leads from "
                f"{self.points_frame} to {antenna_frame or 'its frame, which is not named'}): it is taken to be at "
                f"the LiDAR, and positions count as {_ARM_STD_M:.0f} m less sure. Record it in /tf_static.",
            )
        places = at_fixes[:, :3, :3] @ antenna + at_fixes[:, :3, 3]
        distance_m = _distances(
            np.concatenate([times_s[rows], scan_times_s]), np.concatenate([at_fixes[:, :3, 3], world[:, :3, 3]])
        )
        std_m = np.array([fix.std_m for fix in messages])[rows]
        fixes = Fixes(
            positions[rows, 0],
            positions[rows, 1],
            positions[rows, 2],
            places,
            distance_m[: len(rows)],
            None if np.isnan(std_m).all() else np.where(np.isnan(std_m), np.nanmax(std_m), std_m),
            0.0 if T_lidar_antenna is not None else _ARM_STD_M,
        )
        if extent_m(fixes) < MIN_EXTENT_M or float(np.ptp(places, axis=0).max()) < MIN_EXTENT_M / 2:
            return None, (
                f"{name}: the fixes reach over {extent_m(fixes):.1f} m; expected at least {MIN_EXTENT_M:.0f} m, or the "
                "heading is not known"
            )
        return (fixes, distance_m[len(rows) :]), ""

    def _late(
        self, motion: LidarMotion, times_s: FloatArray, positions: FloatArray, findings: Findings
    ) -> Shift | None:
        """Find out whether (K,) fixes are late against the motion."""
        first, last = motion.span_s
        rows = latest_of_each(times_s)
        if len(rows) < MIN_FIXES or last <= first:
            return None
        grid = np.linspace(first, last, int(np.clip((last - first) / _GRID_S, 2, _MAX_GRID)))
        path, lonlat = motion.at(grid)[:, :2, 3], positions[rows][:, [1, 0]]
        shift = fit_shift(grid, path, times_s[rows], enu_from_lonlat(lonlat[0, 1], lonlat[0, 0], lonlat))
        if shift is None or not shift.is_there:
            if shift is not None and shift.untold:
                findings.untold(self.bag.name, f"{self.topic.name}: {shift.untold}")
            return None
        exchanged = enu_from_lonlat(lonlat[0, 0], lonlat[0, 1], lonlat[:, ::-1])
        is_mirrored = misfit_m(grid, path, times_s[rows], exchanged) < shift.after_m  # then a shift may seem to help
        return None if is_mirrored else shift


def _sound_fixes(positions: FloatArray, status: IntArray) -> BoolArray:
    lat, lon = positions[:, 0], positions[:, 1]
    with np.errstate(invalid="ignore"):
        on_earth = (np.abs(lat) < 89) & (np.abs(lon) <= 360) & ((lat != 0) | (lon != 0))
        height = ~(np.abs(positions[:, 2]) > 20_000)
    sound: BoolArray = (status != NO_FIX) & on_earth & height  # newer messages leave the status at -2, unknown
    return sound


def _why_unsound(positions: FloatArray, status: IntArray) -> str:
    """Return what is wrong with fixes of which none is sound, in words that follow."""
    if (status == NO_FIX).all():
        return f": the receiver had none (status {NO_FIX})"
    if not np.isfinite(positions[:, :2]).all(axis=1).any():
        return ": they are not finite"
    lat, lon = positions[int(np.argmax(status != NO_FIX)), :2]
    return (
        f": latitude {lat:g}, longitude {lon:g} is no place to drive. Expected degrees. Usual cause: metres of UTM or "
        "of a local frame in the message"
    )


def _distances(times_s: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the distance driven until each of (M,) times at (M, 3) positions, in the order in which they are given."""
    order = np.argsort(times_s, kind="stable")
    steps = np.linalg.norm(np.diff(positions[order], axis=0), axis=1)
    distances = np.empty(len(times_s))
    distances[order] = np.concatenate([[0.0], np.cumsum(steps)])
    return distances
