"""The layers of a result: which there are, and how their GeoJSON files are read.

Their properties are the models of `interloc.output.properties`.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError, create_model

from interloc.arrays import FloatArray, IntArray
from interloc.output.credits import ATTRIBUTION, OWN_CREDIT, Credit, holds_map_data, map_credit
from interloc.output.geojson import damaged, joined, read_file, rounded
from interloc.output.properties import (
    ORIGIN,
    Attribute,
    BranchProperties,
    ChangeProperties,
    CityDriveProperties,
    CityProperties,
    CityRoadProperties,
    DetectionProperties,
    FindingProperties,
    IntersectionProperties,
    JunctionProperties,
    KeyframeProperties,
    MatchProperties,
    OsmBuildingProperties,
    OsmNodeProperties,
    OsmRoadProperties,
    PlaceProperties,
    Properties,
    ResultProperties,
    RoadProperties,
    RoadSurfaceProperties,
    Strict,
    TrajectoryProperties,
    UncertaintyProperties,
    attributes_of,
)

Column = Sequence[Any] | NDArray[Any]
"""The values of a property, one per feature."""

Geometry = Literal["Point", "LineString", "Polygon"]

BUILDINGS = "osm_buildings"
"""Layer of a scored result whose map holds buildings."""

PLACES = "places"
"""Layer of a result that was placed on the map by its roads."""

_Position = tuple[float, float]

_IN_PARTS = re.compile(rb'"type"\s*:\s*"Multi')


@dataclass(frozen=True)
class Layer:
    """A layer of a result."""

    name: str
    """Of the layer, and of its GeoJSON file."""
    title: str
    geometry: Geometry
    """Of all its features."""
    properties: type[Properties]
    """Model of the properties of a feature; its docstring says what a feature is."""
    label: str
    """Name of a feature in a KML file, a format string over its properties."""
    is_osm: bool = False
    """Whether it holds data of OpenStreetMap."""
    key: str | None = None
    """Property that becomes the `id` of a feature; None where the layer is one feature."""

    @property
    def address(self) -> str:
        """Name of the layer in the addresses of the API."""
        return self.name.replace("_", "-")

    @property
    def attribution(self) -> str:
        """Who is to be named where the layer is shown, as far as the layer alone tells; see `credit`."""
        return self.credit([]).attribution

    @property
    def description(self) -> str:
        """What a feature is."""
        return self.properties.__doc__ or ""

    @cached_property
    def attributes(self) -> list[Attribute]:
        """Its properties, described."""
        return attributes_of(self.properties)

    @property
    def fields(self) -> dict[str, str]:
        """Property -> int, float, bool, text, time or list."""
        return {each.name: each.kind for each in self.attributes}

    def credit(self, features: Iterable[dict[str, Any]], *, made_up_map: bool = False) -> Credit:
        """Return whose data features of the layer are: also of OpenStreetMap, where it is of it or was scored."""
        of_map = self.is_osm or holds_map_data(each["properties"] for each in features)
        return map_credit(is_made_up=made_up_map) if of_map else OWN_CREDIT

    def features(self, coordinates: Iterable[Any], **columns: Column) -> list[dict[str, Any]]:
        """Return GeoJSON features as they are printed.

        Coordinates come as printed (`interloc.output.geojson.positions`), None where there are none; the columns are
        the properties of the layer, of which those of `ORIGIN` may be left out.
        """
        coordinates = list(coordinates)
        names = [each.name for each in self.attributes]
        if issubclass(self.properties, ResultProperties):
            columns = dict.fromkeys(ORIGIN, [None] * len(coordinates)) | columns
        assert columns.keys() == set(names)
        printed = [_printed(columns[each.name], each.decimals) for each in self.attributes]
        rows = [dict(zip(names, row, strict=True)) for row in zip(*printed, strict=True)]
        ids = [self.name] * len(rows) if self.key is None else [row[self.key] for row in rows]
        return [
            {
                "type": "Feature",
                "id": feature_id,
                "geometry": None if place is None else {"type": self.geometry, "coordinates": place},
                "properties": row,
            }
            for feature_id, place, row in zip(_unique(ids), coordinates, rows, strict=True)
        ]

    def read(self, path: Path) -> Rows:
        """Read the file of this layer that `write_collection` wrote; a DamagedResultError says what is wrong."""
        content = _whole(read_file(path), path)
        try:
            collection = self._file.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(step) for step in first["loc"])  # features.2.properties.x_m
            raise damaged(path, f"{place}: {first['msg']}" if place else first["msg"]) from error
        return Rows(path, collection.features, Credit(collection.attribution, collection.license))

    def rows(self, features: Sequence[dict[str, Any]], credit: Credit, path: Path) -> Rows:
        """Return GeoJSON features of the layer as those of a file that was read."""
        collection = {"type": "FeatureCollection", "features": features}
        return Rows(path, self._file.model_validate_json(json.dumps(collection)).features, credit)

    @cached_property
    def _file(self) -> Any:  # noqa: ANN401 - a model that is made here
        """Model of the whole file."""
        is_point = self.geometry == "Point"
        kind: Any = Literal[self.geometry]
        shapes: dict[str, Any] = {"Point": _Position, "LineString": list[_Position], "Polygon": list[list[_Position]]}
        geometry = create_model("Geometry", __base__=Strict, type=(kind, ...), coordinates=(shapes[self.geometry], ...))
        feature = create_model(
            "Feature",
            __base__=Strict,
            geometry=(geometry if is_point else geometry | None, ...),
            properties=(self.properties, ...),
            world_xy_m=(tuple[_Position, ...], ()),  # of the trajectory
        )
        collection: Any = Literal["FeatureCollection"]
        return create_model(
            "Collection",
            __base__=Strict,
            type=(collection, ...),
            features=(list[feature], ...),
            attribution=(str, ATTRIBUTION),
            license=(str | None, None),
        )


LAYERS = {
    layer.name: layer
    for layer in (
        Layer("intersections", "Intersections found", "Point", IntersectionProperties, "Intersection {id}", key="id"),
        Layer(
            "detections",
            "Detections per keyframe",
            "Point",
            DetectionProperties,
            "Detection at frame {frame}",
            key="id",
        ),
        Layer("trajectory", "Track of the LiDAR", "LineString", TrajectoryProperties, "Trajectory"),
        Layer("keyframes", "Keyframes", "Point", KeyframeProperties, "Keyframe {frame}", key="frame"),
        Layer("roads", "Roads seen by LiDAR", "LineString", RoadProperties, "Road {id}", key="id"),
        Layer("junctions", "Junctions of the roads", "Polygon", JunctionProperties, "Node {id}, {kind}", key="id"),
        Layer("road_surface", "Surface of the roads", "Polygon", RoadSurfaceProperties, "Road surface {id}", key="id"),
        Layer(
            "osm_nodes",
            "Intersections of OpenStreetMap",
            "Point",
            OsmNodeProperties,
            "OSM node {osm_id}",
            is_osm=True,
            key="osm_id",
        ),
        Layer(
            "matches",
            "Detections and the OpenStreetMap nodes that they were matched to",
            "LineString",
            MatchProperties,
            "{outcome}, frame {frame}",
            is_osm=True,
            key="detection",
        ),
        Layer(
            "osm_roads",
            "Roads of OpenStreetMap",
            "LineString",
            OsmRoadProperties,
            "OSM way {osm_id}",
            is_osm=True,
            key="osm_id",
        ),
        Layer(
            BUILDINGS,
            "Buildings of OpenStreetMap",
            "Polygon",
            OsmBuildingProperties,
            "OSM {osm_type} {osm_id}",
            is_osm=True,
            key="osm_id",
        ),
        Layer(
            PLACES,
            "Places on the map that the drive fits",
            "LineString",
            PlaceProperties,
            "Place {rank}, score {score}",
            is_osm=True,
            key="rank",
        ),
    )
}
"""The layers that are files of a result."""

DERIVED = {
    layer.name: layer
    for layer in (
        Layer("branches", "Branches of the intersections", "LineString", BranchProperties, "{bearing_deg:.0f} degrees"),
        Layer(
            "uncertainty",
            "Uncertainty of the intersections",
            "Polygon",
            UncertaintyProperties,
            "Intersection {intersection}, within {radius_m:.1f} m",
            key="intersection",
        ),
    )
}
"""The layers that exports make of the intersections, see `interloc.output.derived`."""


CITY_LAYERS = {
    layer.name: layer
    for layer in (
        Layer("city", "Intersections of many drives", "Point", CityProperties, "Intersection {uid}", key="uid"),
        Layer("changes", "What came or went between drives", "Point", ChangeProperties, "{kind} {uid}", key="id"),
        Layer(
            "findings",
            "What OpenStreetMap seems to have wrong",
            "Point",
            FindingProperties,
            "{kind}: {text}",
            is_osm=True,
            key="id",
        ),
        Layer("roads", "Roads of many drives", "LineString", CityRoadProperties, "Road {id}", key="id"),
        Layer("drives", "Tracks of many drives", "LineString", CityDriveProperties, "{drive}", key="drive"),
    )
}
"""The layers of a map of many drives, see `interloc.city`."""


@dataclass(frozen=True)
class Rows:
    """The features of a layer that was read, as columns."""

    path: Path
    """The file."""
    features: list[Any]
    """Features, with `geometry`, `properties` (a model of the layer) and `world_xy_m`."""
    credit: Credit

    def column(self, name: str) -> list[Any]:
        """Return a property of all features."""
        return [getattr(feature.properties, name) for feature in self.features]

    def numbers(self, *names: str) -> FloatArray:
        """Return a property as (N,) float64, NaN for null; several as (N, M)."""
        columns = [np.array(self.column(name), dtype=np.float64) for name in names]
        return columns[0] if len(names) == 1 else np.stack(columns, axis=-1)

    def integers(self, name: str) -> IntArray:
        """Return a property as (N,) int64, -1 for null."""
        return np.array([-1 if value is None else value for value in self.column(name)], dtype=np.int64)

    def arrays(self, name: str) -> list[FloatArray]:
        """Return a property that is a list of numbers in each feature."""
        return [np.array(values, dtype=np.float64) for values in self.column(name)]

    def points(self) -> FloatArray:
        """Return the positions of points, (N, 2) float64."""
        return np.array([f.geometry.coordinates for f in self.features], dtype=np.float64).reshape(-1, 2)


def _whole(content: bytes, path: Path) -> bytes:
    """Return the content of a file with the parts of lines and polygons joined; few files have any."""
    if not _IN_PARTS.search(content):
        return content
    try:
        collection = json.loads(content)
        for feature in collection["features"]:
            feature["geometry"] = joined(feature["geometry"])
    except (KeyError, TypeError, IndexError, ValueError, RecursionError) as error:
        raise damaged(path, f"a line or polygon in parts is not valid ({error})") from error
    return json.dumps(collection).encode()


def _unique(ids: list[Any]) -> list[Any]:
    """Return ids that are all different: 7, 7, 8 becomes "7-1", "7-2", "8"; those that are different already stay."""
    if len(set(ids)) == len(ids):
        return ids
    count: dict[Any, int] = {}
    repeated = {each for each, times in Counter(ids).items() if times > 1}
    named = []
    for each in ids:
        count[each] = count.get(each, 0) + 1
        named.append(f"{each}-{count[each]}" if each in repeated else str(each))
    return named


def _printed(values: Column, decimals: int | None) -> Sequence[Any]:
    """Return a column as plain values, rounded where its property says so."""
    plain: Sequence[Any] = values.tolist() if isinstance(values, np.ndarray) else values
    return plain if decimals is None else [_rounded(value, decimals) for value in plain]


def _rounded(value: Any, decimals: int) -> Any:  # noqa: ANN401 - a number or a list of them
    if isinstance(value, list):
        return [_rounded(each, decimals) for each in value]
    return None if value is None else rounded(value, decimals)
