"""The trash: deleted drives and jobs, which can be restored until their time has come.

A row that is deleted is marked, its files stay where they are, and everything else treats it as absent. A purge first
renames the folders into ``trash/``, so that what is half deleted is known to be ours; then it removes the rows, then
the bytes. What is killed in between `finish_purges` completes; a folder whose row is alive it takes back.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import delete, select
from sqlalchemy.orm import Session, defer

from app.context import Context
from app.drives.records import drive_key, lock_drive
from app.http.paging import cursor_of, newest_first, rows_after
from app.http.problem_types import DRIVE_IN_THE_TRASH, JOB_NOT_ENDED, NOT_IN_THE_TRASH
from app.http.problems import Problem
from app.jobs.queue import cancel, no_drive
from app.jobs.view import no_job, title_of
from app.states import FINAL
from app.store import sidecars
from app.store.database import moment
from app.store.incoming import remove, size_of
from app.store.models import Drive, Job, columns_for
from app.store.storage import TRASH
from app.trash.models import TrashItem, TrashKind, TrashList

_JOBS_IN_TRASH = (
    select(Job, Drive.name)
    .join(Drive, Drive.id == Job.drive_id)
    .where(Job.deleted_at.is_not(None), Drive.deleted_at.is_(None))  # those of a deleted drive come and go with it
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Purged:
    """A drive or a job that was deleted for good."""

    kind: TrashKind
    """"drives" or "jobs"."""
    id: str
    size_bytes: int
    """Bytes that this set free."""


def delete_drive(
    context: Context,
    drive_id: str,
    client: str | None,
    *,
    at_once: bool = False,
    only_if: Callable[[Session, Drive], bool] | None = None,
) -> bool:
    """Move a drive to the trash with its jobs, cancelling those that wait or run; return whether it was moved.

    Parameters
    ----------
    client
        Who deletes it; None for an upload that expired.
    at_once
        Purge it, instead of keeping it for a while.
    only_if
        Condition, evaluated in the transaction that deletes the drive.

    Raises
    ------
    Problem
        404.
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
    else:
        _note(context, drive)
    return True


def _note(context: Context, drive: Drive) -> None:
    """Write beside the files of a drive whether it is deleted; one without files has no folder for that."""
    if context.storage.folder(drive_key(drive.id)).is_dir():
        sidecars.write(context.storage, drive)


def delete_job(context: Context, job_id: str, client: str) -> None:
    """Move a job that has ended to the trash, with its results.

    Raises
    ------
    Problem
        404: there is no such job. 409: it has not ended.
    """
    with context.database.writing() as session:
        job = _find(session, "jobs", job_id, is_deleted=False)
        assert isinstance(job, Job)
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
    drives = select(Drive).options(defer(Drive.report)).where(Drive.deleted_at.is_not(None))
    jobs = _JOBS_IN_TRASH
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
    """Take a drive with its jobs, or a job, out of the trash.

    Raises
    ------
    Problem
        404: it is not in the trash. 409: the drive of the job is in the trash itself.
    """
    with context.database.writing() as session:
        row = _find(session, kind, id_, is_deleted=True)
        name = row.name if isinstance(row, Drive) else session.get_one(Drive, row.drive_id).name
        item = _item(context, row, name)
        for folder in _folders_of(session, row):
            _put_back(context, folder)
        row.deleted_at = row.deleted_by = None
        if isinstance(row, Drive):
            row.touched_at = context.database.clock(session)  # an upload expires after a time from now on
        else:
            row.version += 1
    if isinstance(row, Drive):
        _note(context, row)
    _log.info("%s %s: restored from the trash", kind[:-1], id_)
    return item


def empty_trash(context: Context, *, older_than_s: float = 0.0) -> list[Purged]:
    """Purge what has been in the trash for some time."""
    with context.database.reading() as session:
        latest = context.database.clock(session) - older_than_s
        jobs = [job.id for job in session.scalars(_JOBS_IN_TRASH.where(Job.deleted_at <= latest))]
        drives = session.scalars(select(Drive.id).where(Drive.deleted_at <= latest)).all()
    doomed: list[tuple[TrashKind, str]] = [*(("jobs", id_) for id_ in jobs), *(("drives", id_) for id_ in drives)]
    purged = (purge(context, kind, id_) for kind, id_ in doomed)
    return [each for each in purged if each is not None]


def purge(context: Context, kind: TrashKind, id_: str) -> Purged | None:
    """Delete for good what is in the trash; None if it is there no more.

    Jobs of a drive that run end when they find their rows gone.
    """
    with context.database.writing() as session:
        row = _get(session, kind, id_)
        if row is None or not _is_deleted(session, row):
            return None
        folders = _folders_of(session, row)
        for folder in folders:
            _move_to_trash(context, folder)
        session.execute(delete(type(row)).where(type(row).id == id_))
    size = sum(_remove_bytes(context, folder) for folder in folders)
    context.metrics.count_removal("purged", size)
    _log.info("%s %s: deleted for good, %d bytes", kind[:-1], id_, size)
    return Purged(kind, id_, size)


def find_purgeable(context: Context, kind: TrashKind, id_: str) -> None:
    """Raise a 404 unless this is in the trash."""
    with context.database.reading() as session:
        _find(session, kind, id_, is_deleted=True)


