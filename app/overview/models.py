"""The map of all drives, for the description of the API."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.jobs.chosen import Choice
from app.results.models import MEDIA_TYPE, LineGeometry, Position


class PointsGeometry(BaseModel):
    """Some places."""

    type: Literal["MultiPoint"]
    coordinates: list[Position]


class OverviewProperties(BaseModel):
    """Which drive a feature is of."""

    layer: Literal["drives", "intersections"] = Field(
        description="`drives`: the track of a drive; `intersections`: those of the result that stands for it."
    )
    drive: str = Field(description="Id of the drive.", examples=["1f6c0a7e5d2b9348"])
    name: str = Field(description="Name of the drive.", examples=["07"])
    job: str | None = Field(
        description="Id of the job that stands for it; null: none was successful.", examples=["9b1e44f00c7a2d53"]
    )
    chosen: Choice | None = Field(
        description="pinned: somebody has chosen that job. best: the best of preset default, else of paper, by F1 of "
        "its intersections; null: there is no such job."
    )
    title: str | None = Field(description="What that job is called; null: there is none.", examples=["default"])
    intersections: int | None = Field(description="How many intersections that job found; null: there is no such job.")
    outcomes: list[Literal["right", "wrong", "unscored"]] | None = Field(
        None, description="Of `intersections`: the verdict on each, in the order of the points; left out of tracks."
    )
    verdict: str | None = Field(
        description="How many of them are right, in words; null: the job was not scored.",
        examples=["5 of 6 intersections right within 10 m, 5 of 5 nodes found, median 1.0 m"],
    )


class OverviewFeature(BaseModel):
    """The track of a drive, simplified, or its intersections."""

    type: Literal["Feature"]
    id: str
    geometry: LineGeometry | PointsGeometry | None = Field(
        description="Null for the track of a drive that has no georeference."
    )
    properties: OverviewProperties


class Overview(BaseModel):
    """A page of the map of all drives, the newest first."""

    model_config = ConfigDict(json_schema_extra={"x-media-type": MEDIA_TYPE})

    type: Literal["FeatureCollection"]
    features: list[OverviewFeature]
    next: str | None = Field(description="Value of `after` for the next page; null on the last page.")
