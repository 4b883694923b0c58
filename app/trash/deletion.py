"""The trash: deleted drives, which can be restored with their jobs until their time has come.

A row that is deleted is marked, its files stay where they are, and everything else treats it as absent. What is purged
is first marked so that nobody can take it back (`_PURGING`); then its folders go, then its rows. Whatever a kill leaves
of that is still in a row, and the next clean-up goes on with it. A job is purged when it is deleted: its drive is there
to run it again.
"""

import logging
from collections.abc import Callable
from datetime import datetime
from typing import NamedTuple, Self, cast

from pydantic import BaseModel, Field
from sqlalchemy import delete, select
from sqlalchemy.orm import Session, defer

from app.context import Context
from app.drives.records import find_drive
from app.http.parameters import cursor_of, newest_first, rows_after
from app.http.problem_types import JOB_NOT_ENDED, NOT_IN_THE_TRASH
from app.http.problems import Problem
from app.jobs.queue import cancel
from app.jobs.view import no_job
from app.states import FINAL
from app.store.database import moment
from app.store.models import Drive, Job, columns_for
from app.store.storage import size_of

_PURGING = 0.0  # as the time of a deletion: long over

_log = logging.getLogger(__name__)


class TrashItem(BaseModel):
    """A deleted drive, with its jobs and their results."""

    id: str = Field(examples=["5f0c2b7d9a41e386"])
    name: str
    owner: str
    size_bytes: int = Field(description="Size of what is kept of it.")
    deleted_at: datetime
    deleted_by: str | None = Field(description="Client that deleted it; null for an upload that expired.")
    purged_at: datetime = Field(description="When it is deleted for good, unless it is restored.")

    @classmethod
    def of(cls, context: Context, drive: Drive) -> Self:
        """Describe a deleted drive."""
        assert drive.deleted_at is not None
        return cls(
            **columns_for(cls, drive, but=("size_bytes",)),
            size_bytes=drive.stored_bytes,
            purged_at=moment(drive.deleted_at + 3600 * context.settings.trash_h),
        )


class TrashList(BaseModel):
    """A page of the trash, the last deleted first."""

    items: list[TrashItem]
    next: str | None = Field(None, description="Value of `after` for the next page; null on the last page.")


class Purged(NamedTuple):
    """A drive or a job that was deleted for good, and the bytes that this set free."""

    kind: str
    id: str
    size_bytes: int


def delete_drive(
    context: Context,
    drive_id: str,
    client: str | None,
    *,
    at_once: bool = False,
    only_if: Callable[[Session, Drive], bool] | None = None,
) -> bool:
    """Move a drive to the trash with its jobs, cancelling those that wait or run; return whether it was moved.

    No client deletes an upload that expired. `at_once` purges it instead of keeping it for a while; `only_if` is
    evaluated in the transaction that deletes it. A 404 where there is none.
    """
    of_drive = select(Job).where(Job.drive_id == drive_id)
    with context.database.writing() as session:
        session.scalars(of_drive.order_by(Job.id).with_for_update()).all()  # jobs first, as where a job ends
        drive = find_drive(session, drive_id, lock=True)
        if only_if is not None and not only_if(session, drive):
            return False
        for job in session.scalars(of_drive):
            cancel(session, context.database, job)
        drive.deleted_at = context.database.clock(session)
        drive.deleted_by = client
    _log.info("drive %s: deleted by %s", drive_id, client or "the clean-up", extra={"drive": drive_id})
    context.jobs_changed.set()
    context.maps_changed.set()
    if at_once or context.settings.trash_h == 0:
        purge(context, Drive, drive_id)
    return True


def delete_job(context: Context, job_id: str, client: str) -> None:
    """Delete a job that has ended (409 where it has not) for good, with its results."""
    with context.database.writing() as session:
        job = session.get(Job, job_id, with_for_update=True)
        if job is None or job.deleted_at is not None or session.get_one(Drive, job.drive_id).deleted_at is not None:
            raise no_job(job_id)
        if job.state not in FINAL:
            raise Problem(
                JOB_NOT_ENDED, f"Job {job.id} is {job.state}. Cancel it first (DELETE without purge), then remove it."
            )
        job.deleted_at = _PURGING
        job.version += 1
    _log.info("job %s: deleted by %s", job_id, client, extra={"job": job_id})
    purge(context, Job, job_id)


def list_trash(context: Context, after: str | None, limit: int) -> TrashList:
    """Return a page of what is in the trash, the last deleted first."""
    asked = select(Drive).options(defer(Drive.report)).where(Drive.deleted_at > _PURGING)
    if after is not None:
        asked = asked.where(rows_after(Drive, after, "deleted_at"))
    with context.database.reading() as session:
        found = session.scalars(asked.order_by(*newest_first(Drive, "deleted_at")).limit(limit + 1)).all()
    return TrashList(
        items=[TrashItem.of(context, drive) for drive in found[:limit]],
        next=cursor_of(found[limit - 1], "deleted_at") if len(found) > limit else None,
    )


def restore(context: Context, drive_id: str) -> TrashItem:
    """Take a drive with its jobs out of the trash; a 404 where it is not there."""
    with context.database.writing() as session:
        drive = session.get(Drive, drive_id, with_for_update=True)
        if drive is None or not drive.deleted_at:
            raise Problem(
                NOT_IN_THE_TRASH,
                f"There is no drive {drive_id[:64]} in the trash; it may have been restored, or deleted for good. "
                "GET /api/v1/trash lists what is there.",
            )
        item = TrashItem.of(context, drive)
        drive.deleted_at = drive.deleted_by = None
        drive.touched_at = context.database.clock(session)  # an upload expires after a time from now on
    _log.info("drive %s: restored from the trash", drive_id)
    return item


def empty_trash(context: Context, *, older_than_s: float = 0.0) -> list[Purged]:
    """Purge what has been in the trash for some time, and what was being purged by a server that was killed."""
    with context.database.reading() as session:
        latest = context.database.clock(session) - older_than_s
        found = [
            (table, id_)
            for table in (Job, Drive)  # versions before had jobs in the trash, too
            for id_ in session.scalars(select(table.id).where(table.deleted_at <= latest))
        ]
    purged = [purge(context, table, id_) for table, id_ in found]
    return [each for each in purged if each is not None]


def purge(context: Context, table: type[Drive | Job], id_: str) -> Purged | None:
    """Delete for good what is marked as deleted; None if it is there no more.

    Jobs of a drive that run end when they find their rows gone.
    """
    with context.database.writing() as session:
        row = cast("Drive | Job | None", session.get(table, id_, with_for_update=True))
        if row is None or row.deleted_at is None:
            return None
        row.deleted_at = _PURGING
        jobs = session.scalars(select(Job.id).where(Job.drive_id == id_)).all()
    size = 0
    for key in (f"{table.__tablename__}/{id_}", *(f"jobs/{job}" for job in jobs)):
        size += size_of(context.storage.folder(key))
        context.storage.delete(key)
    with context.database.writing() as session:
        # first the jobs, as where one ends: a cascade would lock its drive before them
        session.scalars(select(Job.id).where(Job.drive_id == id_).order_by(Job.id).with_for_update()).all()
        session.execute(delete(table).where(table.id == id_))
    kind = table.__name__.lower()
    _log.info("%s %s: deleted for good, %d bytes", kind, id_, size)
    return Purged(kind, id_, size)
