"""A track from a GPX, CSV or OXTS file; files are checked and never trusted."""

from __future__ import annotations

import csv
import gzip
import math
from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import DriveError
from interloc.gpx import read_gpx
from interloc.simulate.config import TrackConfig
from interloc.simulate.tracks import LidarTrack, track_from_line, track_from_oxts

MAX_POINTS = 2_000_000
_LAT_NAMES = ("lat", "latitude", "lat_deg")
_LON_NAMES = ("lon", "lng", "long", "longitude", "lon_deg")
_ALT_NAMES = ("alt", "ele", "altitude", "elevation", "height", "alt_m")


def open_track(path: Path, config: TrackConfig | None = None) -> LidarTrack:
    """Read a track of any kind: .gpx, .csv, or else OXTS rows (a file, .gz too, or a folder `oxts/data`).

    Raises
    ------
    DriveError
        The file is none of these, or damaged.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".gpx":
        line = read_gpx(path)
        return track_from_line(line.lonlat, line.alt_m, config)
    if suffix == ".csv":
        return track_from_line(*read_csv(path), config)
    rate = (config or TrackConfig()).rate_hz
    return track_from_oxts(read_oxts(path), rate_hz=rate)


def read_csv(path: Path) -> tuple[FloatArray, FloatArray | None]:
    """Read a track from a CSV file whose header names `lat`, `lon` and, if known, `alt`; other columns are skipped.

    Returns
    -------
    lonlat : (N, 2) float64
        Degrees.
    alt_m : (N,) float64 or None
        Heights, where every point has one.

    Raises
    ------
    DriveError
        The header lacks a column, there are no rows, or a value is not a number.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            sample = file.readline()
            file.seek(0)
            rows = csv.reader(file, delimiter=";" if sample.count(";") > sample.count(",") else ",")
            header = [name.strip().lower() for name in next(rows, [])]
            lat, lon = _column(header, _LAT_NAMES), _column(header, _LON_NAMES)
            alt = _column(header, _ALT_NAMES)
            if lat is None or lon is None:
                raise DriveError(
                    f"{path}: the first line is {sample.strip()[:60]!r}. "
                    "Expected a header that names the columns lat and lon (degrees), and alt (metres) if known."
                )
            points = []
            for row in rows:
                if not row:
                    continue
                points.append((float(row[lat]), float(row[lon]), _number(row[alt]) if alt is not None else math.nan))
                if len(points) > MAX_POINTS:
                    raise DriveError(f"{path}: more than {MAX_POINTS:,} points. Thin the track out first.")
    except (ValueError, IndexError, csv.Error) as error:
        raise DriveError(
            f"{path}: line {rows.line_num} is not a point of a track ({error}). Expected degrees."
        ) from error
    except OSError as error:
        raise DriveError(f"{path}: cannot be read ({error.strerror or error}).") from error
    if not points:
        raise DriveError(f"{path}: no rows below the header. Expected one point of the track per row.")
    return _checked(path, np.array(points))


def read_oxts(path: Path) -> FloatArray:
    """Read OXTS rows: a text file (may be .gz) of one row per scan, or a folder of one file per scan (`oxts/data`).

    Raises
    ------
    DriveError
        There is no such file, or it does not hold numbers.
    """
    try:
        if path.is_dir():
            files = sorted(path.glob("*.txt"))
            if not files:
                raise DriveError(
                    f"{path}: no *.txt in this folder. Expected one OXTS file per scan (`oxts/data` of a drive)."
                )
            return np.array([file.read_text().split() for file in files], dtype=np.float64)
        text = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        return np.array([line.split() for line in text.decode().splitlines() if line.strip()], dtype=np.float64)
    except (ValueError, EOFError, UnicodeDecodeError) as error:
        raise DriveError(f"{path}: not OXTS rows ({error}). Expected 30 numbers per row, one row per scan.") from error
    except OSError as error:
        raise DriveError(f"{path}: cannot be read ({error.strerror or error}).") from error


def _column(header: list[str], names: tuple[str, ...]) -> int | None:
    return next((header.index(name) for name in names if name in header), None)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _checked(path: Path, points: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    lat, lon, alt = points.T
    bad = ~(np.isfinite(lat) & np.isfinite(lon) & (np.abs(lat) <= 90) & (np.abs(lon) <= 180))
    if bad.any():
        k = int(np.argmax(bad))
        raise DriveError(
            f"{path}: point {k + 1} is at latitude {lat[k]}, longitude {lon[k]}. Expected degrees on the earth."
        )
    return np.column_stack([lon, lat]), (alt if np.isfinite(alt).all() else None)
