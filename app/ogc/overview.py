"""The map of all drives: simplified tracks, and the intersections of the result that stands for each."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic_core import from_json
from sqlalchemy import select
from sqlalchemy.orm import Session

from app.context import ContextDep
from app.drives import records
from app.http.delivery import answer_tagged
from app.http.gate import ClientDep
from app.http.openapi import get_and_head
from app.http.parameters import After, BoxFilter, lies_in, next_link
from app.http.prices import priced
from app.jobs.view import choice_of, chosen_results, title_of
from app.ogc.work import outline_of
from app.results.models import MEDIA_TYPE
from app.states import DriveState
from app.store.models import OF_RESULTS, Drive, FeatureLayer, Job
from app.store.storage import Storage
from app.work.places import TRAJECTORY
from interloc.errors import InterLocError
from interloc.output.geojson import encode, read_json

MAX_INTERSECTIONS = 5000
"""Per drive."""

_DECIMALS = 6  # 0.1 m

router = APIRouter(tags=["Drives"])


@get_and_head(router, "/overview", response_class=Response)
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

    That is the job that somebody has pinned, else the best. A drive without georeference has no geometry, unless that
    job has placed it on the map. `bbox` selects drives by their own georeference. Intersections of a drive are one
    feature of many points; `outcomes` has the verdict on each, in their order. The newest drives come first; `next` is
    `after` of the next page.
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
    except (
        OSError,
        InterLocError,
        KeyError,
        TypeError,
        AttributeError,
    ):  # gone or damaged: `interloc admin check` finds it
        return None


@lru_cache(4096)
def _read_track(path: Path, _mtime_ns: int) -> dict[str, Any] | None:
    return outline_of(read_json(path)["features"])
