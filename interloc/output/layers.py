"""The layers of a result, one model per layer: the one place of their properties.

Writing, reading, GeoPackage fields and the API take names, types, printed decimals and descriptions from the models
below. Bearings and headings are degrees clockwise from north, or from +y of W without georeference. W is the frame of
the first LiDAR pose, L that of the LiDAR at a keyframe, levelled.
"""

from __future__ import annotations

import types
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from interloc.arrays import FloatArray, IntArray
from interloc.output.geojson import damaged, read_file, rounded

Column = Sequence[Any] | NDArray[Any]
"""The values of a property, one per feature."""

PLACES = "places"
"""Layer of a result that was placed on the map by its roads."""

ATTRIBUTION = "Detections: InterLoc."
OSM_ATTRIBUTION = "OSM data (c) OpenStreetMap contributors, ODbL 1.0, https://www.openstreetmap.org/copyright."


@dataclass(frozen=True)
class Decimals:
    """How many decimals of a number are printed; NaN and infinity become null."""

    places: int


Metres = Annotated[float, Decimals(4)]
Ratio = Annotated[float, Decimals(6)]
WorldX = Annotated[Metres, Field(description="Position in W, metres forward of the first scan.")]
WorldY = Annotated[Metres, Field(description="Position in W, metres to the left of the first scan.")]
BranchCount = Annotated[int, Field(description="Number of branches.")]
BranchBearings = Annotated[list[float], Field(description="Bearing of each branch, leaving the intersection, degrees.")]
OsmNode = Annotated[int, Field(description="Id of the OpenStreetMap node.")]

_Position = tuple[float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)


class Properties(_Strict):
    """Properties of the features of a layer."""


class IntersectionProperties(Properties):
    """A physical intersection, fused from all detections of it."""

    id: int = Field(description="Number of the intersection, from 1 in the order of first sight.")
    observations: int = Field(description="Number of detections fused.")
    position_std_m: Metres = Field(description="One-sigma uncertainty of the position, metres.")
    branch_count: BranchCount
    branch_bearings_deg: BranchBearings
    first_frame: int = Field(description="Scan number of the first keyframe that saw it.")
    last_frame: int = Field(description="Scan number of the last keyframe that saw it.")
    confidence: Ratio = Field(description="0..1, from how often it was seen when it could have been.")
    world_x_m: WorldX
    world_y_m: WorldY


class DetectionProperties(Properties):
    """An intersection as one keyframe saw it, georeferenced by the fix of that keyframe."""

    frame: int = Field(description="Scan number of the keyframe.")
    x_m: Metres = Field(description="Position in L, metres forward.")
    y_m: Metres = Field(description="Position in L, metres to the left.")
    world_x_m: WorldX
    world_y_m: WorldY
    branch_count: BranchCount
    branch_bearings_deg: BranchBearings
    score: Ratio = Field(description="0..1, how sure the detector is.")
    intersection: int | None = Field(description="Id of the fused intersection that it belongs to; null for none.")


class TrajectoryProperties(Properties):
    """The track of the LiDAR as one line; beside its geometry `world_xy_m`, the same line in W."""

    scans: int = Field(description="Number of scans of the drive.")
    thinned_to_m: float = Field(description="Smallest distance between two positions of the line, metres.")


class KeyframeProperties(Properties):
    """The LiDAR at a keyframe."""

    frame: int = Field(description="Scan number.")
    time_s: Annotated[float | None, Decimals(6)] = Field(description="Seconds since the first scan; null if unknown.")
    heading_deg: Annotated[float, Decimals(6)] = Field(description="Heading of the LiDAR, degrees.")
    detections: int = Field(description="Number of detections.")
    world_x_m: WorldX
    world_y_m: WorldY
    world_yaw_rad: Annotated[float, Decimals(9)] = Field(
        description="Heading in W, radians counter-clockwise from +x. "
        "The region of interest is aligned with W, not with the heading."
    )


