"""The map of all drives: simplified tracks, and the intersections of the result that stands for each."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import from_json
from sqlalchemy import select
from sqlalchemy.orm import Session

from app.context import ContextDep
from app.drives import records
from app.http.delivery import answer_tagged
from app.http.openapi import TAGGED, get_and_head
from app.http.paging import After, lies_in, next_link
from app.http.parameters import BoxFilter
from app.http.prices import priced
from app.http.security import ClientDep
from app.jobs.view import Choice, choice_of, chosen_results, title_of
from app.ogc.work import outline_of
from app.results.models import MEDIA_TYPE, LineGeometry, Position
from app.states import DriveState
from app.store.features import OF_RESULTS
from app.store.models import Drive, FeatureLayer, Job
from app.store.storage import Storage
from app.work.places import TRAJECTORY
from interloc.errors import InterLocError
from interloc.output.geojson import encode, read_json

MAX_INTERSECTIONS = 5000
"""Per drive."""

_DECIMALS = 6  # 0.1 m

router = APIRouter(tags=["Drives"])


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


@get_and_head(
    router,
    "/overview",
    summary="Show all drives on one map",
    response_class=Response,
    responses={
        **TAGGED,
        200: {"model": Overview, "description": "GeoJSON."},
    },
)
@priced("heavy")
def show_overview(
    request: Request,
    context: ContextDep,
    _client: ClientDep,
    box: BoxFilter,
    after: After = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Maximum number of drives.")] = 100,
) -> Response:
    """Give the track of every ready drive, simplified, and the intersections of the job that stands for it.

    A drive without georeference has no geometry, unless that job has placed it on the map. `bbox` selects drives by
    their own georeference.
    """
    conditions = [Drive.state == DriveState.READY, *([] if box is None else [lies_in(box)])]
    page = records.list_drives(context, after, limit, conditions)
    with context.database.reading() as session:
        features = list(_features(session, context.storage, page.drives))
    content = encode({"type": "FeatureCollection", "features": features, "next": page.next}).encode()
    return answer_tagged(request, content, MEDIA_TYPE, **next_link(request, page.next))


def _features(session: Session, storage: Storage, drives: Sequence[Any]) -> Iterator[dict[str, Any]]:
    jobs = {job.drive_id: job for job in session.scalars(chosen_results(Drive.id.in_([each.id for each in drives])))}
    of_jobs = FeatureLayer.job_id.in_([job.id for job in jobs.values()])
    layers = {(each.job_id, each.layer): each for each in session.scalars(select(FeatureLayer).where(of_jobs))}
    table = OF_RESULTS["intersections"].c
    asked = select(table.layer_id, table.west, table.south, table.outcome).order_by(table.layer_id, table.number)
    ids = [each.id for (_, layer), each in layers.items() if layer == "intersections"]
    points = defaultdict(list)
    for layer_id, west, south, outcome in session.execute(asked.where(table.layer_id.in_(ids))):
        points[layer_id].append(([round(west, _DECIMALS), round(south, _DECIMALS)], outcome or "unscored"))
    for drive in drives:
        job = jobs.get(drive.id)
        properties = _properties(drive, job)
        track = None if job is None else layers.get((job.id, "trajectory"))
        # That of the result comes first: a drive without GNSS may have been placed on the map by that job.
        own = None if track is None or track.outline is None else from_json(track.outline)
        yield {
            "type": "Feature",
            "id": drive.id,
            "geometry": own or _own_track(storage.folder(f"drives/{drive.id}") / TRAJECTORY[0]),
            "properties": {"layer": "drives", **properties},
        }
        found = None if job is None else layers.get((job.id, "intersections"))
        if found is not None and (some := points[found.id][:MAX_INTERSECTIONS]):
            places, outcomes = zip(*some, strict=True)
            yield {
                "type": "Feature",
                "id": f"{drive.id}/intersections",
                "geometry": {"type": "MultiPoint", "coordinates": places},
                "properties": {"layer": "intersections", **properties, "outcomes": outcomes},
            }


def _properties(drive: Any, job: Job | None) -> dict[str, Any]:  # noqa: ANN401 - a row of the list of drives
    summary = {} if job is None else job.summary or {}
    job_id = None if job is None else job.id
    return {
        "drive": drive.id,
        "name": drive.name,
        "job": job_id,
        "chosen": choice_of(drive.pinned_job, job_id),
        "intersections": summary.get("intersections"),
        "title": None if job is None else title_of(job),
        "verdict": (summary.get("report") or {}).get("map_line"),
    }


def _own_track(path: Path) -> dict[str, Any] | None:
    try:
        return _read_track(path, path.stat().st_mtime_ns)
    except (OSError, InterLocError, KeyError, TypeError, AttributeError):  # gone or damaged: `interloc check` finds it
        return None


@lru_cache(4096)
def _read_track(path: Path, _mtime_ns: int) -> dict[str, Any] | None:
    return outline_of(read_json(path)["features"])
