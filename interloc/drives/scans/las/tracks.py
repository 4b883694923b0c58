"""The trajectory of a mobile mapping vehicle: a table with a header (CSV), or TUM poses in world coordinates.

Its times are in the clock of the cloud.
"""

import re
from dataclasses import dataclass
from pathlib import Path

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
_KINDS = (("time", "x", "y", "z"), ("time", "lon", "lat", "z"))
_HEADER = "Expected a header such as time,x,y,z or time,lat,lon,alt."
_UNIT = re.compile(r"_(s|sec|seconds|m|deg|degrees)$")

ADJUSTED_S = 1_315_964_782  # from 1970 to the beginning of adjusted standard GPS time
MAX_DISTANCE_M = 100.0
"""Median horizontal distance of the points from the vehicle at their time; those of streets are 10 to 30 m away."""

_LEAP_SECONDS = 18.0  # by which GPS is ahead of UTC since 2017
_COVERED, _USUAL_M = 0.5, 40.0


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
        track = _from_table(file)
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


def _from_table(file: SourceFile) -> SurveyTrack:
    """Read a table of numbers with a header; the columns may have any of the usual names, and units."""
    lines = file.lines()
    start = next(row for row, text in enumerate(lines) if text.strip())
    names = _names(lines[start])
    if names is None:
        raise file.fault(
            f"starts with {len(_split(lines[start]))} numbers, and nothing says what they are. {_HEADER}", start + 1
        )
    columns = _columns(names)
    kind = min(_KINDS, key=lambda each: len(set(each) - set(columns)))
    if missing := [quantity for quantity in kind if quantity not in columns]:
        raise file.fault(f"has no column for {', '.join(missing)} among {', '.join(names)[:200]}. {_HEADER}", start + 1)
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
        raise file.fault(f"holds a header only. {_HEADER}")
    table = np.array(values)
    table = table[_ascending(table, file, at)]
    geographic = "lon" in kind
    _check_place(table[:, 1:], file, geographic=geographic)
    return SurveyTrack(file, table[:, 0].copy(), table[:, 1:].copy(), geographic)


def _ascending(table: FloatArray, file: SourceFile, at: list[int]) -> FloatArray:
    """Return the rows to keep: those of a time that the row before does not have; refuse times that run backwards."""
    steps = np.diff(table[:, 0])
    if (steps < 0).any():
        row = int(np.argmax(steps < 0)) + 1
        week = " Usual cause: seconds of the GPS week, which begin anew on Saturday night; split the drive there."
        usual = " Usual cause: two trajectories in one file." if table[row - 1, 0] < 600_000 else week
        before, after = table[row - 1, 0], table[row, 0]
        raise file.fault(f"time runs backwards ({before:.3f} s, then {after:.3f} s).{usual}", at[row])
    return np.concatenate([[True], steps > 0])


def _check_place(position: FloatArray, file: SourceFile, *, geographic: bool) -> None:
    if not geographic:
        if np.abs(position).max() > 1e8:
            raise file.fault("a position is more than 100,000 km from the origin. Expected metres.")
        return
    if np.abs(position[:, 1]).max() > 89 or np.abs(position[:, 0]).max() > 360 or np.abs(position[:, 2]).max() > 20_000:
        raise file.fault("a latitude, longitude or altitude is no place to drive. Expected degrees and metres.")
    if ((position[:, 0] == 0) & (position[:, 1] == 0)).any():
        raise file.fault("latitude and longitude are 0 somewhere: the receiver had no fix. Leave those rows out.")


def check_clock(
    times_s: FloatArray, points: FloatArray, cloud: Cloud, track_s: FloatArray, track_xy: FloatArray, file: SourceFile
) -> float:
    """Return how far the vehicle, (P,) times and (P, 2) places, was from points of the cloud: the median, metres."""

    def away_m(late_s: float) -> float:
        shifted = times_s - late_s
        inside = (shifted >= track_s[0]) & (shifted <= track_s[-1])
        if inside.mean() < _COVERED:
            return np.inf
        at = np.stack([np.interp(shifted[inside], track_s, axis) for axis in track_xy.T], axis=1)
        return float(np.median(np.linalg.norm(points[inside, :2] - at, axis=1)))

    distance_m, shift_s = away_m(0.0), min((_LEAP_SECONDS, -_LEAP_SECONDS), key=away_m)
    if distance_m > _USUAL_M and away_m(shift_s) < min(distance_m, MAX_DISTANCE_M) / 2:
        raise file.fault(
            f"is {shift_s:+g} s off the clock of {cloud.file.name}: so shifted the vehicle was {away_m(shift_s):.0f} m "
            f"away from the points when they were measured, else {distance_m:.0f} m. Usual cause: UTC beside GPS time. "
            f"Add {shift_s:+g} to the times of the trajectory."
        )
    if distance_m == np.inf:
        raise file.fault(
            f"covers {track_s[0]:.3f} s to {track_s[-1]:.3f} s, and the points of {cloud.file.name} were measured from "
            f"{times_s.min():.3f} s to {times_s.max():.3f} s. Expected the clock of the cloud. Usual cause: another "
            "clock, or the trajectory of another drive or day. Adjusted standard time, the usual one of clouds, is GPS "
            "seconds since 1980 less 1e9: add 604800 for every GPS week, and take off 1e9, where the trajectory has "
            f"seconds of the week; take off {ADJUSTED_S} where it has UNIX time."
        )
    if distance_m > MAX_DISTANCE_M:
        raise file.fault(
            f"was {distance_m:,.0f} m away from the points of {cloud.file.name} when they were measured (median); "
            f"expected at most {MAX_DISTANCE_M:g} m. Usual cause: the trajectory of another drive, another clock, or a "
            "cloud in another coordinate system than stated (--crs)."
        )
    return distance_m
