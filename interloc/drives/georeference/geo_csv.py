"""geo.csv: a geodetic pose of the LiDAR itself for every scan."""

from __future__ import annotations

import math
from array import array
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.drive import Georeference
from interloc.drives.files import GeoreferenceFile, listed
from interloc.drives.georeference.geodetic import checked_fixes
from interloc.files import atomic_write
from interloc.geometry import rotation_from_rpy, rpy_from_rotation

GEO_COLUMNS = ("frame", "lat_deg", "lon_deg", "alt_m", "roll_rad", "pitch_rad", "yaw_rad")

STD_COLUMN = "position_std_m"
"""Optional: one-sigma uncertainty of the position along each horizontal axis, metres; empty where it is unknown."""

_DIGITS = (".9f", ".9f", ".3f", ".6f", ".6f", ".6f")
_STD_DIGITS = ".4f"


def read_geo_csv(file: GeoreferenceFile, frames: IntArray) -> Georeference:
    """Read a geo.csv: frame, position and attitude of the LiDAR itself, and if known the uncertainty of the position.

    Raises
    ------
    GeoreferenceError
        It has other columns, a row is damaged, or a scan has none.
    """
    lines = file.lines()
    header = tuple(column.strip() for column in lines[0].split(","))
    missing_columns = [column for column in GEO_COLUMNS if column not in header]
    if missing_columns:
        separator = next((name for sign, name in ((";", "semicolons"), ("\t", "tabs")) if sign in lines[0]), None)
        if separator is not None:
            raise file.fault(
                f"its columns are separated by {separator}. Expected commas, and decimals with a point: "
                f"{','.join(GEO_COLUMNS)}. Usual cause: a spreadsheet's export where numbers are written with a comma.",
                1,
            )
        raise file.fault(f"no column {', '.join(missing_columns)}. Expected the header {','.join(GEO_COLUMNS)}.", 1)
    columns = [header.index(column) for column in GEO_COLUMNS]
    std_column = header.index(STD_COLUMN) if STD_COLUMN in header else None
    rows, stds = array("d"), array("d")
    for number, text in enumerate(lines[1:], start=2):
        if not text.strip():
            continue
        fields = text.split(",")
        if len(fields) != len(header):
            raise file.fault(f"{len(fields)} fields; expected {len(header)} as in the header.", number)
        rows.extend(file.numbers([fields[column] for column in columns], number))
        if std_column is not None:
            stds.extend(file.numbers([fields[std_column]], number) if fields[std_column].strip() else [math.nan])
    if not rows:
        raise file.fault("holds a header only. Expected one row per scan.")
    values = np.frombuffer(rows).reshape(-1, len(columns))
    numbers, first = np.unique(values[:, 0].astype(np.int64), return_index=True)
    missing = np.setdiff1d(frames, numbers)
    if len(missing):
        raise file.fault(
            f"{len(missing):,} of {len(frames):,} scans have no row: frames {listed(missing)}. Expected one per scan."
        )
    chosen = first[np.searchsorted(numbers, frames)]
    poses = checked_fixes(file, values[chosen, 1:], frames)
    std = None if std_column is None else np.frombuffer(stds)[chosen]
    return Georeference(
        lat_deg=poses[:, 0].copy(),
        lon_deg=poses[:, 1].copy(),
        alt_m=poses[:, 2].copy(),
        R_enu_lidar=rotation_from_rpy(poses[:, 3], poses[:, 4], poses[:, 5]),
        source=f"{file.name} (poses of the LiDAR)",
        position_std_m=None if std is None else np.where(std > 0, std, np.nan),
    )


def geo_csv_text(frames: IntArray, georeference: Georeference, *, exact: bool = False) -> str:
    """Return the text of a geo.csv with one row per scan: what `read_geo_csv` reads.

    Parameters
    ----------
    exact : bool
        Write all digits, for a copy that gives the same results; else a tenth of a millimetre.
    """
    columns = (georeference.lat_deg, georeference.lon_deg, georeference.alt_m)
    angles = rpy_from_rotation(georeference.R_enu_lidar)
    stds = [] if georeference.position_std_m is None else georeference.position_std_m.tolist()
    rows = [",".join([*GEO_COLUMNS, *([STD_COLUMN] if stds else [])])]
    for row, (frame, *values) in enumerate(np.column_stack([frames, *columns, angles]).tolist()):
        texts = list(map(repr, values) if exact else map(format, values, _DIGITS))
        if stds:
            std = stds[row]
            texts.append("" if math.isnan(std) else repr(std) if exact else format(std, _STD_DIGITS))
        rows.append(",".join([str(int(frame)), *texts]))
    return "\n".join(rows) + "\n"


def write_geo_csv(path: Path, frames: IntArray, georeference: Georeference) -> None:
    """Write a geo.csv, whole or not at all.

    Raises
    ------
    OutputError
        The file could not be written.
    """
    with atomic_write(path) as file:
        file.write(geo_csv_text(frames, georeference).encode())
