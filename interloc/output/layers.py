"""The layers of a result: which there are, and how their GeoJSON files are read.

Their properties are the models of `interloc.output.properties`.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError, create_model

from interloc.arrays import FloatArray, IntArray, JsonObject
from interloc.geometry import lonlat_from_enu
from interloc.output.credits import ATTRIBUTION, OWN_CREDIT, Credit, map_credit
from interloc.output.geojson import Feature, damaged, invalid, joined, positions, read_file, rounded
from interloc.output.layout import BUILDINGS, MAP_LAYERS, PLACES
from interloc.output.properties import (
    Attribute,
    BranchProperties,
    ChangeProperties,
    CityDetails,
    CityDriveProperties,
    CityProperties,
    CityRoadProperties,
    DetectionDetails,
    DetectionProperties,
    FindingProperties,
    IntersectionDetails,
    IntersectionProperties,
    JunctionProperties,
    KeyframeDetails,
    KeyframeProperties,
    MatchProperties,
    OsmBuildingProperties,
    OsmNodeDetails,
    OsmNodeProperties,
    OsmRoadProperties,
    PlaceProperties,
    Properties,
    RoadDetails,
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

_Position = tuple[float, float]

_TO_JOIN = re.compile(rb'"type"\s*:\s*"Multi|"details"\s*:\s*\{')


@dataclass(frozen=True)
class Layer:
    """A layer of a result."""

    name: str
    """Of the layer, of its GeoJSON file, and in addresses."""
    title: str
    geometry: Geometry
    """Of all its features."""
    properties: type[Properties]
    """Model of the properties of a feature; its docstring says what a feature is."""
    label: str
    """Name of a feature in a KML file, a format string over its properties."""
    key: str | None = None
    """Property that becomes the `id` of a feature; None where the layer is one feature."""
    details: type[Properties] = Properties
    """Model of what its file has beside the properties; exports and the service's GIS interface have none of it."""

    @property
    def is_osm(self) -> bool:
        """Whether it holds data of OpenStreetMap."""
        return self.name in {*MAP_LAYERS, "findings"}

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

    def credit(self, features: Iterable[Feature], *, made_up_map: bool = False) -> Credit:
        """Return whose data features of the layer are: also of OpenStreetMap, where it is of it or was scored."""
        rows = (each["properties"] for each in features)
        of_map = self.is_osm or any(row.get("osm_id") is not None or row.get("reason") is not None for row in rows)
        return map_credit(is_made_up=made_up_map) if of_map else OWN_CREDIT

    def features(self, coordinates: Iterable[Any], **columns: Column) -> list[Feature]:
        """Return GeoJSON features as they are printed.

        Coordinates come as printed (`interloc.output.geojson.positions`), None where there are none; the columns are
        the properties and the details of the layer, of which the latter may be left out.
        """
        details = attributes_of(self.details) if len(columns) > len(self.attributes) else []
        assert columns.keys() == {each.name for each in (*self.attributes, *details)}
        rows, more = _rows(self.attributes, columns), _rows(details, columns)
        ids = [self.name] * len(rows) if self.key is None else _plain(columns[self.key])
        if self.key == "osm_id":  # a text would be one more field in GDAL, a number is its id of the row
            ids = [int(each) for each in ids]
        made: list[Feature] = [
            {
                "type": "Feature",
                "id": feature_id,
                "geometry": None if place is None else {"type": self.geometry, "coordinates": place},
                "properties": row,
            }
            for feature_id, place, row in zip(_unique(ids), coordinates, rows, strict=True)
        ]
        if more:
            for feature, details_of_it in zip(made, more, strict=True):
                feature["details"] = details_of_it
        return made

    def read(self, path: Path) -> "Rows":
        """Read the file of this layer that `write_collection` wrote; a DamagedResultError says what is wrong."""
        content = _whole(read_file(path), path)
        try:
            collection = self._file.model_validate_json(content)
        except ValidationError as error:
            raise invalid(path, error) from error
        return Rows(path, collection.features, Credit(collection.attribution, collection.license))

    def rows(self, features: Sequence[Feature], credit: Credit, path: Path) -> "Rows":
        """Return GeoJSON features of the layer as those of a file that was read."""
        collection = {"type": "FeatureCollection", "features": features}
        return Rows(path, self._file.model_validate_json(json.dumps(collection)).features, credit)

    @cached_property
    def _file(self) -> Any:  # noqa: ANN401 - a model that is made here
        """Model of the whole file."""
        is_point = self.geometry == "Point"
        kind: Any = Literal[self.geometry]
        shapes: Any = {"Point": _Position, "LineString": list[_Position], "Polygon": list[list[_Position]]}
        geometry = create_model("Geometry", __base__=Strict, type=(kind, ...), coordinates=(shapes[self.geometry], ...))
        feature = create_model(
            "Feature",
            __base__=Strict,
            geometry=(geometry if is_point else geometry | None, ...),
            properties=(create_model("All", __base__=(self.properties, self.details)), ...),
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
        Layer(
            "intersections",
            "Intersections found",
            "Point",
            IntersectionProperties,
            "Intersection {id}",
            key="id",
            details=IntersectionDetails,
        ),
        Layer("roads", "Roads seen by LiDAR", "LineString", RoadProperties, "Road {id}", key="id", details=RoadDetails),
        Layer("trajectory", "Track of the LiDAR", "LineString", TrajectoryProperties, "Trajectory"),
        Layer(
            "osm_nodes",
            "Intersections of OpenStreetMap",
            "Point",
            OsmNodeProperties,
            "OSM node {osm_id}",
            key="osm_id",
            details=OsmNodeDetails,
        ),
        Layer(
            "detections",
            "Detections per keyframe",
            "Point",
            DetectionProperties,
            "Detection at frame {frame}",
            key="id",
            details=DetectionDetails,
        ),
        Layer(
            "keyframes",
            "Keyframes",
            "Point",
            KeyframeProperties,
            "Keyframe {frame}",
            key="frame",
            details=KeyframeDetails,
        ),
        Layer("junctions", "Junctions of the roads", "Polygon", JunctionProperties, "Node {id}, {kind}", key="id"),
        Layer("road_surface", "Surface of the roads", "Polygon", RoadSurfaceProperties, "Road surface {id}", key="id"),
        Layer(
            "matches",
            "Detections and the OpenStreetMap nodes that they were matched to",
            "LineString",
            MatchProperties,
            "{outcome}, frame {frame}",
            key="detection",
        ),
        Layer("osm_roads", "Roads of OpenStreetMap", "LineString", OsmRoadProperties, "OSM way {osm_id}", key="osm_id"),
        Layer(
            BUILDINGS,
            "Buildings of OpenStreetMap",
            "Polygon",
            OsmBuildingProperties,
            "OSM {osm_type} {osm_id}",
            key="osm_id",
        ),
        Layer(
            PLACES,
            "Places on the map that the drive fits",
            "LineString",
            PlaceProperties,
            "Place {rank}, score {score}",
            key="rank",
        ),
    )
}
"""The layers that are files of a result; the first ones are what most people want, see `MAIN_LAYERS`."""

