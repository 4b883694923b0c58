"""Clean-up of abandoned uploads, and of what servers left behind that were killed."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Exists, exists, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.records import delete_drive, drive_key, files_key, reduced_key
from app.http.intake import INCOMING
from app.http.problems import Problem
from app.paths import is_map
from app.states import FINAL, DriveState, JobKind
from app.store.clock import ClockWatch
from app.store.models import Base, Drive, Job

PERIOD_S = 3600.0
_STEADY_S = 3500.0  # one period, for which the clock must not have jumped before anything is removed for its age
_JUMP_S = 600.0
LEFT_ALONE_S = 24 * 3600.0
"""Age from which a file or folder without a row in the database is a leftover: no upload takes so long."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SweepReport:
    """What was removed.

    Attributes
    ----------
    drives : list of str
        Ids of uploads that were abandoned.
    leftovers : list of str
        Keys of files and folders that have no row in the database.
    """

    drives: list[str]
    leftovers: list[str]


def sweep(context: Context, *, by_age: bool = True) -> SweepReport:
    """Remove what is no longer needed; several servers may do this at the same time.

    Parameters
    ----------
    context
    by_age
        Also what is old: not where the clock may be wrong.
    """
    report = SweepReport(_remove_expired(context) if by_age else [], [])
    for key in _leftovers(context) if by_age else ():
        context.storage.delete(key)
        report.leftovers.append(key)
    with context.database.reading() as session:
        ready = session.execute(select(Drive.id, Drive.keep_raw).where(Drive.state == DriveState.READY)).all()
    for drive_id, keep_raw in ready:
        tidy_drive(context, drive_id, keep_raw=keep_raw)
    if report.drives or report.leftovers:
        _log.info("clean-up: %d expired uploads, %d leftovers", len(report.drives), len(report.leftovers))
    return report


def tidy_drive(context: Context, drive_id: str, *, keep_raw: bool) -> None:
    """Remove the uploaded files of a ready drive except maps, which jobs read from there.

    Small files and reduced scans are in its reduced folder. Doing it again changes nothing.
    """
    if keep_raw:
        return
    root = context.storage.folder(files_key(drive_id))
    if not context.storage.folder(reduced_key(drive_id)).is_dir():
        _log.error("drive %s is ready, but its reduced folder is not there", drive_id)
        return
    raw = [
        path
        for folder, _, names in os.walk(root)
        for path in (Path(folder, name) for name in names)
        if not is_map(path.relative_to(root).as_posix())
    ]
    if raw:
        os.sync()  # what replaces them, and the row in the database, must survive a power failure
    for path in raw:
        with suppress(OSError):
            path.unlink()
    for folder, folders, _ in os.walk(root, topdown=False):
        for name in folders:
            with suppress(OSError):
                Path(folder, name).rmdir()


def _remove_expired(context: Context) -> list[str]:
    """Remove uploads that were abandoned."""
    with context.database.reading() as session:
        oldest = context.database.clock(session) - 3600 * context.settings.upload_expires_h
        found = session.scalars(
            select(Drive.id).where(Drive.state == DriveState.UPLOADING, Drive.touched_at < oldest, ~_is_worked_on())
        ).all()

    def is_expired(session: Session, drive: Drive) -> bool:
        worked_on = session.scalar(select(_is_worked_on()).where(Drive.id == drive.id))
        return drive.state == DriveState.UPLOADING and drive.touched_at < oldest and not worked_on

    removed = []
    for drive_id in found:
        with suppress(Problem):  # deleted meanwhile
            if delete_drive(context, drive_id, only_if=is_expired):
                removed.append(drive_id)
    return removed


def _is_worked_on() -> Exists:
    return exists().where(Job.drive_id == Drive.id, Job.state.not_in(FINAL)).correlate(Drive)


def _leftovers(context: Context) -> Iterator[str]:
    """Find what is old and belongs to no drive and no job."""
    yield from (f"{INCOMING}/{path.name}" for path in _old(context.storage.folder(INCOMING)))
    tables: dict[str, type[Base]] = {"drives": Drive, "jobs": Job}
    for folder, table in tables.items():
        for path in _old(context.storage.folder(folder)):
            with context.database.reading() as session:
                is_known = session.get(table, path.name) is not None
            if not is_known:
                yield f"{folder}/{path.name}"
    drives = context.storage.folder("drives")
    for archive in drives.glob("*/archives/*") if drives.is_dir() else ():
        drive_id = archive.parent.parent.name
        if _is_old(archive) and not _is_waited_for(context, drive_id, archive.name):
            yield f"{drive_key(drive_id)}/archives/{archive.name}"


def _is_waited_for(context: Context, drive_id: str, archive: str) -> bool:
    with context.database.reading() as session:
        jobs = session.scalars(
            select(Job).where(Job.drive_id == drive_id, Job.kind == JobKind.UNPACK, Job.state.not_in(FINAL))
        )
        return any(job.request.get("archive") == f"archives/{archive}" for job in jobs)


def _old(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if _is_old(path)] if folder.is_dir() else []


def _is_old(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > LEFT_ALONE_S
    except OSError:  # gone meanwhile
        return False


class Sweeper:
    """Cleans up once per hour, from `start` to `stop`.

    Nothing is removed for its age within the first hour, and after the clock of the database has jumped: it may have
    been set wrongly, before the start too, and an hour is time to notice that.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._watch = ClockWatch(_JUMP_S)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin, in the background."""
        self._thread = threading.Thread(target=self._run, name="sweeper", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(5)

    def _run(self) -> None:
        while True:
            try:
                sweep(self._context, by_age=self._clock_is_steady())
            except (SQLAlchemyError, OSError) as error:
                _log.warning("clean-up: %s", error)
            if self._stopping.wait(PERIOD_S):
                return

    def _clock_is_steady(self) -> bool:
        with self._context.database.reading() as session:
            return self._watch.look(self._context.database.clock(session)) >= _STEADY_S
