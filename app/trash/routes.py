"""Endpoints: deleting of drives and jobs, and the trash to which drives go."""

from typing import Annotated

from fastapi import Query, Request, Response

from app.context import ContextDep
from app.drives import routes as drives
from app.http.gate import ClientDep
from app.http.parameters import answer_page
from app.http.prices import priced
from app.http.routing import API, ApiRouter
from app.jobs import routes as jobs
from app.jobs.models import JobModel
from app.jobs.queue import cancel
from app.jobs.view import find_job, job_models
from app.states import FINAL
from app.trash import deletion as trash
from app.trash.deletion import TrashItem, TrashList

router = ApiRouter(f"{API}/trash", tags=["Trash"])
of_items = ApiRouter()


@of_items.delete("/drives/{drive_id}", tags=["Drives"], status_code=204, summary="Delete a drive")
@priced("cheap")
def delete_drive(
    drive_id: drives.DriveId,
    context: ContextDep,
    client: ClientDep,
    purge: Annotated[bool, Query(description="Delete it for good, instead of moving it to the trash.")] = False,
) -> None:
    """Move a drive to the trash, with its files, its jobs and their results. Jobs that run are dismissed.

    It can be restored from there for some days (POST /api/v1/trash/drives/{id}/restore).
    """
    trash.delete_drive(context, drive_id, client, at_once=purge)


@of_items.delete(
    "/jobs/{job_id}",
    tags=["Jobs"],
    response_model=JobModel,
    summary="Cancel a job, or remove one that has ended",
    responses={
        200: {"description": "It has ended, by this request or earlier."},
        202: {"model": JobModel, "description": "It is being cancelled; it ends within seconds."},
        204: {"description": "The job and its results are gone."},
    },
)
@priced("cheap")
def delete_job(
    job_id: jobs.JobId,
    request: Request,
    response: Response,
    context: ContextDep,
    client: ClientDep,
    purge: Annotated[bool, Query(description="Delete a job that has ended for good, with its results.")] = False,
) -> JobModel | Response:
    """Cancel a job that waits or runs; one that has ended stays as it is, unless it is to be removed, for good."""
    request.state.action = "remove_job" if purge else "cancel_job"
    if purge:
        trash.delete_job(context, job_id, client)
        return Response(status_code=204)
    database = context.database
    with database.writing() as session:
        job, name = find_job(session, job_id)
        session.refresh(job, with_for_update=True)
        cancel(session, database, job)
        (model,) = job_models(session, context, [(job, name)])
    context.jobs_changed.set()
    response.status_code = 200 if model.state in FINAL else 202
    return model


@router.get_and_head("", response_model=TrashList, summary="List the trash")
@priced("cheap")
def list_trash(
    request: Request,
    context: ContextDep,
    after: Annotated[str | None, Query(max_length=100, description="`next` of the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List deleted drives, the last deleted first. Their jobs come and go with them."""
    return answer_page(request, trash.list_trash(context, after, limit))


@router.delete("", status_code=204, summary="Empty the trash")
@priced("heavy", bound="what is in the trash")
def empty_trash(context: ContextDep) -> None:
    """Delete everything in the trash for good, now."""
    trash.empty_trash(context)


@router.post("/drives/{drive_id}/restore", summary="Restore a drive from the trash")
@priced("cheap")
def restore_drive(drive_id: drives.DriveId, context: ContextDep) -> TrashItem:
    """Take a drive with its jobs and their results out of the trash."""
    return trash.restore(context, drive_id)
