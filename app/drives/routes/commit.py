"""Endpoints: from uploaded files to a drive that jobs can use."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.concurrency import run_in_threadpool

from app.context import ContextDep
from app.drives.commit import begin_commit, committed
from app.drives.models import CommitRequest, DriveModel
from app.drives.records import find_trajectory
from app.drives.routes.drives import NOT_FOUND, DriveId
from app.http.delivery import WholeFile
from app.http.headers import WaitSeconds
from app.http.openapi import problems
from app.http.security import ClientDep
from app.jobs.watcher import wait_for_job
from app.states import DriveState

router = APIRouter(prefix="/drives/{drive_id}", tags=["Uploads"])

_CONFLICT = problems({409: "The drive is not in the state for this."})


@router.post(
    "/commit",
    responses={
        202: {"model": DriveModel, "description": "The check goes on; ask for the drive again."},
        **NOT_FOUND,
        **_CONFLICT,
        **problems(
            {422: "The drive has errors: `problems` lists all, `report` has the details.", 507: "The disk is full."}
        ),
    },
    summary="Commit a drive",
)
async def commit_drive(
    drive_id: DriveId,
    response: Response,
    context: ContextDep,
    client: ClientDep,
    wait_s: WaitSeconds,
    request: CommitRequest | None = None,
) -> DriveModel:
    """Check all files, reduce the scans to what the method needs, and make the drive ready for jobs.

    Waits until the check has ended. A drive with errors is open again afterwards: correct its
    files and commit it again. The commit of a drive that is being checked waits for that check; that of a ready drive
    changes nothing. Both are refused where they name other options than those in force.
    """
    job = await run_in_threadpool(begin_commit, context, drive_id, client, request or CommitRequest())
    if job is not None:
        job = await wait_for_job(context, job.id, wait_s)
    drive = await run_in_threadpool(committed, context, drive_id, job)
    if drive.state == DriveState.CHECKING:
        response.status_code = 202
    if drive.state == DriveState.CHECKING or job is not None:
        response.headers["Location"] = f"{context.settings.root_path}/api/v1/drives/{drive_id}"
    return drive


@router.get(
    "/trajectory",
    response_class=WholeFile,
    responses={
        200: {"content": {"application/geo+json": {}}, "description": "A FeatureCollection with one LineString."},
        206: {"content": {"application/geo+json": {}}, "description": "The range that was asked for."},
        **NOT_FOUND,
        **_CONFLICT,
        **problems({410: "The trajectory is no longer on disk.", 416: "There is no such range."}),
    },
    summary="Show the trajectory of a drive",
)
def show_trajectory(drive_id: DriveId, context: ContextDep, _client: ClientDep) -> WholeFile:
    """Return the trajectory of a ready drive: longitude and latitude, or metres with `"local": true`."""
    with find_trajectory(context, drive_id).open("rb") as file:
        return WholeFile(file, media_type="application/geo+json", headers={"Cache-Control": "private, no-cache"})
