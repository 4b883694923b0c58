"""geo.csv: a geodetic pose of the LiDAR itself for every scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.drive import Georeference
from interloc.drives.files import listed, missing_numbers, numbers_of, read_text, shown
from interloc.drives.findings import GeoreferenceFileError
from interloc.drives.georeference.geodetic import checked_fixes
from interloc.geometry import rotation_from_rpy

GEO_COLUMNS = ("frame", "lat_deg", "lon_deg", "alt_m", "roll_rad", "pitch_rad", "yaw_rad")


def read_geo_csv(path: Path, root: Path, frames: IntArray) -> Georeference:
    """Read a geo.csv: frame, position and attitude of the LiDAR itself.

    Raises
    ------
    DriveError
        Its columns are others, a row is damaged, or a scan has none.
    """
    name = shown(path, root)
    lines = read_text(path, root).splitlines()
    header = tuple(column.strip() for column in lines[0].split(","))
    missing_columns = [column for column in GEO_COLUMNS if column not in header]
    if missing_columns:
        raise GeoreferenceFileError(
            name, f"line 1: no column {', '.join(missing_columns)}. Expected the header {','.join(GEO_COLUMNS)}."
        )
    columns = [header.index(column) for column in GEO_COLUMNS]
    rows = []
    for number, text in enumerate(lines[1:], start=2):
        if not text.strip():
            continue
        fields = text.split(",")
        if len(fields) != len(header):
            raise GeoreferenceFileError(
                name, f"line {number}: {len(fields)} fields; expected {len(header)} as in the header."
            )
        rows.append(numbers_of([fields[column] for column in columns], path, root, number))
    if not rows:
        raise GeoreferenceFileError(name, "holds a header only. Expected one row a scan.")
    values = np.array(rows)
    numbers, first = np.unique(values[:, 0].astype(np.int64), return_index=True)
    missing = missing_numbers(numbers, frames)
    if len(missing):
        raise GeoreferenceFileError(
            name,
            f"{len(missing):,} of {len(frames):,} scans have no row: frames {listed(missing)}. Expected one a scan.",
        )
    chosen = values[first[np.searchsorted(numbers, frames)]]
    poses = checked_fixes(chosen[:, 1:], name, frames)
    return Georeference(
        lat_deg=poses[:, 0].copy(),
        lon_deg=poses[:, 1].copy(),
        alt_m=poses[:, 2].copy(),
        R_enu_lidar=rotation_from_rpy(poses[:, 3], poses[:, 4], poses[:, 5]),
        source=f"{name} (poses of the LiDAR)",
    )
