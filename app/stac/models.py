"""STAC as the description of the API has it: a catalogue, and one item per drive (SpatioTemporal Asset Catalog 1.1)."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class StacLink(BaseModel):
    """A link to another document."""

    rel: str = Field(examples=["item"])
    href: str = Field(description="Absolute address.")
    type: str = Field(description="Media type.", examples=["application/geo+json"])
    title: str


class StacCatalog(BaseModel):
    """All drives with a result."""

    type: Literal["Catalog"] = "Catalog"
    stac_version: str = Field(examples=["1.1.0"])
    id: str
    title: str
    description: str
    links: list[StacLink] = Field(description="One with `rel` item per drive.")


class StacAsset(BaseModel):
    """A file about a drive."""

    href: str = Field(description="Absolute address.")
    type: str = Field(description="Media type.")
    title: str
    roles: list[str]


class StacItem(BaseModel):
    """A drive, where and when it was, and the files of the result that stands for it."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": "application/geo+json"})

    type: Literal["Feature"] = "Feature"
    stac_version: str = Field(examples=["1.1.0"])
    id: str = Field(description="Id of the drive.")
    geometry: dict[str, Any] | None = Field(description="The track, simplified; null without georeference.")
    bbox: list[float] | None = Field(None, description="West, south, east, north of the track.")
    properties: dict[str, Any] = Field(
        description="`title`, `datetime` (null where `start_datetime` and `end_datetime` say when the drive was), "
        "`created`, `interloc:job`, `interloc:intersections`; `interloc:datetime_of` is `drive`, or `job` where the "
        "drive has no times of day: `datetime` is then when the job was submitted."
    )
    links: list[StacLink]
    assets: dict[str, StacAsset] = Field(description="Intersections, exports, report.")
