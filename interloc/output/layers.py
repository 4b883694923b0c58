"""The layers of a result, one model per layer: the one place of their properties.

Writing, reading, GeoPackage fields and the API take names, types, printed decimals and descriptions from the models
below. Bearings and headings are degrees clockwise from north, or from +y of W without georeference. W is the frame of
the first LiDAR pose, L that of the LiDAR at a keyframe, levelled.
"""

from __future__ import annotations

import types
from collections import Counter
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
Verdict = Literal["right", "wrong", "unscored"]
"""Of a detection or an intersection; unscored before an evaluation, and where the map cannot tell."""

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
    uid: str | None = Field(
        None,
        description="Name of the place, the same in other runs: n and the id of the OpenStreetMap node where the "
        "result was scored and there is a junction, else the cell of a grid of about 22 m.",
    )
    drive: str | None = Field(None, description="Name of the drive.")
    first_time: str | None = Field(
        None, description="Time of the first keyframe that saw it, RFC 3339; null where the drive has no times of day."
    )
    last_time: str | None = Field(
        None, description="Time of the last keyframe that saw it, RFC 3339; null where the drive has no times of day."
    )
    outcome: Verdict = Field(
        "unscored",
        description="right: assigned to an OpenStreetMap node, one to one, within 10 m. wrong: to none. unscored: "
        "before `evaluate`, beyond the map, or in the relevant zone of no keyframe.",
    )
    osm_id: int | None = Field(None, description="Id of the OpenStreetMap node that it is assigned to; null for none.")
    error_m: Annotated[float | None, Decimals(4)] = Field(
        None, description="Distance to that node, metres; null for none."
    )
    reason: str | None = Field(None, description="Why it is wrong or unscored; null where it is right.")


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
    id: str | None = Field(
        None, description="Scan number of the keyframe and, from 1, the number of the detection at it, as 120-1."
    )
    time: str | None = Field(
        None, description="Time of the keyframe, RFC 3339; null where the drive has no times of day."
    )
    outcome: Verdict = Field(
        "unscored",
        description="right: within 5 m of the nearest OpenStreetMap node of the region of interest. wrong: not. "
        "unscored: before `evaluate`, or beyond the map.",
    )
    osm_id: int | None = Field(
        None, description="Id of the nearest OpenStreetMap node in the region of interest, however far; null for none."
    )
    error_m: Annotated[float | None, Decimals(4)] = Field(
        None, description="Distance to that node, metres; null for none."
    )
    reason: str | None = Field(None, description="Why it is wrong or unscored; null where it is right.")


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
    outcome: Literal["found", "missed", "outside"] = Field(
        "outside",
        description="found: an intersection of the map is assigned to it, one to one, within 10 m. missed: none is. "
        "outside: in the relevant zone of no keyframe, so it cannot be missed.",
    )
    intersection: int | None = Field(None, description="Id of the intersection assigned to it; null for none.")
    reason: str | None = Field(None, description="Why it was missed; null where it was not.")


class MatchProperties(Properties):
    """A detection and the OpenStreetMap node that it was matched to."""

    frame: int = Field(description="Scan number of the keyframe.")
    error_m: Metres = Field(description="Length of the line, metres.")
    outcome: Literal["TP", "FP"] = Field(description="TP within 5 m of the node, else FP.")
    osm_id: OsmNode
    detection: str | None = Field(
        None, description="The detection: its scan number and, from 1, its number at that keyframe, as 120-1."
    )
    intersection: int | None = Field(
        None, description="Id of the fused intersection that the detection belongs to; null for none."
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
    key : str or None
        Property that becomes the `id` of a feature; None where the layer is one feature.
    """

    name: str
    title: str
    geometry: Literal["Point", "LineString"]
    properties: type[Properties]
    label: str
    is_osm: bool = False
    key: str | None = None

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


def _printed(values: Column, metadata: list[Any]) -> Sequence[Any]:
    """Return a column as plain values, rounded where its field says so."""
    plain: Sequence[Any] = values.tolist() if isinstance(values, np.ndarray) else values
    places = next((each.places for each in metadata if isinstance(each, Decimals)), None)
    return plain if places is None else [rounded(value, places) for value in plain]
