"""The documents of OGC API - Features, for the description of the API."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.results.models import MEDIA_TYPE as GEOJSON


class OgcLink(BaseModel):
    """A link."""

    href: str = Field(description="Absolute address.")
    rel: str
    type: str
    title: str


class OgcLandingPage(BaseModel):
    """Where to begin."""

    title: str
    description: str
    links: list[OgcLink]


class OgcInterface(BaseModel):
    """The interface as a document of OpenAPI 3.0."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": "application/vnd.oai.openapi+json;version=3.0"})

    openapi: Literal["3.0.3"]
    info: dict[str, Any]
    servers: list[dict[str, Any]]
    paths: dict[str, Any]
    components: dict[str, Any]


class OgcConformance(BaseModel):
    """What the interface keeps to."""

    conformsTo: list[str]
    links: list[OgcLink]


class OgcCollection(BaseModel):
    """A layer."""

    id: str
    title: str
    description: str
    attribution: str = Field(description="Whose data it is.")
    extent: dict[str, Any] = Field({}, description="Box and times; absent where there is nothing.")
    itemType: Literal["feature"]
    crs: list[str]
    itemCount: int = Field(description="Number of features.")
    links: list[OgcLink]


class OgcCollections(BaseModel):
    """All layers."""

    links: list[OgcLink]
    collections: list[OgcCollection]


class OgcFeature(BaseModel):
    """A feature; its properties are described by the schema of its collection."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": GEOJSON})

    type: Literal["Feature"]
    id: str
    geometry: dict[str, Any] | None
    properties: dict[str, Any]
    links: list[OgcLink] = []


class OgcFeatures(BaseModel):
    """A page of features."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": GEOJSON})

    type: Literal["FeatureCollection"]
    links: list[OgcLink]
    numberMatched: int = Field(description="Number of all features that were asked for.")
    numberReturned: int = Field(description="Number of features on this page.")
    features: list[OgcFeature]


class OgcSchema(BaseModel):
    """A JSON schema of features, or of what filters may name."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": "application/schema+json"})

    title: str
    description: str
    type: Literal["object"]
    properties: dict[str, Any]
