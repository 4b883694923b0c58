"""GeoJSON (RFC 7946) as InterLoc writes and reads it: one feature per line, the same bytes for the same input.

Without georeference the same structure carries metres of W, under another file name and marked as `local`, so that
nobody takes them for longitude and latitude. Lines and polygons across the antimeridian are cut there in
files (RFC 7946, section 3.1.9) and whole for InterLoc itself; two neighbouring positions that are more than half of the
globe apart are taken to be neighbours across it.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, Literal, NotRequired, TypeVar, cast

import numpy as np
from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from interloc.arrays import FloatArray, JsonObject
from interloc.errors import DamagedResultError
from interloc.files import atomic_write, reason_of, write_file
from interloc.output.credits import OWN_CREDIT, Credit
from interloc.results import DriveResult
from interloc.wording import first_fault

DEGREE_DECIMALS = 7  # 1 cm, as OpenStreetMap has it
METRE_DECIMALS = 4
LOCAL_UNITS = "metres in W, the frame of the first LiDAR pose (x forward, y left); not longitude and latitude"
RUN_AGAIN = "Run `interloc run` again."


class GeometryObject(TypedDict):
    """A geometry of GeoJSON."""

    type: str
    coordinates: Any


class Feature(TypedDict):
    """A feature of a layer as GeoJSON; the models of the layer say what its properties and details are."""

    type: Literal["Feature"]
    id: NotRequired[int | str]  # results of versions before have none
    geometry: GeometryObject | None
    properties: JsonObject
    details: NotRequired[JsonObject]
    """What InterLoc itself reads again, and GIS do not show."""
    world_xy_m: NotRequired[list[list[float]]]


class FeatureCollection(TypedDict):
    """A GeoJSON file of a layer; its head has more."""

    type: Literal["FeatureCollection"]
    features: list[Feature]


_COMPACT = json.JSONEncoder(allow_nan=False, ensure_ascii=False, separators=(",", ":"))  # made once, for every feature

_DEPTHS = {"Point": 0, "MultiPoint": 1, "LineString": 1, "MultiLineString": 2, "Polygon": 2, "MultiPolygon": 3}
"""Type of a geometry -> how deep its positions are nested."""


def rounded(value: float, decimals: int) -> float | None:
    """Return a number as it is printed; None (null in the file) for NaN and infinity."""
    return round(float(value), decimals) + 0.0 if math.isfinite(value) else None  # + 0.0: no negative zero


def bearings(values: Iterable[float]) -> list[float]:
    """Return bearings in degrees as they are printed, in [0, 360)."""
    return [round(float(v), 3) % 360.0 + 0.0 for v in values]


def positions(xy: FloatArray, *, local: bool) -> list[list[float]]:
    """Return (N, 2) positions, degrees or metres, as they are printed."""
    decimals = METRE_DECIMALS if local else DEGREE_DECIMALS
    printed = np.round(xy, decimals) + 0.0
    if not local:
        lon = printed[..., 0]
        beyond = np.abs(lon) > 180.0  # a little way across the antimeridian
        lon[beyond] = np.round((lon[beyond] + 180.0) % 360.0 - 180.0, decimals)
    pairs: list[list[float]] = printed.tolist()
    return pairs


def line_of(places: list[list[float]]) -> list[list[float]]:
    """Return the positions of a LineString, which has two or more (RFC 7946, 3.1.4): a single one is repeated."""
    return places * 2 if len(places) == 1 else places


def as_printed(result: DriveResult) -> DriveResult:
    """Return a run with the positions of its files, so that a run and its result folder get the same report."""

    def printed(table: Any) -> Any:  # noqa: ANN401 - one of three tables
        if table.lonlat is None:
            return table
        return replace(table, lonlat=np.array(positions(table.lonlat, local=False)).reshape(-1, 2))

    tables = ("keyframes", "detections", "intersections")
    return replace(result, **{name: printed(getattr(result, name)) for name in tables})


def write_collection(
    path: Path,
    features: Sequence[Feature],
    *,
    local: bool,
    credit: Credit = OWN_CREDIT,
    origin: Mapping[str, Any] | None = None,
) -> None:
    """Write GeoJSON features, longitude first, or local metres of W, as a FeatureCollection: whole or not at all.

    `credit` says whose data it is (`interloc.output.layers.Layer.credit`), `origin` of which result
    (`interloc.output.properties.origin_of`).
    """
    head: JsonObject = {"type": "FeatureCollection", **(origin or {})}
    if local:
        head |= {"local": True, "units": LOCAL_UNITS}
    else:
        features = [{**feature, "geometry": cut(feature["geometry"])} for feature in features]
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
    if indent is None:
        return _COMPACT.encode(value)
    return json.dumps(value, allow_nan=False, ensure_ascii=False, indent=indent)


def write_record(path: Path, record: Mapping[str, Any]) -> None:
    """Write a JSON object that people may read, whole or not at all."""
    write_file(path, encode(record, indent=2) + "\n")


def box_around(geometries: Iterable[GeometryObject | None], *, local: bool = False) -> list[float] | None:
    """Return the smallest box [west, south, east, north] around geometries; None without any.

    Across the antimeridian west is greater than east (RFC 7946, 5.2), unless they are in local metres.
    """
    corners = [place for geometry in geometries if geometry is not None for place in flat_positions(geometry)]
    if not corners:
        return None
    every = np.array(corners, dtype=np.float64)
    (west, south), (east, north) = every.min(axis=0).tolist(), every.max(axis=0).tolist()
    if not local and east - west > 180.0:
        lon = every[:, 0]
        west, east = float(lon[lon > 0.0].min()), float(lon[lon <= 0.0].max())
    return [west, south, east, north]


def damaged(path: Path, what: str) -> DamagedResultError:
    """Return the error about a damaged file of a result."""
    return DamagedResultError(f"{path} is damaged: {what}. {RUN_AGAIN}")


def read_file(path: Path) -> bytes:
    """Return the content of a file of a result; a DamagedResultError says that it is missing or unreadable."""
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise DamagedResultError(f"{path} is missing, so the result is not complete. {RUN_AGAIN}") from error
    except OSError as error:
        raise DamagedResultError(f"{path} could not be read: {reason_of(error)}.") from error


def invalid(path: Path, error: ValidationError) -> DamagedResultError:
    """Return the error about a file of a result that is not as its model has it."""
    return damaged(path, first_fault(error))


def read_json(path: Path) -> JsonObject:
    """Read a file of a result that holds a JSON object; a DamagedResultError says what it is instead."""
    return _object_of(path, read_file(path))


def _object_of(path: Path, text: bytes) -> JsonObject:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise damaged(path, f"it is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise damaged(path, "it does not hold a JSON object")
    return content


_Typed = TypeVar("_Typed")
_model_of: Any = cache(TypeAdapter)  # making one takes longer than reading with it


def read_as(kind: type[_Typed], path: Path) -> _Typed:
    """Read a JSON object of a kind, a TypedDict, which may hold more; a DamagedResultError says what is not so."""
    text = read_file(path)
    content = _object_of(path, text)
    try:
        _model_of(kind).validate_json(text, strict=True)
    except ValidationError as error:
        raise invalid(path, error) from error
    return cast("_Typed", content)


# the antimeridian ---------------------------------------------------------------------------------------------------


def flat_positions(geometry: GeometryObject) -> list[Any]:
    """Return all positions of a GeoJSON geometry."""
    nested = [geometry["coordinates"]]
    for _ in range(_DEPTHS[geometry["type"]]):
        nested = list(chain.from_iterable(nested))
    return nested


def cut(geometry: GeometryObject | None) -> GeometryObject | None:
    """Return a GeoJSON geometry as it stands in files.

    A LineString or Polygon across the antimeridian becomes a MultiLineString or MultiPolygon whose parts meet there,
    at 180 and -180 degrees. Everything else is returned as it is.
    """
    if geometry is None or geometry["type"] not in {"LineString", "Polygon"}:
        return geometry
    is_line = geometry["type"] == "LineString"
    rings = [geometry["coordinates"]] if is_line else geometry["coordinates"]
    if not any(abs(b[0] - a[0]) > 180.0 for ring in rings for a, b in pairwise(ring)):
        return geometry
    parts = _cut_line(rings[0]) if is_line else _cut_polygon(rings)
    if len(parts) == 1:  # it only touches the antimeridian
        return {**geometry, "coordinates": parts[0]}
    return {**geometry, "type": f"Multi{geometry['type']}", "coordinates": parts}


def joined(geometry: GeometryObject | None) -> GeometryObject | None:
    """Return a GeoJSON geometry of a file as one line or one polygon: what `cut` made its parts of."""
    if geometry is None or geometry["type"] not in {"MultiLineString", "MultiPolygon"}:
        return geometry
    parts = geometry["coordinates"]
    if geometry["type"] == "MultiLineString":
        last = len(parts) - 1
        inner = (part[number > 0 : len(part) - (number < last)] for number, part in enumerate(parts))
        return {**geometry, "type": "LineString", "coordinates": list(chain.from_iterable(inner))}
    import shapely  # noqa: PLC0415 - slow to import, and rarely needed

    # Each part lies on one side; those of the west are moved behind 180 degrees, where they touch the others.
    moved = [[_moved(ring, 360.0 if part[0][0][0] < 0.0 else 0.0) for ring in part] for part in parts]
    whole = shapely.union_all([shapely.Polygon(shell, holes) for shell, *holes in moved])
    return {**geometry, "type": "Polygon", "coordinates": _rings(whole, 0.0)}


def _cut_line(line: Sequence[Any]) -> list[list[list[float]]]:
    """Return the parts of a line in the order of travel."""
    lonlat = _unwrapped(line)
    lonlat[(lonlat[:, 0] - 180.0) % 360.0 == 0.0, 0] -= 10.0**-DEGREE_DECIMALS  # so that only cuts lie on it
    globe = np.floor((lonlat[:, 0] + 180.0) / 360.0)
    ends = np.flatnonzero(np.diff(globe))
    cuts = []
    for (lon, lat), (next_lon, next_lat), number in zip(
        lonlat[ends], lonlat[ends + 1], np.maximum(globe[ends], globe[ends + 1]), strict=True
    ):
        meridian = 360.0 * number - 180.0
        cuts.append([meridian, lat + (meridian - lon) / (next_lon - lon) * (next_lat - lat)])
    parts = np.split(lonlat, ends + 1)
    return [
        positions(
            np.array([*cuts[max(i - 1, 0) : i], *part, *cuts[i : i + 1]]) - [360.0 * globe[first], 0.0], local=False
        )
        for i, (part, first) in enumerate(zip(parts, [0, *(ends + 1)], strict=True))
    ]


def _cut_polygon(rings: Sequence[Any]) -> list[list[list[list[float]]]]:
    """Return the parts of a polygon, from west to east."""
    import shapely  # noqa: PLC0415 - slow to import, and rarely needed

    shell, *holes = (_unwrapped(ring) for ring in rings)
    # A hole begins where its first position lies, which may be a globe away from the shell.
    holes = [_moved(hole, 360.0 * round((shell[0, 0] - hole[0, 0]) / 360.0)) for hole in holes]
    whole = shapely.Polygon(shell, holes)
    parts = []
    for globe in (-1, 0, 1):
        side = shapely.box(360.0 * globe - 180.0, -90.0, 360.0 * globe + 180.0, 90.0)
        inside = shapely.get_parts(shapely.intersection(whole, side))
        parts += [_rings(each, -360.0 * globe) for each in inside if each.area > 0.0]
    return parts


def _unwrapped(line: Sequence[Any]) -> FloatArray:
    """Return positions without the jump: beyond 180 degrees they go on."""
    lonlat = np.array(line, dtype=np.float64)[:, :2]
    lonlat[:, 0] = np.round(np.unwrap(lonlat[:, 0], period=360.0), DEGREE_DECIMALS)
    return lonlat


def _rings(polygon: Any, shift: float) -> list[list[list[float]]]:  # noqa: ANN401 - of shapely
    from shapely.geometry.polygon import orient  # noqa: PLC0415

    turned = orient(polygon)  # counter-clockwise (RFC 7946, 3.1.6)
    return [positions(_moved(ring.coords, shift), local=False) for ring in (turned.exterior, *turned.interiors)]


def _moved(ring: Sequence[Any] | FloatArray, shift: float) -> FloatArray:
    return np.array(ring, dtype=np.float64)[:, :2] + [shift, 0.0]
