"""A drive to try the service with."""

import time

from fastapi import Response
from fastapi.concurrency import run_in_threadpool
from sqlalchemy import select

from app.context import Context, ContextDep
from app.drives.commit import begin_commit, committed
from app.drives.models import CommitRequest, DriveModel, DriveOptionsModel
from app.http.gate import ClientDep
from app.http.headers import WaitSeconds
from app.http.intake import check_free_space
from app.http.prices import priced
from app.http.routing import ApiRouter
from app.jobs.failures import raise_failure
from app.jobs.queue import submit
from app.jobs.view import is_alive, wait_for_job
from app.states import DriveState, JobKind, JobState
from app.store.models import Drive, Job

router = ApiRouter(tags=["Drives"])

_NAME = "Demo: a small made-up town"
_NEEDED_BYTES = 500_000_000  # while it is made; most of it is removed by the commit


@router.post("/demo")
@priced("cheap")
async def make_demo(response: Response, context: ContextDep, client: ClientDep, wait_s: WaitSeconds) -> DriveModel:
    """Simulate a drive through a small made-up town, and commit it; its map is `map.osm` among its files.

    This takes about a minute. A second request answers with the drive that exists.
    """
    end = time.monotonic() + wait_s
    job = await run_in_threadpool(_begin, context, client)
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


def _begin(context: Context, owner: str) -> Job:
    """Return the job that makes, or has made, the demo drive of a client; a 507 where the disk is full."""
    with context.database.writing() as session:
        context.database.lock_owner(session, f"demo {owner}")  # one at a time, so that there is one drive
        job = session.scalars(
            select(Job)
            .join(Drive, Drive.id == Job.drive_id)
            .where(
                Job.kind == JobKind.DEMO,
                Job.owner == owner,
                Job.state.not_in([JobState.FAILED, JobState.DISMISSED]),
                is_alive(),
            )
            .order_by(Job.created_at.desc())
            .limit(1)
        ).first()
        if job is not None:
            return job
        check_free_space(context, _NEEDED_BYTES)
        now = context.database.clock(session)
        options = DriveOptionsModel().model_dump(mode="json")
        drive = Drive(name=_NAME, owner=owner, options=options, created_at=now, touched_at=now)
        session.add(drive)
        session.flush()
        job, _ = submit(session, context.database, kind=JobKind.DEMO, drive_id=drive.id, owner=owner, request={})
    context.jobs_changed.set()
    return job
