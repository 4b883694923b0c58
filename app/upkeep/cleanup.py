"""Clean-up: uploads that were left alone go to the trash, and what is of no use any more is removed.

That is what has been in the trash for long enough, what dead servers were receiving, raw scans that are reduced, and
folders without a row that hold neither files nor a result. A folder without a row that holds some may be somebody's
only copy, as where an older database was brought back: it stays, and `check` names it.
"""

import logging
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress

from sqlalchemy import ColumnElement, and_, exists, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context, Helper
from app.drives.commit import tidy_drive
from app.http.problems import Problem
from app.jobs.folders import jobs_with_scratch, tidy
from app.ogc.index import index_missing
from app.states import FINAL, DriveState, JobKind, JobState
from app.store.models import CityMap, Drive, Job
from app.store.storage import INCOMING, is_old, remove_dead
from app.trash.deletion import delete_drive, empty_trash
from app.work.task import REDUCED
from interloc.errors import InterLocError

PERIOD_S = 3600.0
_USES_S = 120.0

_log = logging.getLogger(__name__)


def sweep(context: Context, *, by_age: bool = True) -> Counter[str]:
    """Do all of it, as several servers may at the same time; return how much was removed, by reason.

    What is old goes only `by_age`: not while the clock may be wrong.
    """
    swept: Counter[str] = Counter()
    if by_age:
        swept["expired"] = _expire(context)
        swept["purged"] = len(empty_trash(context, older_than_s=3600 * context.settings.trash_h))
        swept["unknown"] = _remove_unknown(context)
        for name, size in remove_dead(context.storage.folder(INCOMING)):
            _log.info("%s/%s: its server is dead, %d bytes removed", INCOMING, name, size)
            swept["incoming"] += 1
    with context.database.reading() as session:
        ready = select(Drive.id, Drive.keep_raw).where(Drive.state == DriveState.READY, Drive.deleted_at.is_(None))
        drives = session.execute(ready).all()
    for drive_id, keep_raw in drives:
        tidy_drive(context, drive_id, keep_raw=keep_raw)
    _tidy_scratch(context)
    index_missing(context)
    if swept.total():
        _log.info("clean-up: %s", ", ".join(f"{count} {reason}" for reason, count in swept.items() if count))
    return swept


def unknown_folders(context: Context) -> Iterator[tuple[str, bool]]:
    """Find the folders of drives, jobs and maps that have no row: their keys, and whether they hold what was kept.

    Scratch alone is what a killed server was receiving, or a worker makes whose job was purged: it goes when it is old.
    """
    for kind, table in (("drives", Drive), ("jobs", Job), ("maps", CityMap)):
        root = context.storage.folder(kind)
        paths = sorted(root.iterdir()) if root.is_dir() else []
        with context.database.reading() as session:  # after the folders, which are made after their rows
            known = set(session.scalars(select(table.id)))
        for path in paths:
            if path.name not in known and path.exists():  # not purged in between
                yield f"{kind}/{path.name}", any((path / name).exists() for name in ("files", REDUCED, "result"))


def _remove_unknown(context: Context) -> int:
    """Remove old folders without a row that hold nothing that was kept."""
    removed = 0
    for key, holds in unknown_folders(context):
        if not holds and is_old(context.storage.folder(key)):
            context.storage.delete(key)
            removed += 1
    return removed


def _expire(context: Context) -> int:
    """Move uploads that were abandoned to the trash."""
    with context.database.reading() as session:
        oldest = context.database.clock(session) - 3600 * context.settings.upload_expires_h
        found = session.execute(select(Drive.id, Drive.stored_bytes).where(_is_abandoned(oldest))).all()

    def is_expired(session: Session, drive: Drive) -> bool:
        return session.scalar(select(Drive.id).where(Drive.id == drive.id, _is_abandoned(oldest))) is not None

    expired = 0
    for drive_id, size in found:
        with suppress(Problem):  # deleted meanwhile
            if delete_drive(context, drive_id, None, only_if=is_expired):
                _log.info("drive %s: its upload was left alone and has expired, %d bytes to the trash", drive_id, size)
                expired += 1
    return expired


def _is_abandoned(oldest: float) -> ColumnElement[bool]:
    """Return the condition that nobody has touched an upload since a time, and no job works on it or has a result."""
    of_drive = exists().where(Job.drive_id == Drive.id).correlate(Drive)
    return and_(
        Drive.state == DriveState.UPLOADING,
        Drive.touched_at < oldest,
        Drive.deleted_at.is_(None),
        ~of_drive.where(Job.state.not_in(FINAL)),
        ~of_drive.where(Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL),
    )


def _tidy_scratch(context: Context) -> None:
    """Remove the scratch of jobs that have ended, left behind by a server that was killed before it could tidy."""
    found = jobs_with_scratch(context.storage)
    with context.database.reading() as session:
        ended = session.execute(select(Job.id, Job.state).where(Job.id.in_(found), Job.state.in_(FINAL))).all()
    for job_id, state in ended:
        tidy(context.storage, job_id, keep_result=state == JobState.SUCCESSFUL)


class Sweeper(Helper):
    """Cleans up once per hour.

    Every two minutes it writes when tokens were last used. Nothing is removed for its age within the first hour: the
    clock may have been set wrongly before the start, and an hour is time to notice that.
    """

    def __init__(self, context: Context) -> None:
        super().__init__("sweeper")
        self._context = context

    def run(self) -> None:
        """Do so; at the end it writes once more when tokens were last used."""
        sweep_at, by_age = time.monotonic(), False
        while True:
            try:
                self._context.tokens.write_uses()
                if time.monotonic() >= sweep_at and not self.stopping.is_set():
                    sweep_at += PERIOD_S
                    sweep(self._context, by_age=by_age)
                    by_age = True
            except (SQLAlchemyError, OSError, InterLocError) as error:
                _log.warning("clean-up: %s", error)
            if self.stopping.is_set():
                return
            self.stopping.wait(_USES_S)
