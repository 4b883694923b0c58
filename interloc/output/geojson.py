"""GeoJSON (RFC 7946) as we write and read it: one feature a line, the same bytes for the same input.

Where a run has no georeference the same structure carries metres of W and says so (`local`), under another file name:
nothing pretends to be longitude and latitude.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.errors import OutputError
from interloc.files import atomic_write, reason_of

DEGREE_DECIMALS = 9  # 0.1 mm
METRE_DECIMALS = 4
LOCAL_UNITS = "metres in W, the frame of the first LiDAR pose (x forward, y left); not longitude and latitude"
RUN_AGAIN = "Run `interloc detect` again."


def rounded(value: float, decimals: int) -> float | None:
    """Return a number as it is printed; None (null in the file) for what JSON cannot say."""
    return round(float(value), decimals) + 0.0 if math.isfinite(value) else None  # + 0.0: no negative zero


def bearings(values: Iterable[float]) -> list[float]:
    """Return bearings in degrees as they are printed, in [0, 360)."""
    return [round(float(v), 3) % 360.0 + 0.0 for v in values]


def positions(xy: FloatArray, *, local: bool) -> list[list[float]]:
    """Return (N, 2) positions, degrees or metres, as they are printed."""
    decimals = METRE_DECIMALS if local else DEGREE_DECIMALS
    pairs: list[list[float]] = (np.round(xy, decimals) + 0.0).tolist()
    return pairs


def point(position: Sequence[float], properties: dict[str, Any]) -> dict[str, Any]:
    """Return a feature with a Point of one printed position."""
    return {"type": "Feature", "geometry": {"type": "Point", "coordinates": position}, "properties": properties}


def write_collection(path: Path, features: Sequence[dict[str, Any]], *, local: bool) -> None:
    """Write a FeatureCollection, whole or not at all.

    Parameters
    ----------
    path
        The file.
    features
        GeoJSON features with Point or LineString geometries, longitude first, or local metres.
    local
        True for metres of W.

    Raises
    ------
    OutputError
        The file could not be written.
    """
    head: dict[str, Any] = {"type": "FeatureCollection"}
    if local:
        head |= {"local": True, "units": LOCAL_UNITS}
    box = _bbox(features)
    if box is not None:
        head["bbox"] = box
    with atomic_write(path) as handle:
        handle.write(encode(head)[:-1].encode() + b',"features":[')
        for number, feature in enumerate(features):
            handle.write((",\n" if number else "\n").encode() + encode(feature).encode())
        handle.write(b"\n]}\n")


def encode(value: object, *, indent: int | None = None) -> str:
    """Return JSON text; a NaN that got this far is a mistake of ours and raises ValueError."""
    separators = (",", ":") if indent is None else None
    return json.dumps(value, allow_nan=False, ensure_ascii=False, separators=separators, indent=indent)


def _bbox(features: Sequence[dict[str, Any]]) -> list[float] | None:
    """Return the smallest box [west, south, east, north] around all positions; None without any."""
    corners = [
        feature["geometry"]["coordinates"]
        if feature["geometry"]["type"] == "LineString"
        else [feature["geometry"]["coordinates"]]
        for feature in features
        if feature["geometry"] is not None
    ]
    if not corners:
        return None
    every = np.concatenate([np.asarray(c, dtype=np.float64).reshape(-1, 2) for c in corners])
    box: list[float] = [*every.min(axis=0).tolist(), *every.max(axis=0).tolist()]
    return box


@dataclass(frozen=True)
class Collection:
    """The features of a file that was read, with errors that say where they are.

    Attributes
    ----------
    path : Path
        The file.
    features : list of dict
        GeoJSON features.
    """

    path: Path
    features: list[dict[str, Any]]

    def __len__(self) -> int:
        return len(self.features)

    def damaged(self, what: str) -> OutputError:
        """Return the error that says what is wrong with the file."""
        return OutputError(f"{self.path} is damaged: {what}. {RUN_AGAIN}")

    def numbers(self, name: str) -> FloatArray:
        """Return a property as (N,) float64, NaN for null."""
        values = self._values(name)
        for row, value in enumerate(values):
            if not (value is None or _is_number(value)):
                raise self.damaged(f"property {name} of feature {row + 1} is {value!r}, not a number")
        return np.array([math.nan if v is None else v for v in values], dtype=np.float64)

    def integers(self, name: str) -> IntArray:
        """Return a property as (N,) int64, -1 for null."""
        values = self._values(name)
        for row, value in enumerate(values):
            if not (value is None or (isinstance(value, int) and not isinstance(value, bool))):
                raise self.damaged(f"property {name} of feature {row + 1} is {value!r}, not a whole number")
        return np.array([-1 if v is None else v for v in values], dtype=np.int64)

    def lists(self, name: str) -> list[FloatArray]:
        """Return a property that holds a list of numbers in each feature."""
        values = self._values(name)
        for row, value in enumerate(values):
            if not (isinstance(value, list) and all(_is_number(v) for v in value)):
                raise self.damaged(f"property {name} of feature {row + 1} is no list of numbers")
        return [np.array(v, dtype=np.float64) for v in values]

    def points(self) -> FloatArray:
        """Return the coordinates of Point features, (N, 2) float64."""
        pairs = [self.geometry(row, "Point") for row in range(len(self))]
        return self.pairs([pair for pair in pairs if pair is not None], "the coordinates")

    def geometry(self, row: int, kind: str) -> Any:  # noqa: ANN401
        """Return the coordinates of a feature, None where it has no geometry."""
        geometry = self.features[row].get("geometry")
        if geometry is None:
            return None
        if not isinstance(geometry, dict) or geometry.get("type") != kind:
            raise self.damaged(f"feature {row + 1} is no {kind}")
        return geometry.get("coordinates")

    def pairs(self, values: object, what: str) -> FloatArray:
        """Return a list of pairs of numbers as (N, 2) float64."""
        good = isinstance(values, list) and all(
            isinstance(p, list) and len(p) == 2 and all(_is_number(v) for v in p) for p in values
        )
        if not good:
            raise self.damaged(f"{what} are no list of pairs of numbers")
        return np.array(values, dtype=np.float64).reshape(-1, 2)

    def _values(self, name: str) -> list[Any]:
        for row, feature in enumerate(self.features):
            if name not in feature["properties"]:
                raise self.damaged(f"feature {row + 1} has no property {name}")
        return [feature["properties"][name] for feature in self.features]


def read_collection(path: Path) -> Collection:
    """Read a FeatureCollection that `write_collection` wrote.

    Raises
    ------
    OutputError
        The file is missing, no JSON, or no FeatureCollection.
    """
    content = read_json(path)
    features = content.get("features")
    collection = Collection(path, features if isinstance(features, list) else [])
    if content.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise collection.damaged("it is no FeatureCollection")
    for row, feature in enumerate(features):
        if not (isinstance(feature, dict) and isinstance(feature.get("properties"), dict)):
            raise collection.damaged(f"feature {row + 1} has no properties")
    return collection


def read_json(path: Path) -> dict[str, Any]:
    """Read a file that holds a JSON object.

    Raises
    ------
    OutputError
        The file is missing, unreadable or holds something else.
    """
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise OutputError(f"{path} is missing, so the result is not complete. {RUN_AGAIN}") from error
    except OSError as error:
        raise OutputError(f"{path} could not be read: {reason_of(error)}.") from error
    except (ValueError, RecursionError) as error:
        raise OutputError(f"{path} is damaged: it is no JSON ({error}). {RUN_AGAIN}") from error
    if not isinstance(content, dict):
        raise OutputError(f"{path} is damaged: it holds no JSON object. {RUN_AGAIN}")
    return content


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
