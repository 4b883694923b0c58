"""The layers of a result as GeoJSON, for the description of the API: typed features in generated clients."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from interloc.output.layers import Geometry, Layer

MEDIA_TYPE = "application/geo+json"

Position = Annotated[list[float], Field(min_length=2, max_length=3, description="Longitude and latitude, degrees.")]


class PointGeometry(BaseModel):
    """A place."""

    type: Literal["Point"]
    coordinates: Position


class LineGeometry(BaseModel):
    """A line."""

    type: Literal["LineString"]
    coordinates: list[Position]


class LinesGeometry(BaseModel):
    """A line across the antimeridian: its parts on both sides (RFC 7946, section 3.1.9)."""

    type: Literal["MultiLineString"]
    coordinates: list[list[Position]]


class PolygonGeometry(BaseModel):
    """An area: its outer ring, then its holes."""

    type: Literal["Polygon"]
    coordinates: list[list[Position]]


class PolygonsGeometry(BaseModel):
    """An area in several pieces."""

    type: Literal["MultiPolygon"]
    coordinates: list[list[list[Position]]]


_GEOMETRIES: dict[Geometry, Any] = {
    "Point": PointGeometry,
    "LineString": LineGeometry | LinesGeometry | None,
    "Polygon": PolygonGeometry | PolygonsGeometry | None,
}


class _Collection(BaseModel):
    model_config = ConfigDict(json_schema_extra={"x-media-type": MEDIA_TYPE})

    type: Literal["FeatureCollection"]
    attribution: str = Field("", description="Whose data it is.")
    license: str = Field("", description="Address of the licence of OpenStreetMap, where it holds data of it.")
    bbox: list[float] = Field([], description="West, south, east, north of all features; absent where there are none.")


def collection_model(layer: Layer) -> type[BaseModel]:
    """Return the model of the GeoJSON of a layer, named after its properties: IntersectionCollection."""
    name = layer.properties.__name__.removesuffix("Properties")
    kind: Any = Literal["Feature"]
    feature: Any = create_model(
        f"{name}Feature",
        __doc__=layer.description,
        type=(kind, ...),
        geometry=(_GEOMETRIES[layer.geometry], ...),
        properties=(layer.properties, ...),
    )
    return create_model(
        f"{name}Collection", __base__=_Collection, __doc__=f"{layer.title}.", features=(list[feature], ...)
    )


class ResultFile(BaseModel):
    """A file of a result."""

    name: str = Field(examples=["figures/map.png"])
    size_bytes: int
    media_type: str = Field(examples=["image/svg+xml"])
    href: str = Field(examples=["/api/v1/jobs/9b1e44f00c7a2d53/files/figures/map.png"])


class ResultFileList(BaseModel):
    """All files of a result: the result folder exactly as the command line writes it."""

    files: list[ResultFile]


def collection_id(layer: Layer) -> str:
    """Return the name of a layer in the addresses of OGC API - Features, which are those of several tracks."""
    return "trajectories" if layer.name == "trajectory" else layer.name
