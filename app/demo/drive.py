"""The demo drive of a client, which is made once."""

from __future__ import annotations

from contextlib import suppress

from sqlalchemy import select

from app.context import Context
from app.drives.models import DriveOptionsModel
from app.http.limits import check_free_space
from app.http.problems import Problem
from app.jobs.queue import submit
from app.jobs.view import is_alive
from app.states import DriveState, JobKind, JobState
from app.store.models import Drive, Job
from app.trash.deletion import delete_drive

NAME = "Demo: a small made-up town"
_NEEDED_BYTES = 500_000_000  # while it is made; most of it is removed by the commit


def begin_demo(context: Context, owner: str) -> Job:
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
        dead = session.scalars(
            select(Drive.id)
            .join(Job, Job.drive_id == Drive.id)
            .where(
                Job.kind == JobKind.DEMO,
                Job.owner == owner,
                Drive.state == DriveState.UPLOADING,
                Drive.file_count == 0,
                Drive.deleted_at.is_(None),
            )
        ).all()
        check_free_space(context, _NEEDED_BYTES)
        now = context.database.clock(session)
        options = DriveOptionsModel().model_dump(mode="json")
        drive = Drive(name=NAME, owner=owner, options=options, created_at=now, touched_at=now)
        session.add(drive)
        session.flush()
        job, _ = submit(session, context.database, kind=JobKind.DEMO, drive_id=drive.id, owner=owner, request={})
    for drive_id in dead:  # of demos that failed or were cancelled
        with suppress(Problem):
            delete_drive(context, drive_id, None, at_once=True)
    context.jobs_changed.set()
    return job
