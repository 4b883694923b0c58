"""The features of a result, or of a map of many drives, as rows of the tables of features."""

import json
import math
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import islice
from operator import index
from pathlib import Path
from typing import Any

import numpy as np

from app.work.requests import RESULT_LAYERS
from interloc.arrays import FloatArray, JsonObject
from interloc.output.credits import OWN_CREDIT, Credit
from interloc.output.geojson import Feature, GeometryObject, cut, damaged, encode, read_json
from interloc.output.layers import CITY_LAYERS, DERIVED, LAYERS, Layer, derived_features
from interloc.output.layout import RUN_FILE, file_names


@dataclass(frozen=True)
class LayerRows:
    """The features of a layer as rows of its table."""

    layer: str
    facts: JsonObject
    """Columns of `FeatureLayer`: count, labels, box, times, credit."""
    rows: list[JsonObject]
    """Without the id of the layer, which it gets when it is written."""


def rows_of(folder: Path) -> Iterator[LayerRows]:
    """Yield the layers of a result folder; none without longitude and latitude."""
    if not (folder / file_names(georeferenced=True)["trajectory"]).is_file():
        return
    run = read_json(folder / RUN_FILE)
    files = {name: path for name in LAYERS if (path := folder / f"{name}.geojson").is_file()}
    collections = {name: read_json(path) for name, path in files.items()}

    import shapely  # noqa: PLC0415 - of workers: the server does without

    try:
        intersections = LAYERS["intersections"].read(files["intersections"])
        for name in DERIVED:
            collections[name] = {"features": derived_features(name, intersections)}
        for name, collection in collections.items():
            yield _layer_rows(RESULT_LAYERS[name], collection, run)
    except (KeyError, TypeError, ValueError, AttributeError, shapely.errors.ShapelyError) as error:
        raise damaged(folder, f"its layers are not as they were written ({error!r})") from error


def rows_of_map(layers: dict[str, list[Feature]], credit: Credit = OWN_CREDIT) -> list[LayerRows]:
    """Return layers of a map of many drives."""
    return [
        _layer_rows(CITY_LAYERS[name], {"features": features, **credit.members}, {})
        for name, features in layers.items()
    ]


def time_text(moment: datetime) -> str:
    """Return a time as results have it: the order of such texts is that of the times."""
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _text(value: str) -> str:
    return value.replace("\0", "")  # names in a map may hold it, PostgreSQL takes none; not a text: AttributeError


_VALUES: dict[str, Callable[[Any], Any]] = {
    "int": index,
    "float": float,
    "bool": bool,
    "text": lambda value: _text(str(value) if isinstance(value, int) else value),  # ids of before 0.3.0
    "time": lambda value: time_text(datetime.fromisoformat(value)),
    "list": encode,
}


def time_names(fields: Container[str]) -> tuple[str, str]:
    """Return the attributes that tell from when to when a feature is."""
    pairs = ("time", "time"), ("after_time", "before_time")
    return next((pair for pair in pairs if pair[0] in fields), ("first_time", "last_time"))


def _layer_rows(layer: Layer, collection: JsonObject, run: JsonObject) -> LayerRows:
    features: list[Any] = [{**each, "geometry": cut(each["geometry"])} for each in collection["features"]]
    credit = OWN_CREDIT if "attribution" in collection else layer.credit(features)
    labels = run.get("labels")
    facts: JsonObject = {
        "count": len(features),
        "labels": labels if isinstance(labels, str) else None,
        "attribution": collection.get("attribution", credit.attribution),
        "license": collection.get("license", credit.license),
    }
    boxes = _boxes(layer, [feature["geometry"] for feature in features])
    known = boxes[np.isfinite(boxes[:, 0])]
    if len(known):
        facts |= dict(zip(("west", "south"), known[:, :2].min(axis=0).tolist(), strict=True))
        facts |= dict(zip(("east", "north"), known[:, 2:].max(axis=0).tolist(), strict=True))
        facts["width"] = float((known[:, 2] - known[:, 0]).max())
    rows = list(_rows(layer, features, boxes))
    first, last = time_names(layer.fields)
    spans = rows if first in layer.fields else [run]  # what has no times of its own has those of the whole drive
    begins = [row[first] for row in spans if row.get(first) is not None]
    ends = [row[last] for row in spans if row.get(last) is not None]
    if rows and begins and ends:
        begin, end = (datetime.fromisoformat(time).timestamp() for time in (min(begins), max(ends)))
        facts |= {"first_time": begin, "last_time": end}
    return LayerRows(layer.name, facts, rows)


def _rows(layer: Layer, features: list[Feature], boxes: FloatArray) -> Iterator[JsonObject]:
    attributes = [(each.name, _VALUES[each.kind]) for each in layer.attributes]
    sides = ("west", "south") if layer.geometry == "Point" else ("west", "south", "east", "north")
    corners = boxes.tolist()
    for number, place in enumerate(_typed_first(layer, features)):
        feature, values = features[place], features[place]["properties"]
        row = {name: None if (value := values.get(name)) is None else convert(value) for name, convert in attributes}
        # Those of older versions have no id.
        own_id = feature["id"] if "id" in feature else place + 1 if layer.key is None else row[layer.key]
        row |= {"number": number, "feature_id": _text(str(own_id))}
        row |= {side: None if math.isnan(at) else at for side, at in zip(sides, corners[place], strict=False)}
        if layer.geometry != "Point":
            row["geometry"] = None if feature["geometry"] is None else encode(feature["geometry"])
        yield row


def _typed_first(layer: Layer, features: list[Feature]) -> list[int]:
    """Return the places of features in the order of pages: first those that have a value where others have none.

    QGIS 3.22 takes the types of properties from the first ten features that a service gives.
    """
    first: set[int] = set()
    for each in layer.attributes:
        with_value = (
            place for place, feature in enumerate(features) if feature["properties"].get(each.name) is not None
        )
        first.update(islice(with_value, 1))
    return sorted(range(len(features)), key=lambda place: (place not in first, place))


def _boxes(layer: Layer, geometries: list[GeometryObject | None]) -> FloatArray:
    """Return (N, 4) west, south, east, north of geometries; NaN where there is none."""
    if layer.geometry == "Point":
        nothing = [math.nan, math.nan]
        points = [nothing if each is None else each["coordinates"][:2] for each in geometries]
        return np.tile(np.array(points, dtype=np.float64).reshape(-1, 2), 2)

    import shapely  # noqa: PLC0415 - likewise

    shapes = shapely.from_geojson([None if each is None else json.dumps(each) for each in geometries])
    boxes: FloatArray = shapely.bounds(shapes).reshape(-1, 4)
    for row in np.flatnonzero(boxes[:, 2] - boxes[:, 0] > 180.0).tolist():  # across the 180th meridian: on beyond it
        boxes[row] = shapely.bounds(shapely.transform(shapes[row], lambda xy: xy + [360.0, 0.0] * (xy[:, :1] < 0)))
    return boxes
