"""What results look like, for the description of the API."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

MEDIA_TYPE = "application/geo+json"

LayerName = Literal[
    "intersections",
    "roads",
    "trajectory",
    "osm_nodes",
    "detections",
    "keyframes",
    "junctions",
    "road_surface",
    "matches",
    "osm_roads",
    "osm_buildings",
    "places",
]
"""The layers that are files of a result, as in `interloc.output.layers.LAYERS`."""


class Feature(BaseModel):
    """A feature of a layer."""

    type: Literal["Feature"]
    id: str | int
    geometry: dict[str, Any] | None = Field(description="Longitude first; lines and areas may have several parts.")
    properties: dict[str, Any] = Field(description="Those that docs/attributes.md lists.")
    details: dict[str, Any] = Field({}, description="What InterLoc itself reads again, such as covariances.")


class FeatureCollection(BaseModel):
    """A layer of a result."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": MEDIA_TYPE})

    type: Literal["FeatureCollection"]
    drive: str | None = None
    job: str | None = None
    preset: str | None = None
    labels: str | None = Field(None, description="Where the labels of the points came from.")
    attribution: str = Field("", description="Whose data it is.")
    license: str = Field("", description="Address of the licence of OpenStreetMap, where it holds data of it.")
    bbox: list[float] = Field([], description="West, south, east, north of all features; absent where there are none.")
    features: list[Feature]


class ResultFile(BaseModel):
    """A file of a result."""

    name: str = Field(examples=["figures/map.png"])
    size_bytes: int
    media_type: str = Field(examples=["image/svg+xml"])
    href: str = Field(examples=["/api/v1/jobs/9b1e44f00c7a2d53/files/figures/map.png"])


class ResultFileList(BaseModel):
    """All files of a result: the result folder exactly as the command line writes it."""

    files: list[ResultFile]
