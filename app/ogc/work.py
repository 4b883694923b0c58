"""The features of a result, cut into chunks for the index of the database.

A chunk holds some hundred features of a layer in the order of its file, which is that of the drive: they lie close to
each other. Its columns are the properties that can be asked for, each by itself, and these:

- ``@id``: the ids of the features within their layer and job;
- ``@box``: west, south, east, north of each, float64; across the 180th meridian east is more than 180;
- ``@time``: first and last second since 1970 of each; left out where no feature has a time;
- ``@shape``: geometries as WKB, of layers that are no points; across the 180th meridian longitudes go on beyond 180;
- ``@content``: geometry and properties of each as the members of a GeoJSON object, one line per feature, packed.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from app.ogc.columns import pack_blobs, pack_numbers, pack_texts
from interloc.arrays import FloatArray
from interloc.output.credits import OWN_CREDIT
from interloc.output.derived import derived_features
from interloc.output.geojson import DEGREE_DECIMALS, cut, damaged, encode, read_json
from interloc.output.layers import CITY_LAYERS, DERIVED, LAYERS, Layer
from interloc.output.layout import RUN_FILE, file_names
from interloc.output.properties import ORIGIN, Properties, ResultProperties, Time, attributes_of

IDS, BOXES, TIMES, SHAPES, CONTENT = "@id", "@box", "@time", "@shape", "@content"

CHUNK = 512
"""Features in a chunk: few enough to read for a page, many enough that a million are some thousand chunks."""

_FOOTPRINT_M = 25.0
_TOLERANCE_M = 2.0
_METRES_PER_DEGREE = 111_320.0
_PACKED = 1  # level of zlib: text becomes five times smaller, and a page is unpacked within milliseconds


class FootprintProperties(Properties):
    """The surroundings of the track of a drive: up to 25 m from it."""

    scans: int = Field(title="Scans", description="Number of scans of the drive.")
    keyframes: int = Field(title="Keyframes", description="Number of keyframes.")
    detections: int = Field(title="Detections", description="Number of detections.")
    intersections: int = Field(title="Intersections", description="Number of intersections found.")
    first_time: Time = Field(
        title="Begin", description="Time of the first keyframe, RFC 3339; null where the drive has no times of day."
    )
    last_time: Time = Field(
        title="End", description="Time of the last keyframe, RFC 3339; null where the drive has no times of day."
    )


RESULT = attributes_of(ResultProperties)
"""The properties that every feature of the index has beside its own; they are not stored with it."""

FOOTPRINTS = Layer("drives", "Areas that were driven through", "Polygon", FootprintProperties, "Drive")
"""The layer that is made here of the others."""

INDEXED = {**LAYERS, **DERIVED, FOOTPRINTS.name: FOOTPRINTS}
"""The layers that are indexed, as far as a result has them."""


@dataclass(frozen=True)
class Chunk:
    """Some hundred features of a layer, in the order of its file."""

    layer: str
    number: int
    """From 0 within the layer."""
    count: int
    """Number of features."""
    labels: str | None
    """Labels that the run used."""
    attribution: str
    license: str | None
    """Attribution and license are those of the layer."""
    extent: dict[str, float]
    """``west``, ``south``, ``east``, ``north`` around all, where one has a geometry; ``first_time``, ``last_time``,
    seconds since 1970, where one has a time."""
    columns: dict[str, bytes]


def is_on_earth(folder: Path) -> bool:
    """Return whether a result has longitude and latitude, without which it has nothing to index."""
    return (folder / file_names(georeferenced=True)["trajectory"]).is_file()


def chunks_of(folder: Path) -> Iterator[Chunk]:
    """Yield the features of a result folder in chunks, layer by layer; nothing without longitude and latitude.

    Raises
    ------
    OutputError
        A file is damaged.
    """
    if not is_on_earth(folder):
        return
    run = read_json(folder / RUN_FILE)
    files = {name: path for name in LAYERS if (path := folder / f"{name}.geojson").is_file()}
    collections = {name: read_json(path) for name, path in files.items()}
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    try:
        intersections = LAYERS["intersections"].read(files["intersections"])
        for name in DERIVED:
            features = derived_features(name, intersections)
            collections[name] = {"features": [{**each, "geometry": cut(each["geometry"])} for each in features]}
        collections[FOOTPRINTS.name] = _footprint(collections, run)
        for name, collection in collections.items():
            yield from _cut(INDEXED[name], collection, run)
    except (KeyError, TypeError, ValueError, AttributeError, shapely.errors.ShapelyError) as error:
        raise damaged(folder, f"its layers are not as they were written ({error!r})") from error


def chunks_of_layers(layers: dict[str, list[dict[str, Any]]], credit: dict[str, str] | None = None) -> Iterator[Chunk]:
    """Yield the features of layers of a map of many drives in chunks."""
    for name, features in layers.items():
        yield from _cut(CITY_LAYERS[name], {"features": features, **(credit or {})}, {})


def seconds_of(time: str | None) -> float | None:
    """Return a time of RFC 3339 as seconds since 1970."""
    return None if time is None else datetime.fromisoformat(time).timestamp()


def _cut(layer: Layer, collection: dict[str, Any], run: dict[str, Any]) -> Iterator[Chunk]:
    features = collection["features"]
    order = _typed_first(layer, features)
    credit = OWN_CREDIT if "attribution" in collection else layer.credit(features)
    labels = run.get("labels")
    for number, start in enumerate(range(0, max(len(features), 1), CHUNK)):
        places = order[start : start + CHUNK]
        some = [features[place] for place in places]
        extent, columns = _columns(layer, some, places, run) if some else ({}, {})
        yield Chunk(
            layer=layer.name,
            number=number,
            count=len(some),
            labels=labels if isinstance(labels, str) else None,
            attribution=collection.get("attribution", credit.attribution),
            license=collection.get("license", credit.license),
            extent=extent,
            columns=columns,
        )


def _typed_first(layer: Layer, features: list[dict[str, Any]]) -> list[int]:
    """Return the places of features in the order of the index: first those that have a value where others have none.

    QGIS 3.22 takes the types of properties from the first ten features that a service gives.
    """
    first: set[int] = set()
    for each in layer.attributes:
        with_value = (
            place for place, feature in enumerate(features) if feature["properties"].get(each.name) is not None
        )
        first.update(islice(with_value, 1))
    return sorted(range(len(features)), key=lambda place: (place not in first, place))


def _columns(
    layer: Layer, features: list[dict[str, Any]], places: list[int], run: dict[str, Any]
) -> tuple[dict[str, float], dict[str, bytes]]:
    shared = ORIGIN if issubclass(layer.properties, ResultProperties) else ()  # as they are now: see `RESULT`
    own = [each for each in layer.attributes if each.name not in shared]
    rows = [{each.name: feature["properties"].get(each.name) for each in own} for feature in features]
    columns = {}
    for each in own:
        values = [row[each.name] for row in rows]
        if each.kind == "text":
            columns[each.name] = pack_texts(values)
        elif each.kind == "time":
            columns[each.name] = pack_numbers(map(seconds_of, values))
        elif each.kind != "list":
            columns[each.name] = pack_numbers(values)
    shapes, boxes = _shapes([feature["geometry"] for feature in features])
    columns[BOXES] = boxes.astype("<f8").tobytes()
    if layer.geometry != "Point":
        columns[SHAPES] = pack_blobs([b"" if each is None else each.wkb for each in shapes.tolist()])
    times = _times(rows, run)
    if np.isfinite(times).any():
        columns[TIMES] = times.astype("<f8").tobytes()
    columns[IDS] = pack_texts(_ids(layer, features, rows, places))
    lines = [
        f'"geometry":{encode(feature["geometry"])},"properties":{encode(row)}'
        for feature, row in zip(features, rows, strict=True)
    ]
    columns[CONTENT] = zlib.compress("\n".join(lines).encode(), _PACKED)
    return _extent(boxes, times), columns


def _ids(layer: Layer, features: list[dict[str, Any]], rows: list[dict[str, Any]], places: list[int]) -> list[str]:
    """Return the ids of features; those of older versions had none."""
    return [
        str(feature["id"]) if "id" in feature else str(place + 1 if layer.key is None else row[layer.key])
        for place, feature, row in zip(places, features, rows, strict=True)
    ]


def _times(rows: list[dict[str, Any]], run: dict[str, Any]) -> FloatArray:
    """Return first and last time of each feature; what has no time of its own has that of the whole drive."""
    whole = run.get("first_time"), run.get("last_time")
    spans = []
    for row in rows:
        if "time" in row:
            first = last = row["time"]
        elif "first_time" in row:
            first, last = row["first_time"], row["last_time"]
        else:
            first, last = whole
        spans.append([seconds_of(first), seconds_of(last)])
    return np.array(spans, dtype=np.float64).reshape(-1, 2)


def _shapes(geometries: list[dict[str, Any] | None]) -> tuple[NDArray[np.object_], FloatArray]:
    """Return geometries, and (N, 4) west, south, east, north of each; NaN where there is none."""
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    shapes = shapely.from_geojson([None if each is None else json.dumps(each) for each in geometries])
    boxes = shapely.bounds(shapes).reshape(-1, 4)
    for row in np.flatnonzero(boxes[:, 2] - boxes[:, 0] > 180.0).tolist():  # across the 180th meridian
        shape = shapely.transform(shapes[row], lambda xy: xy + [360.0, 0.0] * (xy[:, :1] < 0))
        shapes[row], boxes[row] = shape, shapely.bounds(shape)
    return shapes, boxes


def _extent(boxes: FloatArray, times: FloatArray) -> dict[str, float]:
    """Return what is around those boxes and those times that are known."""
    found: dict[str, float] = {}
    for names, values in ((("west", "south", "east", "north"), boxes), (("first_time", "last_time"), times)):
        known, half = values[np.isfinite(values).all(axis=1)], len(names) // 2
        if len(known):
            around = np.concatenate([known[:, :half].min(axis=0), known[:, half:].max(axis=0)])
            found |= dict(zip(names, around.tolist(), strict=True))
    return found


def _footprint(collections: dict[str, dict[str, Any]], run: dict[str, Any]) -> dict[str, Any]:
    """Return the layer of the area that was driven through: one feature."""
    (track,) = collections["trajectory"]["features"]
    properties = {
        "scans": track["properties"]["scans"],
        **{name: len(collections[name]["features"]) for name in ("keyframes", "detections", "intersections")},
        "first_time": run.get("first_time"),
        "last_time": run.get("last_time"),
    }
    geometry = None if track["geometry"] is None else _surroundings(track["geometry"])
    feature = {"type": "Feature", "id": "drive", "geometry": geometry, "properties": properties}
    return {"features": [feature], "attribution": OWN_CREDIT.attribution}


def _surroundings(track: dict[str, Any]) -> dict[str, Any]:
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    (line,), boxes = _shapes([track])
    west, south, east, north = boxes[0].tolist()
    metres = _METRES_PER_DEGREE * np.array([max(np.cos(np.radians((south + north) / 2)), 1e-6), 1.0])
    plane = shapely.transform(line, lambda xy: (xy - [west, south]) * metres).simplify(_TOLERANCE_M)
    area = plane.buffer(_FOOTPRINT_M, quad_segs=3).simplify(_TOLERANCE_M)
    area = shapely.orient_polygons(shapely.transform(area, lambda xy: xy / metres + [west, south]))
    if east > 180.0:
        area = _split(area)
    rounded = shapely.transform(area, lambda xy: np.round(xy, DEGREE_DECIMALS))
    found: dict[str, Any] = json.loads(shapely.to_geojson(rounded))
    return found


def _split(area: Any) -> Any:  # noqa: ANN401 - a polygon
    """Cut an area at the 180th meridian (RFC 7946, 3.1.9)."""
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    before = shapely.intersection(area, shapely.box(-360.0, -90.0, 180.0, 90.0))
    after = shapely.intersection(area, shapely.box(180.0, -90.0, 540.0, 90.0))
    after = shapely.transform(after, lambda xy: xy - [360.0, 0.0])
    parts = [part for each in (before, after) for part in shapely.get_parts(each)]
    return shapely.multipolygons(parts)