MAIN_LAYERS = tuple(LAYERS)[:4]
"""The layers of a file that holds several, unless all are asked for."""

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
"""The layers that exports make of the intersections, see `interloc.output.layers`."""


CITY_LAYERS = {
    layer.name: layer
    for layer in (
        Layer(
            "city",
            "Intersections of many drives",
            "Point",
            CityProperties,
            "Intersection {uid}",
            key="uid",
            details=CityDetails,
        ),
        Layer("changes", "What came or went between drives", "Point", ChangeProperties, "{kind} {uid}", key="id"),
        Layer(
            "findings", "What OpenStreetMap seems to have wrong", "Point", FindingProperties, "{kind}: {text}", key="id"
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
    """Return the content of a file with details among properties, and the parts of lines and polygons joined."""
    if not _TO_JOIN.search(content):
        return content
    try:
        collection = json.loads(content)
    except (ValueError, RecursionError):
        return content  # what is wrong with it, the model of the file says
    try:
        for feature in collection["features"]:
            feature["geometry"] = joined(feature["geometry"])
            feature["properties"] |= feature.pop("details", {})
    except (KeyError, TypeError, IndexError, ValueError) as error:
        raise damaged(path, f"its details, or a line or polygon in parts, are not valid ({error})") from error
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


def _plain(values: Column) -> list[Any]:
    return values.tolist() if isinstance(values, np.ndarray) else list(values)


def _rows(attributes: Sequence[Attribute], columns: Mapping[str, Column]) -> list[JsonObject]:
    """Return columns as the rows that are printed: ids of OpenStreetMap as text, numbers rounded."""
    printed = []
    for each in attributes:
        values = _plain(columns[each.name])
        if each.kind == "text":
            values = [None if value is None else str(value) for value in values]
        elif each.decimals is not None:
            values = _rounded(values, each.decimals)
        printed.append(values)
    names = [each.name for each in attributes]
    return [dict(zip(names, row, strict=True)) for row in zip(*printed, strict=True)]


def _rounded(values: list[Any], decimals: int) -> list[Any]:
    """Return numbers, and lists of them, as they are printed."""
    return [
        _rounded(each, decimals) if isinstance(each, list) else None if each is None else rounded(each, decimals)
        for each in values
    ]


# Layers that are made of the intersections of a result: their branches as lines, their uncertainty as ellipses.

BRANCH_M = 20.0
"""Length of a branch as it is drawn; how long the road is, the result does not say."""

SIGMAS = 2.4477
"""Semi-axes in sigmas of the ellipse that holds 95 % of a normal distribution in the plane: sqrt(-2 ln 0.05)."""

_CORNERS = 48


def derived_features(name: str, intersections: Rows) -> list[Feature]:
    """Return a layer of `DERIVED` as GeoJSON features; those at the antimeridian are not cut."""
    return _branches(intersections) if name == "branches" else _uncertainty(intersections)


def _branches(intersections: Rows) -> list[Feature]:
    lines, ids, bearings, widths = [], [], [], []
    for feature in intersections.features:
        start, properties = np.array(feature.geometry.coordinates), feature.properties
        for bearing, width in zip(properties.branch_bearings_deg, properties.branch_widths_m, strict=True):
            angle = np.radians(bearing)
            end = _around(start, BRANCH_M * np.array([[np.sin(angle), np.cos(angle)]]))
            lines.append(positions(np.vstack([start, end]), local=False))
            ids.append(properties.id)
            bearings.append(bearing)
            widths.append(width)
    return DERIVED["branches"].features(lines, intersection=ids, bearing_deg=bearings, width_m=widths)


def _uncertainty(intersections: Rows) -> list[Feature]:
    turn = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    std_m = intersections.numbers("position_std_m")
    polygons, axes = [], []
    for feature, centre, std in zip(intersections.features, intersections.points(), std_m, strict=True):
        major, minor, bearing = _ellipse(feature.properties.position_cov_m2 or [std**2, 0.0, std**2])
        axes.append((SIGMAS * major, SIGMAS * minor, bearing))
        along = np.array([np.sin(np.radians(bearing)), np.cos(np.radians(bearing))])
        across = np.array([-along[1], along[0]])  # to the left: counter-clockwise (RFC 7946, 3.1.6)
        ellipse = np.outer(np.cos(turn), major * along) + np.outer(np.sin(turn), minor * across)
        ring = positions(_around(centre, SIGMAS * ellipse), local=False)
        polygons.append([[*ring, ring[0]]])
    major_m, minor_m, bearing_deg = np.array(axes, dtype=np.float64).reshape(-1, 3).T
    return DERIVED["uncertainty"].features(
        polygons,
        intersection=intersections.column("id"),
        position_std_m=std_m,
        radius_m=SIGMAS * std_m,
        semi_major_m=major_m,
        semi_minor_m=minor_m,
        bearing_deg=bearing_deg,
    )


def _ellipse(covariance: list[float]) -> tuple[float, float, float]:
    """Return the semi-axes of one sigma, metres, and the bearing of the longer one in [0, 180) degrees."""
    east, both, north = covariance
    middle, half = (east + north) / 2.0, np.hypot((east - north) / 2.0, both)
    bearing = np.degrees(0.5 * np.arctan2(2.0 * both, north - east)) % 180.0
    return float(np.sqrt(middle + half)), float(np.sqrt(max(middle - half, 0.0))), round(float(bearing), 3) % 180.0


def _around(lonlat: FloatArray, enu_xy: FloatArray) -> FloatArray:
    return lonlat_from_enu(lonlat[1], lonlat[0], enu_xy)
