"""Tracks in GPX files, as phones, watches and navigation devices write them."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import DriveError
from interloc.files import reason_of

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
    alt_m: FloatArray | None = None
    """(P,) float64 or None: heights, where every point has one."""


def read_gpx(path: Path) -> GpxTrack:
    """Read the tracks (or else the routes) of a GPX file as one; a DriveError says why it has none."""
    import gpxpy  # noqa: PLC0415 - needed for this alone
    from gpxpy.gpx import GPXException  # noqa: PLC0415

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
    times = _of_all([None if point.time is None else point.time.timestamp() for point in points])
    in_order = times is not None and bool((np.diff(times) >= 0.0).all())
    return GpxTrack(lonlat, times if in_order else None, path.name, _of_all([point.elevation for point in points]))


def _of_all(values: list[float | None]) -> FloatArray | None:
    known = np.array([value for value in values if value is not None and np.isfinite(value)], dtype=np.float64)
    return known if len(known) == len(values) else None
