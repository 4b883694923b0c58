"""The trash: deleted drives and jobs, which can be restored until their time has come.

A row that is deleted is marked, its files stay where they are, and everything else treats it as absent. What is purged
is first marked so that nobody can take it back (`_PURGING`); then its folders go, then its rows. Whatever a kill leaves
of that is still in a row, and the next clean-up goes on with it.
"""

import logging
from collections.abc import Callable
from datetime import datetime
from typing import Literal, NamedTuple

from pydantic import BaseModel, Field
from sqlalchemy import delete, select
from sqlalchemy.orm import Session, defer

from app.context import Context
from app.drives.records import lock_drive
from app.http.parameters import cursor_of, newest_first, rows_after
from app.http.problem_types import DRIVE_IN_THE_TRASH, JOB_NOT_ENDED, NOT_IN_THE_TRASH
from app.http.problems import Problem
from app.jobs.queue import cancel
from app.jobs.view import no_job, title_of
from app.states import FINAL
from app.store.database import moment
from app.store.incoming import size_of
from app.store.models import Drive, Job, columns_for

_PURGING = 0.0  # as the time of a deletion: long over
_JOBS_IN_TRASH = (
    select(Job, Drive.name)
    .join(Drive, Drive.id == Job.drive_id)
    .where(Job.deleted_at.is_not(None), Drive.deleted_at.is_(None))  # those of a deleted drive come and go with it
)

_log = logging.getLogger(__name__)


TrashKind = Literal["drives", "jobs"]


class TrashItem(BaseModel):
    """A deleted drive, with its jobs and their results; or a deleted job, with its results."""

    kind: TrashKind
    id: str = Field(examples=["5f0c2b7d9a41e386"])
    name: str = Field(description="Name of the drive, also for a job.")
    title: str | None = Field(None, description="What a job is called; null for a drive.")
    owner: str
    size_bytes: int = Field(description="Size of what is kept of it.")
    deleted_at: datetime
    deleted_by: str | None = Field(description="Client that deleted it; null for an upload that expired.")
    purged_at: datetime = Field(description="When it is deleted for good, unless it is restored.")


class TrashList(BaseModel):
    """A page of the trash, the last deleted first."""

    items: list[TrashItem]
    next: str | None = Field(None, description="Value of `after` for the next page; null on the last page.")


class Purged(NamedTuple):
    """A drive or a job that was deleted for good, and the bytes that this set free."""

    kind: TrashKind
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
        drive = lock_drive(session, drive_id)
        if only_if is not None and not only_if(session, drive):
            return False
        for job in session.scalars(of_drive):
            cancel(session, context.database, job)
        drive.deleted_at = context.database.clock(session)
        drive.deleted_by = client
    _log.info("drive %s: deleted by %s", drive_id, client or "the clean-up", extra={"drive": drive_id})
    context.jobs_changed.set()
    if at_once or context.settings.trash_h == 0:
        purge(context, "drives", drive_id)
    return True


def delete_job(context: Context, job_id: str, client: str) -> None:
    """Move a job that has ended (409 where it has not) to the trash, with its results."""
    with context.database.writing() as session:
        job = session.get(Job, job_id, with_for_update=True)
        if job is None or job.deleted_at is not None or _drive_of(session, job).deleted_at is not None:
            raise no_job(job_id)
        if job.state not in FINAL:
            raise Problem(
                JOB_NOT_ENDED,
                f"Job {job.id} is {job.state}. Cancel it first (DELETE without purge), then remove it.",
            )
        job.deleted_at = context.database.clock(session)
        job.deleted_by = client
        job.version += 1
    _log.info("job %s: deleted by %s", job_id, client, extra={"job": job_id})
    if context.settings.trash_h == 0:
        purge(context, "jobs", job_id)


def list_trash(context: Context, after: str | None, limit: int) -> TrashList:
    """Return a page of what is in the trash, the last deleted first."""
    drives = select(Drive).options(defer(Drive.report)).where(Drive.deleted_at > _PURGING)
    jobs = _JOBS_IN_TRASH.where(Job.deleted_at > _PURGING)
    if after is not None:
        drives = drives.where(rows_after(Drive, after, "deleted_at"))
        jobs = jobs.where(rows_after(Job, after, "deleted_at"))
    with context.database.reading() as session:
        found: list[tuple[Drive | Job, str]] = [
            (drive, drive.name)
            for drive in session.scalars(drives.order_by(*newest_first(Drive, "deleted_at")).limit(limit + 1))
        ]
        rows = session.execute(jobs.order_by(*newest_first(Job, "deleted_at")).limit(limit + 1))
        found += [(job, name) for job, name in rows]
    found.sort(key=lambda pair: (pair[0].deleted_at or 0.0, pair[0].id), reverse=True)
    page = found[:limit]
    return TrashList(
        items=[_item(context, row, name) for row, name in page],
        next=cursor_of(page[-1][0], "deleted_at") if len(found) > limit else None,
    )


