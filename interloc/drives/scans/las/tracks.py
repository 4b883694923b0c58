"""The trajectory of a mobile mapping vehicle: a table with a header (CSV), or TUM poses in world coordinates.

GPS times come as seconds of the week, as seconds since 6 January 1980, as these less 1e9 (adjusted standard time of
LAS), and as seconds since 1970 with or without leap seconds. Headers name the clock of a cloud, often wrongly, and
trajectories do not name theirs: so each is tried, and the one taken by which the vehicle was where the points are.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import SourceFile, is_number
from interloc.drives.layouts import TRACK_ENDINGS
from interloc.drives.poses.files import looks_like_tum, read_tum
from interloc.drives.scans.las.clouds import Cloud

_SBET = (".sbet", ".out")
_HEAD_BYTES = 65536

_NAMES = {  # in lower case, without units
    "time": "time times t timestamp gps_time gpstime gps_seconds seconds sec sow gps_sow unix_time utc_time",
    "x": "x easting east e pos_x utm_x utm_easting",
    "y": "y northing north n pos_y utm_y utm_northing",
    "z": "z height elevation ele h alt altitude up pos_z h_ell hell ellipsoidal_height ortho_height orthometric_height",
    "lat": "lat latitude",
    "lon": "lon lng long longitude",
}
_UNIT = re.compile(r"_(s|sec|seconds|m|deg|degrees|rad|radians)$")

MAX_DISTANCE_M = 300.0
"""Median horizontal distance of the points from the vehicle at their time; scanners of streets see 100 to 200 m."""

_WEEK_S = 604_800.0
_GPS_EPOCH_UNIX_S = 315_964_800.0
_FIRST_LEAP_SECONDS = 13  # by which GPS is ahead of UTC before the first of these, and one more from each on (IERS)
_LEAPS_S = (1_136_073_600.0, 1_230_768_000.0, 1_341_100_800.0, 1_435_708_800.0, 1_483_228_800.0)  # UNIX time
_COVERED = 0.5


@dataclass(frozen=True)
class SurveyTrack:
    """Where the vehicle was, and when."""

    file: SourceFile
    times_s: FloatArray
    """(P,) float64: strictly ascending, in whichever clock."""
    position: FloatArray
    """(P, 3) float64: easting, northing, height; or longitude and latitude in degrees, altitude where `geographic`."""
    geographic: bool


def find_tracks(folders: list[Path]) -> list[Path]:
    """Return the files in some folders that look like a trajectory."""
    return [
        path
        for path in dict.fromkeys(each for folder in folders for each in sorted(folder.iterdir()))
        if is_track(path)
    ]


def is_track(path: Path) -> bool:
    """Return whether a file looks like a trajectory."""
    suffix = path.suffix.lower()
    is_named_so = suffix in TRACK_ENDINGS and path.is_file()
    return is_named_so and (suffix in _SBET or looks_like_tum(path) or is_table(path))


def is_table(path: Path) -> bool:
    """Return whether a file is a table with a header that names a time and a place."""
    try:
        with path.open("rb") as file:
            text = file.read(_HEAD_BYTES).decode("utf-8-sig", errors="replace").lstrip()
    except OSError:
        return False
    header = _names(text.splitlines()[0]) if text and "\0" not in text else None
    columns = set(_columns(header or []))
    return any({"time", *place} <= columns for place in (("x", "y"), ("lat", "lon")))


def read_track(file: SourceFile) -> SurveyTrack:
    """Read a trajectory, whichever its format."""
    if not file.path.is_file():
        raise file.fault(
            "is missing. Expected the trajectory of the vehicle: a table with a header "
            "(time,x,y,z or time,lat,lon,alt), or TUM poses."
        )
    if file.path.suffix.lower() in _SBET:
        raise file.fault(
            "is an SBET (17 float64 per record) by its name, which is not read. Write its first columns as a table, in "
            'degrees: np.savetxt("track.csv", np.fromfile(FILE).reshape(-1, 17)[:, :4] * [1, 180 / np.pi, 180 / np.pi, '
            '1], "%.9f", ",", header="time,lat,lon,alt", comments="").'
        )
    if looks_like_tum(file.path):
        timed = read_tum(file)
        track = SurveyTrack(file, timed.times_s, timed.poses[:, :3, 3], geographic=False)
    else:
        kinds = [("time", "x", "y", "z"), ("time", "lon", "lat", "z")]
        table = read_table(file, kinds, "Expected a header such as time,x,y,z or time,lat,lon,alt.")
        geographic = "lon" in table.columns
        values = table.values[_ascending(table.values, file, table.at)]
        _check_place(values[:, 1:4], file, geographic=geographic)
        track = SurveyTrack(file, values[:, 0].copy(), values[:, 1:4].copy(), geographic)
    if len(track.times_s) < 2:
        raise file.fault("holds one pose only. Expected the trajectory of a drive.")
    return track


def _names(line: str) -> list[str] | None:
    """Return the names in a header, in lower case without units in brackets; None where it is a line of numbers."""
    fields = _split(re.sub(r"^[#%/\s]+", "", line.strip()))
    if any(is_number(text) for text in fields):
        return None
    names = [re.sub(r"[\[(]([a-z]+)[\])]", r"_\1", text.lower()) for text in fields]
    return [re.sub(r"[^a-z0-9]+", "_", name).strip("_") for name in names]


def _split(line: str) -> list[str]:
    separator = next((each for each in ",;\t" if each in line), None)
    return [text.strip().strip('"') for text in line.split(separator)]


def _columns(names: list[str]) -> dict[str, int]:
    columns: dict[str, int] = {}
    for quantity, known in _NAMES.items():
        at = next((column for column, name in enumerate(names) if _UNIT.sub("", name) in known.split()), None)
        if at is not None:
            columns[quantity] = at
    return columns


class Table(NamedTuple):
    """The columns of a table that were asked for."""

    columns: dict[str, str]
    """Quantity -> what the header calls it."""
    values: FloatArray
    """(N, C) float64."""
    at: list[int]
    """Line of each row, from 1."""


def read_table(file: SourceFile, kinds: Sequence[Sequence[str]], expected: str) -> Table:
    """Read a table of numbers with a header; the columns may have any of the usual names, and units.

    Of the kinds of quantities (time, x, y, z, lat, lon), the first of which there are all is read; `expected` is what
    messages say that the header should be.
    """
    lines = file.lines()
    start = next(row for row, text in enumerate(lines) if text.strip())
    names = _names(lines[start])
    if names is None:
        raise file.fault(
            f"starts with {len(_split(lines[start]))} numbers, and nothing says what they are. {expected}",
            start + 1,
        )
    columns = _columns(names)
    kind = min(kinds, key=lambda each: len(set(each) - set(columns)))
    if missing := [quantity for quantity in kind if quantity not in columns]:
        raise file.fault(
            f"has no column for {', '.join(missing)} among {', '.join(names)[:200]}. {expected}", start + 1
        )
    values, at = [], []
    for number, text in enumerate(lines[start + 1 :], start=start + 2):
        if not text.strip() or text.lstrip().startswith(("#", "%")):
            continue
        fields = _split(text)
        if len(fields) != len(names):
            raise file.fault(f"{len(fields)} fields; expected {len(names)} as in the header.", number)
        values.append(file.numbers([fields[columns[quantity]] for quantity in kind], number))
        at.append(number)
    if not values:
        raise file.fault(f"holds a header only. {expected}")
    return Table({quantity: names[columns[quantity]] for quantity in kind}, np.array(values), at)


def _ascending(table: FloatArray, file: SourceFile, at: list[int]) -> FloatArray:
    """Return the rows to keep: those of a time that the row before does not have; refuse times that run backwards."""
    steps = np.diff(table[:, 0])
    if (steps < 0).any():
        row = int(np.argmax(steps < 0)) + 1
        week = " Usual cause: seconds of the GPS week, which begin anew on Saturday night; split the drive there."
        usual = " Usual cause: two trajectories in one file." if table[row - 1, 0] < 600_000 else week
        before, after = table[row - 1, 0], table[row, 0]
        raise file.fault(f"time runs backwards ({before:.3f} s, then {after:.3f} s).{usual}", at[row])
    kept: FloatArray = np.concatenate([[True], steps > 0])
    return kept


def _check_place(position: FloatArray, file: SourceFile, *, geographic: bool) -> None:
    if not geographic:
        if np.abs(position).max() > 1e8:
            raise file.fault("a position is more than 100,000 km from the origin. Expected metres.")
        return
    if np.abs(position[:, 1]).max() > 89 or np.abs(position[:, 0]).max() > 360 or np.abs(position[:, 2]).max() > 20_000:
        raise file.fault("a latitude, longitude or altitude is no place to drive. Expected degrees and metres.")
    if ((position[:, 0] == 0) & (position[:, 1] == 0)).any():
        raise file.fault("latitude and longitude are 0 somewhere: the receiver had no fix. Leave those rows out.")


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
    """Find the clock by which the vehicle, (P,) times and (P, 2) places, was where some points of the cloud are."""
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
    }
    candidates = {0.0: "the same clock"}
    for seconds in (leap, -leap, 18.0, -18.0):
        candidates.setdefault(seconds, f"clocks that differ by {seconds:+g} leap seconds")
    for theirs, to_gps in clocks.items():
        for ours, of_cloud in clocks.items():
            candidates.setdefault(to_gps - of_cloud, f"the trajectory in {theirs}, the cloud in {ours}")
        if 0 <= middle_s <= _WEEK_S + 3600:
            whole = round((middle_s - first_s - to_gps) / _WEEK_S) * _WEEK_S
            candidates.setdefault(to_gps + whole, f"the trajectory in {theirs}, the cloud in seconds of the GPS week")
        if 0 <= first_s <= _WEEK_S + 3600:
            whole = round((middle_s + to_gps - first_s) / _WEEK_S) * _WEEK_S
            candidates.setdefault(whole - to_gps, f"the trajectory in seconds of the GPS week, the cloud in {theirs}")
    return candidates
