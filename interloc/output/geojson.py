"""GeoJSON (RFC 7946) as InterLoc writes and reads it: one feature per line, the same bytes for the same input.

Without georeference the same structure carries metres of W, under another file name and marked as `local`, so that
nobody takes them for longitude and latitude.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import DamagedResultError
from interloc.files import atomic_write, reason_of
from interloc.output.credits import OWN_CREDIT, Credit

DEGREE_DECIMALS = 7  # 1 cm, as OpenStreetMap has it
METRE_DECIMALS = 4
LOCAL_UNITS = "metres in W, the frame of the first LiDAR pose (x forward, y left); not longitude and latitude"
RUN_AGAIN = "Run `interloc detect` again."


def rounded(value: float, decimals: int) -> float | None:
    """Return a number as it is printed; None (null in the file) for NaN and infinity."""
    return round(float(value), decimals) + 0.0 if math.isfinite(value) else None  # + 0.0: no negative zero


def bearings(values: Iterable[float]) -> list[float]:
    """Return bearings in degrees as they are printed, in [0, 360)."""
    return [round(float(v), 3) % 360.0 + 0.0 for v in values]


def positions(xy: FloatArray, *, local: bool) -> list[list[float]]:
    """Return (N, 2) positions, degrees or metres, as they are printed."""
    decimals = METRE_DECIMALS if local else DEGREE_DECIMALS
    pairs: list[list[float]] = (np.round(xy, decimals) + 0.0).tolist()
    return pairs


def write_collection(
    path: Path, features: Sequence[dict[str, Any]], *, local: bool, credit: Credit = OWN_CREDIT
) -> None:
    """Write a FeatureCollection, whole or not at all.

    Parameters
    ----------
    path
        The file.
    features
        GeoJSON features with Point, LineString or Polygon geometries, longitude first, or local metres.
    local
        True for metres of W.
    credit
        Whose data it is, see `interloc.output.layers.Layer.credit`.

    Raises
    ------
    OutputError
        The file could not be written.
    """
    head: dict[str, Any] = {"type": "FeatureCollection"}
    if local:
        head |= {"local": True, "units": LOCAL_UNITS}
    head |= credit.members
    box = box_around((feature["geometry"] for feature in features), local=local)
    if box is not None:
        head["bbox"] = box
    with atomic_write(path) as handle:
        handle.write(encode(head)[:-1].encode() + b',"features":[')
        for number, feature in enumerate(features):
            handle.write((",\n" if number else "\n").encode() + encode(feature).encode())
        handle.write(b"\n]}\n")


def encode(value: object, *, indent: int | None = None) -> str:
    """Return JSON text; a NaN that got this far is a bug and raises ValueError."""
    separators = (",", ":") if indent is None else None
    return json.dumps(value, allow_nan=False, ensure_ascii=False, separators=separators, indent=indent)


def box_around(geometries: Iterable[dict[str, Any] | None], *, local: bool = False) -> list[float] | None:
    """Return the smallest box [west, south, east, north] around geometries; None without any.

    Across the antimeridian west is greater than east (RFC 7946, 5.2), unless they are in local metres.
    """
    corners = [
        np.asarray(geometry["coordinates"], dtype=np.float64).reshape(-1, 2)
        for geometry in geometries
        if geometry is not None
    ]
    if not corners:
        return None
    every = np.concatenate(corners)
    (west, south), (east, north) = every.min(axis=0).tolist(), every.max(axis=0).tolist()
    if not local and east - west > 180.0:
        lon = every[:, 0]
        west, east = float(lon[lon > 0.0].min()), float(lon[lon <= 0.0].max())
    return [west, south, east, north]


def damaged(path: Path, what: str) -> DamagedResultError:
    """Return the error about a damaged file of a result."""
    return DamagedResultError(f"{path} is damaged: {what}. {RUN_AGAIN}")


def read_file(path: Path) -> bytes:
    """Return the content of a file of a result.

    Raises
    ------
    DamagedResultError
        The file is missing or unreadable.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DamagedResultError(f"{path} is missing, so the result is not complete. {RUN_AGAIN}") from error
    except OSError as error:
        raise DamagedResultError(f"{path} could not be read: {reason_of(error)}.") from error


def read_json(path: Path) -> dict[str, Any]:
    """Read a file of a result that holds a JSON object.

    Raises
    ------
    OutputError
        The file is missing, unreadable or holds something else.
    """
    try:
        content = json.loads(read_file(path))
    except (ValueError, RecursionError) as error:
        raise damaged(path, f"it is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise damaged(path, "it does not hold a JSON object")
    return content
