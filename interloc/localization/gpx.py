"""Placing a drive by the track of a phone or a watch that was along: a GPX file.

The two tracks are laid on each other by time; a shift between their clocks is put right where it is sure. Then the
drive is bent onto the track as it is bent onto the roads of a map (`interloc.localization.refine`): the file says where
it ran, the odometry how smoothly.
"""

import re
from dataclasses import dataclass, replace
from datetime import UTC
from pathlib import Path
from typing import Any

import gpxpy
import numpy as np
from gpxpy.gpx import GPXException

from interloc.arrays import FloatArray
from interloc.drive import Drive, Georeference
from interloc.drives.georeference.fixes import are_moving, fit_moving, fit_rigid, standing_in_words
from interloc.errors import DriveError, LocationError
from interloc.files import reason_of
from interloc.geometry import enu_from_lonlat, middle_of, rotate_2d, thin
from interloc.localization.locate import georeference_by
from interloc.localization.refine import Chain, fit, uncertainty
from interloc.localization.roads import RoadMap
from interloc.localization.track import MAX_BRANCHES, NO_SIGHTINGS, Track, track_of
from interloc.results import EPOCH_S

# Tracks in GPX files, as phones, watches and navigation devices write them.

MAX_BYTES = 100_000_000


@dataclass(frozen=True)
class GpxTrack:
    """The track of a GPX file."""

    lonlat: FloatArray
    """(P, 2) float64: degrees."""
    time_s: FloatArray | None
    """(P,) float64 or None: seconds since 1970, where every point has one."""
    source: str
    """Name of the file."""


def read_gpx(path: Path) -> GpxTrack:
    """Read the tracks (or else the routes) of a GPX file as one; a DriveError says why it has none."""
    usual = "Expected a GPX 1.0 or 1.1 file with a track, as phones and watches export it."
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise DriveError(f"{path}: {size:,} bytes; a GPX track has at most {MAX_BYTES:,}.")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DriveError(f"{path} could not be read: {reason_of(error)}.") from error
    except UnicodeDecodeError as error:
        raise DriveError(f"{path}: it is not UTF-8 text. {usual}") from error
    if "<!ENTITY" in text or "<!DOCTYPE" in text:  # entities can unpack to more than there is memory
        raise DriveError(f"{path}: it declares entities or a DOCTYPE, which no GPX file needs: remove them. {usual}")
    try:
        gpx = gpxpy.parse(text)
    except (GPXException, ValueError, LookupError, RecursionError) as error:
        raise DriveError(f"{path}: it is no GPX file ({str(error).strip()[:200]}). {usual}") from error
    points: list[Any] = [point for track in gpx.tracks for segment in track.segments for point in segment.points]
    points = points or [point for route in gpx.routes for point in route.points]
    if len(points) < 2:
        root = re.search(r"<\w[\w:.-]*", text)
        raise DriveError(
            f"{path}: holds {len(points)} points of a track or route (it starts with {root[0] if root else ''}>); "
            f"waypoints are not enough. {usual}"
        )
    lonlat = np.array([(point.longitude, point.latitude) for point in points], dtype=np.float64)
    known = np.isfinite(lonlat).all(axis=1) & (np.abs(lonlat) <= [180.0, 89.0]).all(axis=1)
    if not known.all():
        row = int(np.argmin(known))
        raise DriveError(
            f"{path}: point {row + 1} is at latitude {lonlat[row, 1]}, longitude {lonlat[row, 0]}: it lies beyond 180 "
            f"degrees of longitude or 89 degrees of latitude. {usual}"
        )
    # GPX knows UTC alone; where a file names no zone, Python would take that of the machine
    times_utc = [point.time and point.time.replace(tzinfo=point.time.tzinfo or UTC) for point in points]
    times = np.array([time.timestamp() for time in times_utc if time is not None], dtype=np.float64)
    in_order = len(times) == len(points) and bool((np.diff(times) >= 0.0).all())
    return GpxTrack(lonlat, times if in_order else None, path.name)


FIX_STD_M = 4.0
"""Of the fixes of a phone, as far as they share it: it stays when the scatter of the fixes is averaged."""

MIN_LENGTH_M = 100.0
MAX_RMS_M = 15.0
"""A drive that stays farther from the track than this was not along."""

_SHARE = 0.8  # of the drive that the track must cover
_MUCH_SCATTER = 2.0
_UNKNOWN_M = 30.0  # driven while the fixes stood still
_STEP_M = 5.0  # points of the track that are closer are scatter, above all where it stands


@dataclass(frozen=True)
class GpxPlacement:
    """A drive placed by a GPX track."""

    georeference: Georeference
    """With one sigma of the position of each scan, what all fixes share included."""
    rms_m: float
    """Of the distances of the drive from the track, before it was bent onto it."""
    late_s: float = 0.0
    """By how much the clock of the track was put right: so much its fixes are late, early where it is negative."""
    doubts: str = ""
    """Which of its fixes stand still, and why its clock may be off without being seen to be, in words."""


