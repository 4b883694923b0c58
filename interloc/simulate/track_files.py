"""A track from a GPX, CSV or OXTS file; files are checked and never trusted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import SourceFile, list_numbered
from interloc.drives.georeference.oxts import read_oxts_folder, read_oxts_rows
from interloc.drives.scans.las.tracks import read_table
from interloc.gpx import read_gpx
from interloc.simulate.config import TrackConfig
from interloc.simulate.tracks import LidarTrack, track_from_line, track_from_oxts


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
        The header lacks a column, there are no rows, or a value is not a number or not on the earth.
    """
    file = SourceFile(path, Path())
    expected = "Expected a header that names the columns lat and lon (degrees), and alt (metres) if known."
    table = read_table(file, [("lon", "lat", "z"), ("lon", "lat")], expected, blank="z")
    lonlat, alt = table.values[:, :2], table.values[:, 2:]
    beyond = np.abs(lonlat) > (180.0, 90.0)
    if beyond.any():
        row = int(np.argmax(beyond.any(axis=1)))
        lon, lat = lonlat[row]
        raise file.fault(f"latitude {lat:g}, longitude {lon:g}. Expected degrees on the earth.", table.at[row])
    return lonlat.copy(), alt[:, 0].copy() if alt.size and np.isfinite(alt).all() else None


def read_oxts(path: Path) -> FloatArray:
    """Read OXTS rows: a text file (may be .gz) of one row per scan, or a folder of one file per scan (`oxts/data`).

    Raises
    ------
    DriveError
        There is no such file, or it does not hold such rows.
    """
    file = SourceFile(path, Path())
    return read_oxts_folder(file, list_numbered(file, ".txt").numbers) if path.is_dir() else read_oxts_rows(file)