class OsmNodeProperties(Properties):
    """A ground truth intersection of OpenStreetMap."""

    osm_id: OsmNode
    degree: int = Field(description="Number of roads that meet there.")
    in_zone: bool = Field(description="Whether it was in the relevant zone of a keyframe, so it should be found.")
    found: bool = Field(description="Whether a detection within 5 m was matched to it.")
    keyframes_in_zone: int = Field(description="Number of keyframes with the node in their relevant zone.")
    keyframes_missed: int = Field(description="Number of these keyframes without a detection matched to it.")
    detections: int = Field(description="Number of detections matched to it.")
    median_error_m: Annotated[float | None, Decimals(4)] = Field(
        description="Median distance of these detections, metres; null if there are none."
    )


class MatchProperties(Properties):
    """A detection and the OpenStreetMap node that it was matched to."""

    frame: int = Field(description="Scan number of the keyframe.")
    error_m: Metres = Field(description="Length of the line, metres.")
    outcome: Literal["TP", "FP"] = Field(description="TP within 5 m of the node, else FP.")
    osm_id: OsmNode
    detection: str | None = Field(
        None, description="The detection: its scan number and, from 1, its number at that keyframe, as 120-1."
    )


class OsmRoadProperties(Properties):
    """A way of OpenStreetMap around the drive; one that leaves the surroundings and returns is several lines."""

    osm_id: int = Field(description="Id of the OpenStreetMap way.")
    highway: str = Field(description="Value of its tag `highway`.")
    name: str | None = Field(description="Name or else reference number; null if it has none.")
    is_drivable: bool = Field(description="Whether it is a road under policy drive+service.")


class PlaceProperties(Properties):
    """The track of a drive at a place of the map that it fits; the first is where it was found to be."""

    rank: int = Field(description="1 for the best place; the others are those that came next.")
    score: Ratio = Field(description="How well the place explains the drive; 1.5 is a perfect fit.")
    on_roads: Ratio = Field(description="0..1, how much of the track runs along roads.")
    intersections_seen: int = Field(description="Number of passages of intersections that the drive saw.")
    intersections_at_nodes: int = Field(description="Number of these that lie at an intersection of the map.")
    heading_deg: Annotated[float, Decimals(1)] = Field(description="Heading at the first scan, degrees.")


_KINDS = {bool: "bool", int: "int", float: "float", str: "text", Literal: "text", list: "list"}