def restore(context: Context, kind: TrashKind, id_: str) -> TrashItem:
    """Take a drive with its jobs, or a job, out of the trash: 404 not there; 409 its drive is there, too."""
    with context.database.writing() as session:
        row = _find(session, kind, id_)
        item = _item(context, row, (row if isinstance(row, Drive) else _drive_of(session, row)).name)
        row.deleted_at = row.deleted_by = None
        if isinstance(row, Drive):
            row.touched_at = context.database.clock(session)  # an upload expires after a time from now on
        else:
            row.version += 1
    _log.info("%s %s: restored from the trash", kind[:-1], id_)
    return item


def purge_item(context: Context, kind: TrashKind, id_: str) -> None:
    """Purge what is in the trash: 404 not there; 409 the drive of the job is there, too."""
    with context.database.reading() as session:
        _find(session, kind, id_)
    purge(context, kind, id_)


def empty_trash(context: Context, *, older_than_s: float = 0.0) -> list[Purged]:
    """Purge what has been in the trash for some time, and what was being purged by a server that was killed."""
    with context.database.reading() as session:
        latest = context.database.clock(session) - older_than_s
        jobs = [job.id for job in session.scalars(_JOBS_IN_TRASH.where(Job.deleted_at <= latest))]
        drives = session.scalars(select(Drive.id).where(Drive.deleted_at <= latest)).all()
    purged = [*(purge(context, "jobs", id_) for id_ in jobs), *(purge(context, "drives", id_) for id_ in drives)]
    return [each for each in purged if each is not None]


def purge(context: Context, kind: TrashKind, id_: str) -> Purged | None:
    """Delete for good what is in the trash; None if it is there no more.

    Jobs of a drive that run end when they find their rows gone.
    """
    with context.database.writing() as session:
        row = _get(session, kind, id_)
        if row is None or row.deleted_at is None:
            return None
        row.deleted_at = _PURGING
        jobs = session.scalars(select(Job.id).where(Job.drive_id == id_)).all() if kind == "drives" else []
    size = 0
    for key in (f"{kind}/{id_}", *(f"jobs/{job}" for job in jobs)):
        size += size_of(context.storage.folder(key))
        context.storage.delete(key)
    with context.database.writing() as session:
        session.execute(delete(type(row)).where(type(row).id == id_))
    context.metrics.count_removal("purged", size)
    _log.info("%s %s: deleted for good, %d bytes", kind[:-1], id_, size)
    return Purged(kind, id_, size)


def _item(context: Context, row: Drive | Job, name: str) -> TrashItem:
    assert row.deleted_at is not None
    return TrashItem(
        **columns_for(TrashItem, row, but=("kind", "name", "size_bytes")),
        kind="drives" if isinstance(row, Drive) else "jobs",
        name=name,
        title=None if isinstance(row, Drive) else title_of(row),
        size_bytes=row.stored_bytes if isinstance(row, Drive) else size_of(context.storage.folder(f"jobs/{row.id}")),
        purged_at=moment(row.deleted_at + 3600 * context.settings.trash_h),
    )


def _drive_of(session: Session, job: Job) -> Drive:
    return session.get_one(Drive, job.drive_id)


def _get(session: Session, kind: TrashKind, id_: str) -> Drive | Job | None:
    if kind == "drives":
        return session.get(Drive, id_, with_for_update=True)
    return session.get(Job, id_, with_for_update=True)


def _find(session: Session, kind: TrashKind, id_: str) -> Drive | Job:
    """Return the row of what is in the trash, locked until the transaction ends."""
    row = _get(session, kind, id_)
    if isinstance(row, Job) and _drive_of(session, row).deleted_at is not None:
        raise Problem(
            DRIVE_IN_THE_TRASH,
            f"The drive of job {id_} is in the trash itself. Restore it first "
            f"(POST /api/v1/trash/drives/{row.drive_id}/restore): its jobs come with it.",
        )
    if row is None or not row.deleted_at:
        raise Problem(
            NOT_IN_THE_TRASH,
            f"There is no {kind[:-1]} {id_[:64]} in the trash; it may have been restored, or deleted for good. "
            "GET /api/v1/trash lists what is there.",
        )
    return row