def georeference_by_gpx(drive: Drive, gpx: GpxTrack) -> GpxPlacement:
    """Place a drive by a track that was recorded along with it; refused where it does not fit."""
    track = track_of(drive.T_world_lidar)
    if track.length_m < MIN_LENGTH_M:
        raise LocationError(
            f"{drive.name}: the drive is {track.length_m:.0f} m long; a track places one from {MIN_LENGTH_M:.0f} m on."
        )
    roads = _as_roads(gpx)
    xy = roads.xy(gpx.lonlat)
    chain = Chain.of(track, NO_SIGHTINGS)
    times_s = drive.times_s
    if times_s is None or gpx.time_s is None or times_s[0] < EPOCH_S:
        without = gpx.source if gpx.time_s is None else "it"
        raise LocationError(
            f"{drive.name}: drive and track are laid on each other by time, and {without} has no times since 1970. "
            "Expected a times.txt of the drive, and in the track a <time> of every point, in order."
        )
    clock, runs = fit_moving(times_s, track.xy, gpx.time_s, xy)
    moves, fixes = are_moving(runs, len(xy)), xy.copy()
    for run in runs:
        if run.driven_m > _UNKNOWN_M:  # what the drive did there is not on the chord
            moves[run.first + 1], fixes[run.first + 1] = True, np.nan
    late = clock if clock is not None and clock.is_there and clock.metres >= FIX_STD_M else None
    if late is not None and not late.is_sure and late.before_m <= _MUCH_SCATTER * FIX_STD_M:
        late = None  # no more than the scatter of fixes pretends
    if late is not None and not late.is_sure:
        raise LocationError(
            f"{drive.name}: the clock of {gpx.source} is off by {abs(late.late):.0f} s or so, which is not sure enough "
            "to put it right. Usual cause: a track of another day, or a drive with too few curves."
        )
    late_s = 0.0 if late is None else late.late
    target = _by_time(times_s + late_s, track, chain, gpx.time_s[moves], fixes[moves])
    if target is None:
        raise LocationError(
            f"{drive.name}: the track of {gpx.source} lasts from {gpx.time_s[0]:.0f} s to {gpx.time_s[-1]:.0f} s, the "
            f"drive from {times_s[0]:.0f} s to {times_s[-1]:.0f} s (since 1970). Expected a track that covers the "
            "drive. Usual cause: a track of another day, or a clock in local time."
        )
    doubts = "" if clock is None else clock.undecided
    if runs:
        doubts = " ".join([standing_in_words(runs, gpx.time_s - times_s[0], "{:.0f} to {:.0f} s"), doubts]).strip()
        known = fixes[moves & np.isfinite(fixes[:, 0])]
        pieces = np.cumsum(np.isnan(fixes[moves, 0]))[np.isfinite(fixes[moves, 0])]
        rows = thin(known, _STEP_M)
        segments = np.column_stack([known[rows[:-1]], known[rows[1:]]])
        roads = replace(roads, segments=segments[np.diff(pieces[rows]) == 0])
    turn, shift, rms_m = _rigid(chain.pose[:, :2], target)
    if rms_m > MAX_RMS_M:
        raise LocationError(
            f"{drive.name}: the drive stays {rms_m:.0f} m from the track of {gpx.source} (root mean "
            f"square); expected {MAX_RMS_M:.0f} m at most. Usual cause: a track of another day, clocks that differ, or "
            "a tunnel in which it has no points."
        )
    start = np.column_stack([rotate_2d(chain.pose[:, :2], turn) + shift, chain.pose[:, 2] + turn])
    bent = fit(chain, start, roads)
    covariance = uncertainty(chain, bent, roads)
    rows = np.round(np.interp(track.at_m, chain.at_m, np.arange(len(chain)))).astype(np.int64)
    moved = f", whose clock is put right by {-late_s:+.1f} s" if late_s else ""
    georeference = georeference_by(chain, bent, track, roads, f"the track {gpx.source} (by time{moved})")
    position_std_m = np.sqrt((covariance[rows, 0, 0] + covariance[rows, 1, 1]) / 2.0 + FIX_STD_M**2)
    return GpxPlacement(replace(georeference, position_std_m=position_std_m), rms_m, late_s, doubts)


def _as_roads(gpx: GpxTrack) -> RoadMap:
    """Return the track as a map of one road."""
    lon_deg, lat_deg = middle_of(gpx.lonlat)
    xy = enu_from_lonlat(lat_deg, lon_deg, gpx.lonlat)
    xy = xy[thin(xy, _STEP_M)]
    no_nodes = np.zeros((0, 2)), np.zeros((0, MAX_BRANCHES)), np.zeros(0, dtype=np.int64)
    return RoadMap(lat_deg, lon_deg, np.column_stack([xy[:-1], xy[1:]]), *no_nodes)


def _by_time(
    times_s: FloatArray, track: Track, chain: Chain, fix_times_s: FloatArray, xy: FloatArray
) -> FloatArray | None:
    """Return where the poses of the chain were, (n, 2), by the clock of the track; None where it hardly covers them."""
    then = np.interp(chain.at_m, track.at_m, times_s)
    if ((then >= fix_times_s[0]) & (then <= fix_times_s[-1])).mean() < _SHARE:
        return None
    return np.column_stack([np.interp(then, fix_times_s, xy[:, k], left=np.nan, right=np.nan) for k in (0, 1)])


def _rigid(source: FloatArray, target: FloatArray) -> tuple[float, FloatArray, float]:
    """Return turn, shift and root mean square error of the best rigid motion of (n, 2) points onto others."""
    known = np.isfinite(target[:, 0])
    source, target = source[known], target[known]
    turn, rotation, shift = fit_rigid(source, target, np.ones(len(source)))
    error = source @ rotation.T + shift - target
    return turn, shift, float(np.sqrt((error**2).sum(axis=1).mean()))
