"""STAC: drives and their results for catalogues."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response
from sqlalchemy import select

from app.context import ContextDep
from app.drives.records import find_drive
from app.drives.routes.drives import DriveId
from app.http.delivery import answer_tagged, service_address
from app.http.openapi import TAGGED, get_and_head, headers_named, problems
from app.http.paging import newest_first
from app.http.problem_types import NO_RESULTS
from app.http.problems import Problem
from app.jobs.chosen import chosen_results
from app.results.folder import ResultsDep
from app.stac import items as stac
from app.stac.models import StacCatalog, StacItem
from app.store.models import Drive, Job

router = APIRouter(prefix="/stac", tags=["Exports"])

_PROBLEMS = problems({404: "There is no such drive, or it has no result.", 410: "The result is no longer on disk."})


@get_and_head(
    router,
    "",
    summary="List drives with results for catalogues",
    operation_id="read_stac_catalog",
    response_class=Response,
    responses={**TAGGED, 200: {"model": StacCatalog, "description": "STAC 1.1.", "headers": headers_named("ETag")}},
)
def read_catalog(request: Request, context: ContextDep) -> Response:
    """Give a STAC catalogue: an item for each drive with a successful job, for STAC Browser, pystac and others."""
    with_result = chosen_results().with_only_columns(Job.drive_id)
    found = select(Drive.id, Drive.name).where(Drive.id.in_(with_result)).order_by(*newest_first(Drive))
    with context.database.reading() as session:
        drives = [(row.id, row.name) for row in session.execute(found)]
    content = stac.catalog(service_address(request), drives).model_dump_json()
    return answer_tagged(request, content.encode())


@get_and_head(
    router,
    "/drives/{drive_id}",
    summary="Describe a drive for catalogues",
    operation_id="read_stac_item",
    response_class=Response,
    responses={
        **TAGGED,
        **_PROBLEMS,
        200: {"model": StacItem, "description": "STAC 1.1.", "headers": headers_named("ETag")},
    },
)
def read_item(drive_id: DriveId, request: Request, context: ContextDep, results: ResultsDep) -> Response:
    """Give the STAC item of a drive: where and when it was, and the files of the job that stands for it."""
    with context.database.reading() as session:
        pinned = find_drive(session, drive_id).pinned_job
        job = session.scalars(chosen_results(Drive.id == drive_id)).first()
    if job is None:
        raise Problem(NO_RESULTS, f"Drive {drive_id} has no successful job of kind intersections yet.")
    made = stac.item(service_address(request), context.storage, job, results.open(job.id), pinned)
    unset = {"bbox"} if made.bbox is None else set()
    return answer_tagged(request, made.model_dump_json(exclude=unset).encode(), "application/geo+json")