@dataclass(frozen=True)
class Layer:
    """A layer of a result.

    Attributes
    ----------
    name : str
        Of the layer, and of its GeoJSON file.
    title : str
    geometry : str
        Of all its features.
    properties : type
        Model of the properties of a feature; its docstring says what a feature is.
    label : str
        Name of a feature in a KML file, a format string over its properties.
    is_osm : bool
        Whether it holds data of OpenStreetMap.
    """

    name: str
    title: str
    geometry: Literal["Point", "LineString"]
    properties: type[Properties]
    label: str
    is_osm: bool = False

    @property
    def address(self) -> str:
        """Name of the layer in the addresses of the API."""
        return self.name.replace("_", "-")

    @property
    def attribution(self) -> str:
        """Who is to be named where the layer is shown."""
        return f"{ATTRIBUTION} {OSM_ATTRIBUTION}" if self.is_osm else ATTRIBUTION

    @property
    def description(self) -> str:
        """What a feature is."""
        return self.properties.__doc__ or ""

    @property
    def fields(self) -> dict[str, str]:
        """Property -> int, float, bool, text or list."""
        return {name: _kind(field.annotation) for name, field in self.properties.model_fields.items()}

    def features(self, coordinates: Iterable[Any], **columns: Column) -> list[dict[str, Any]]:
        """Return GeoJSON features as they are printed.

        Parameters
        ----------
        coordinates
            Of each feature, as printed (`interloc.output.geojson.positions`); None: it has no geometry.
        **columns
            The values of each property of the layer.
        """
        names = list(self.properties.model_fields)
        assert columns.keys() == set(names)
        printed = [_printed(columns[name], self.properties.model_fields[name].metadata) for name in names]
        return [
            {
                "type": "Feature",
                "geometry": None if place is None else {"type": self.geometry, "coordinates": place},
                "properties": dict(zip(names, row, strict=True)),
            }
            for place, row in zip(coordinates, zip(*printed, strict=True), strict=True)
        ]

    def read(self, path: Path) -> Rows:
        """Read the file of this layer that `interloc.output.geojson.write_collection` wrote.

        Raises
        ------
        OutputError
            The file is missing or damaged.
        """
        content = read_file(path)
        try:
            return Rows(path, self._file.model_validate_json(content).features)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(step) for step in first["loc"])  # features.2.properties.x_m
            raise damaged(path, f"{place}: {first['msg']}" if place else first["msg"]) from error

    @cached_property
    def _file(self) -> Any:  # noqa: ANN401 - a model that is made here
        """Model of the whole file."""
        is_point = self.geometry == "Point"
        kind: Any = Literal[self.geometry]
        geometry = create_model(
            "Geometry",
            __base__=_Strict,
            type=(kind, ...),
            coordinates=(_Position if is_point else list[_Position], ...),
        )
        feature = create_model(
            "Feature",
            __base__=_Strict,
            geometry=(geometry if is_point else geometry | None, ...),
            properties=(self.properties, ...),
            world_xy_m=(tuple[_Position, ...], ()),  # of the trajectory
        )
        collection: Any = Literal["FeatureCollection"]
        return create_model("Collection", __base__=_Strict, type=(collection, ...), features=(list[feature], ...))


LAYERS = {
    layer.name: layer
    for layer in (
        Layer("intersections", "Intersections found", "Point", IntersectionProperties, "Intersection {id}"),
        Layer("detections", "Detections per keyframe", "Point", DetectionProperties, "Detection at frame {frame}"),
        Layer("trajectory", "Track of the LiDAR", "LineString", TrajectoryProperties, "Trajectory"),
        Layer("keyframes", "Keyframes", "Point", KeyframeProperties, "Keyframe {frame}"),
        Layer(
            "osm_nodes",
            "Intersections of OpenStreetMap",
            "Point",
            OsmNodeProperties,
            "OSM node {osm_id}",
            is_osm=True,
        ),
        Layer(
            "matches",
            "Detections and the OpenStreetMap nodes that they were matched to",
            "LineString",
            MatchProperties,
            "{outcome}, frame {frame}",
            is_osm=True,
        ),
        Layer("osm_roads", "Roads of OpenStreetMap", "LineString", OsmRoadProperties, "OSM way {osm_id}", is_osm=True),
        Layer(
            PLACES,
            "Places on the map that the drive fits",
            "LineString",
            PlaceProperties,
            "Place {rank}, score {score}",
            is_osm=True,
        ),
    )
}


@dataclass(frozen=True)
class Rows:
    """The features of a layer that was read, as columns.

    Attributes
    ----------
    path : Path
        The file.
    features : list
        Features, with `geometry`, `properties` (a model of the layer) and `world_xy_m`.
    """

    path: Path
    features: list[Any]

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


def _kind(annotation: Any) -> str:  # noqa: ANN401
    """Return the kind of a property from its annotation, null aside."""
    alternatives = get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    return _KINDS[get_origin(alternatives[0]) or alternatives[0]]


def _printed(values: Column, metadata: list[Any]) -> Sequence[Any]:
    """Return a column as plain values, rounded where its field says so."""
    plain: Sequence[Any] = values.tolist() if isinstance(values, np.ndarray) else values
    places = next((each.places for each in metadata if isinstance(each, Decimals)), None)
    return plain if places is None else [rounded(value, places) for value in plain]