def half_purged(context: Context) -> list[tuple[Path, TrashKind, str]]:
    """Return the folders whose purge has begun and not ended: path, kind, id."""
    root = context.storage.folder(TRASH)
    paths = sorted(root.iterdir()) if root.is_dir() else []
    kinds: tuple[TrashKind, ...] = ("drives", "jobs")
    return [
        (path, kind, path.name.removeprefix(f"{kind}-"))
        for path in paths
        for kind in kinds
        if path.name.startswith(f"{kind}-")
    ]


def finish_purges(context: Context) -> None:
    """Complete what a server did that was killed during a purge."""
    for path, kind, id_ in half_purged(context):
        with context.database.reading() as session:
            row = _get(session, kind, id_, lock=False)
            is_deleted = row is not None and _is_deleted(session, row)
            drive_id = row.drive_id if isinstance(row, Job) and row.deleted_at is None else None
        if row is None:
            size = _remove_bytes(context, (kind, id_))
            context.metrics.count_removal("purged", size)
            _log.info("%s: the rest of a deletion, %d bytes", path.name, size)
        elif is_deleted:
            purge(context, "drives", drive_id) if drive_id is not None else purge(context, kind, id_)
        else:
            with context.database.writing() as session:
                if (alive := _get(session, kind, id_)) is not None and not _is_deleted(session, alive):
                    _put_back(context, (kind, id_))
            _log.warning("%s: its row is alive, so it was taken back", path.name)


def _item(context: Context, row: Drive | Job, name: str) -> TrashItem:
    assert row.deleted_at is not None
    if isinstance(row, Drive):
        kind: TrashKind = "drives"
        size = row.stored_bytes
    else:
        kind = "jobs"
        size = size_of(context.storage.folder(f"jobs/{row.id}"))
    return TrashItem(
        **columns_for(TrashItem, row, but=("kind", "name", "size_bytes")),
        kind=kind,
        name=name,
        title=title_of(row) if isinstance(row, Job) else None,
        size_bytes=size,
        purged_at=moment(row.deleted_at + 3600 * context.settings.trash_h),
    )


def _get(session: Session, kind: TrashKind, id_: str, *, lock: bool = True) -> Drive | Job | None:
    """Return a row, locked until the transaction ends unless it is only to be looked at."""
    if kind == "drives":
        return session.get(Drive, id_, with_for_update=lock, populate_existing=True)
    return session.get(Job, id_, with_for_update=lock, populate_existing=True)


def _find(session: Session, kind: TrashKind, id_: str, *, is_deleted: bool) -> Drive | Job:
    row = _get(session, kind, id_)
    of_drive = session.get(Drive, row.drive_id) if isinstance(row, Job) else None
    if of_drive is not None and of_drive.deleted_at is not None and is_deleted:
        raise Problem(
            DRIVE_IN_THE_TRASH,
            f"The drive of job {id_} is in the trash itself. Restore it first "
            f"(POST /api/v1/trash/drives/{of_drive.id}/restore): its jobs come with it.",
        )
    if row is not None and is_deleted and row.deleted_at is not None:
        return row
    if row is not None and not is_deleted and not _is_deleted(session, row):
        return row
    if is_deleted:
        raise Problem(
            NOT_IN_THE_TRASH,
            f"There is no {kind[:-1]} {id_[:64]} in the trash; it may have been restored, or deleted for good. "
            "GET /api/v1/trash lists what is there.",
        )
    raise no_drive(id_) if kind == "drives" else no_job(id_)


def _is_deleted(session: Session, row: Drive | Job) -> bool:
    if row.deleted_at is not None or isinstance(row, Drive):
        return row.deleted_at is not None
    return session.get_one(Drive, row.drive_id).deleted_at is not None


def _folders_of(session: Session, row: Drive | Job) -> list[tuple[TrashKind, str]]:
    """Return the folders that come and go with a row."""
    if isinstance(row, Job):
        return [("jobs", row.id)]
    jobs = session.scalars(select(Job.id).where(Job.drive_id == row.id))
    return [("drives", row.id), *(("jobs", id_) for id_ in jobs)]


def _places(context: Context, folder: tuple[TrashKind, str]) -> tuple[Path, Path]:
    """Return the place of a folder, and the one while it is being deleted."""
    kind, id_ = folder
    return context.storage.folder(f"{kind}/{id_}"), context.storage.folder(f"{TRASH}/{kind}-{id_}")


def _move_to_trash(context: Context, folder: tuple[TrashKind, str]) -> None:
    place, doomed = _places(context, folder)
    if place.exists():
        doomed.parent.mkdir(parents=True, exist_ok=True)
        remove(doomed)  # an empty one of before; a folder with files is never replaced by a rename
        place.rename(doomed)


def _put_back(context: Context, folder: tuple[TrashKind, str]) -> None:
    place, doomed = _places(context, folder)
    if doomed.exists() and not place.exists():
        doomed.rename(place)


def _remove_bytes(context: Context, folder: tuple[TrashKind, str]) -> int:
    _, doomed = _places(context, folder)
    size = size_of(doomed)
    remove(doomed)
    return size
