"""A drive to try the service with."""

from __future__ import annotations

import time

from fastapi import APIRouter, Response
from fastapi.concurrency import run_in_threadpool

from app.context import ContextDep
from app.demo.drive import begin_demo
from app.drives.commit import begin_commit, committed
from app.drives.models import CommitRequest, DriveModel
from app.http.headers import WaitSeconds
from app.http.openapi import Responses, problems
from app.http.security import ClientDep
from app.jobs.failures import raise_failure
from app.jobs.watcher import wait_for_job
from app.states import DriveState, JobState

router = APIRouter(tags=["Drives"])

_ANSWERS: Responses = {
    202: {"model": DriveModel, "description": "It is still being made or checked; ask for the drive again."},
    **problems({507: "The disk is full."}),
}


@router.post("/demo", summary="Make a demo drive", operation_id="make_demo_drive", responses=_ANSWERS)
async def make_demo(response: Response, context: ContextDep, client: ClientDep, wait_s: WaitSeconds) -> DriveModel:
    """Simulate a drive through a small made-up town, and commit it; its map is `map.osm` among its files.

    This takes about a minute. A second request answers with the drive that exists.
    """
    end = time.monotonic() + wait_s
    job = await run_in_threadpool(begin_demo, context, client)
    drive_id, check = job.drive_id, None
    job = await wait_for_job(context, job.id, wait_s)
    raise_failure(job)
    if job.state == JobState.SUCCESSFUL:
        check = await run_in_threadpool(begin_commit, context, drive_id, client, CommitRequest())
        if check is not None:
            check = await wait_for_job(context, check.id, max(0.0, end - time.monotonic()))
    drive = await run_in_threadpool(committed, context, drive_id, check)
    if drive.state != DriveState.READY:
        response.status_code = 202
    response.headers["Location"] = f"{context.settings.root_path}/api/v1/drives/{drive_id}"
    return drive
