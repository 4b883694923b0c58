"""Clean-up: what has expired goes to the trash, what is known to be nobody's is removed, what is unknown is set aside.

Nothing is removed but what is known to be of no use: drives and jobs whose time in the trash is over, what dead servers
were receiving, archives that are unpacked, raw scans that are reduced. A folder of a drive or a job without a row may
be somebody's only copy, whatever became of the row: it goes to ``lost+found/``, and `interloc adopt` takes it back.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress

from sqlalchemy import ColumnElement, and_, exists, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.finish import tidy_drive
from app.drives.records import drive_key, lock_drive, note_extent
from app.http.problems import Problem
from app.metrics import Removal
from app.ogc.indexing import index_missing
from app.states import FINAL, DriveState, JobKind, JobState
from app.store import sidecars
from app.store.clock import ClockWatch
from app.store.incoming import is_old, remove_dead, size_of
from app.store.installation import id_of_database, id_of_folder
from app.store.models import Drive, Job
from app.store.storage import INCOMING
from app.trash.deletion import delete_drive, empty_trash, finish_purges
from app.work.places import TRAJECTORY
from interloc.errors import InterLocError

PERIOD_S = 3600.0
_KEEP_UP_S = 120.0
_STEADY_S = 3500.0  # one period, for which the clock must not have jumped before anything goes for its age
_JUMP_S = 600.0

_log = logging.getLogger(__name__)


def sweep(context: Context, *, by_age: bool = True) -> Counter[Removal]:
    """Do all of it, as several servers may at the same time; return how much was removed or set aside, by reason.

    Parameters
    ----------
    by_age
        Also what is old: not where the clock may be wrong.
    """
    swept: Counter[Removal] = Counter()
    if not _is_bound(context):
        return swept
    finish_purges(context)
    if by_age:
        swept["expired"] = _expire(context)
        swept["purged"] = len(empty_trash(context, older_than_s=3600 * context.settings.trash_h))
        swept["lost"] = len(set_unknown_aside(context))
        swept["archive"] = _remove_archives(context)
    else:
        _tell_of_unknown(context)
    swept["incoming"] = remove_incoming(context)
    _tidy_drives(context)
    _note_extents(context)
    _write_sidecars(context)
    index_missing(context)
    if swept.total():
        text = ", ".join(f"{count} {reason}" for reason, count in swept.items() if count)
        _log.info("clean-up: %s", text)
    return swept


def unknown_folders(context: Context) -> Iterator[str]:
    """Find the folders of drives and jobs that have no row, by their keys."""
    for kind, table in (("drives", Drive), ("jobs", Job)):
        root = context.storage.folder(kind)
        paths = sorted(root.iterdir()) if root.is_dir() else []
        with context.database.reading() as session:  # after the folders, which are made after their rows
            known = set(session.scalars(select(table.id)))
        for path in paths:
            if path.name not in known and path.exists():  # not purged in between
                yield f"{kind}/{path.name}"


def _tell_of_unknown(context: Context) -> None:
    """Name folders without a row while nothing goes for its age: soon after a start on an older copy of the rows."""
    keys = list(unknown_folders(context))
    if keys:
        text = (
            "no row knows %d folders of drives and jobs: %s. Is the database an older copy? `interloc adopt` makes rows"
        )
        _log.warning(text, len(keys), ", ".join(keys[:3]) + (", ..." if len(keys) > 3 else ""))


def set_unknown_aside(context: Context, *, only: str | None = None) -> list[tuple[str, str]]:
    """Move folders of drives and jobs that have no row to ``lost+found/``; return their keys before and after.

    Parameters
    ----------
    only
        Key of one folder; by default all that are older than any upload that goes on.
    """
    moved = []
    for key in unknown_folders(context):
        path = context.storage.folder(key)
        if not (is_old(path) if only is None else key == only):
            continue
        size, age_h = size_of(path), (_now(context) - path.stat().st_mtime) / 3600
        place = context.storage.set_aside(key)
        if place is not None:
            text = "%s: no row knows it (%d bytes, %.0f h old): moved to %s; `interloc adopt` makes a row for it"
            _log.warning(text, key, size, age_h, place)
            context.metrics.count_removal("lost", size)
            moved.append((key, place))
    return moved


def remove_incoming(context: Context) -> int:
    """Remove what servers were receiving that are dead; return the number of folders and files."""
    removed = remove_dead(context.storage.folder(INCOMING))
    for name, size in removed:
        _log.info("%s/%s: its server is dead, %d bytes removed", INCOMING, name, size)
        context.metrics.count_removal("incoming", size)
    return len(removed)


def _is_bound(context: Context) -> bool:
    """Return whether the data folder is still that of the database: a volume may have gone, or another one come."""
    with context.database.reading() as session:
        expected = id_of_database(session)
    found = id_of_folder(context.storage.root)
    if found == expected:
        return True
    _log.error(
        "no clean-up: the data folder %s holds the id of installation %s, the database that of %s. Usual cause: its "
        "volume was unmounted, or another one was mounted there",
        context.storage.root,
        found,
        expected,
    )
    return False


def _now(context: Context) -> float:
    with context.database.reading() as session:
        return context.database.clock(session)


def _expire(context: Context) -> int:
    """Move uploads that were abandoned to the trash."""
    oldest = _now(context) - 3600 * context.settings.upload_expires_h

    def is_expired(session: Session, drive: Drive) -> bool:
        return session.scalar(select(Drive.id).where(Drive.id == drive.id, _is_abandoned(oldest))) is not None

    with context.database.reading() as session:
        found = session.execute(select(Drive.id, Drive.stored_bytes).where(_is_abandoned(oldest))).all()
    expired = 0
    for drive_id, size in found:
        with suppress(Problem):  # deleted meanwhile
            if delete_drive(context, drive_id, None, only_if=is_expired):
                _log.info("drive %s: its upload was left alone and has expired, %d bytes to the trash", drive_id, size)
                context.metrics.count_removal("expired", size)
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


def _remove_archives(context: Context) -> int:
    """Remove archives that no job will unpack: their files are in the drive, or were refused."""
    root = context.storage.folder("drives")
    removed = 0
    for archive in root.glob("*/archives/*") if root.is_dir() else ():
        drive_id = archive.parent.parent.name
        if is_old(archive) and _is_done(context, drive_id, archive.name):
            size = size_of(archive)
            context.storage.delete(f"{drive_key(drive_id)}/archives/{archive.name}")
            _log.info("drive %s: archive %s is not needed any more, %d bytes removed", drive_id, archive.name, size)
            context.metrics.count_removal("archive", size)
            removed += 1
    return removed


def _is_done(context: Context, drive_id: str, archive: str) -> bool:
    with context.database.reading() as session:
        jobs = session.scalars(
            select(Job).where(Job.drive_id == drive_id, Job.kind == JobKind.UNPACK, Job.state.not_in(FINAL))
        )
        is_waited_for = any(job.request.get("archive") == f"archives/{archive}" for job in jobs)
        return not is_waited_for and session.get(Drive, drive_id) is not None


def _tidy_drives(context: Context) -> None:
    ready = select(Drive.id, Drive.keep_raw).where(Drive.state == DriveState.READY, Drive.deleted_at.is_(None))
    with context.database.reading() as session:
        found = session.execute(ready).all()
    for drive_id, keep_raw in found:
        tidy_drive(context, drive_id, keep_raw=keep_raw)


def _note_extents(context: Context) -> None:
    """Write where drives are that became ready under an older version, or were adopted."""
    has_none = select(Drive.id).where(Drive.state == DriveState.READY, Drive.west.is_(None), Drive.deleted_at.is_(None))
    with context.database.reading() as session:
        unknown = session.scalars(has_none).all()
    for drive_id in unknown:
        if (context.storage.folder(drive_key(drive_id)) / TRAJECTORY[0]).is_file():
            with context.database.writing(patient=True) as session, suppress(Problem):  # purged meanwhile
                note_extent(lock_drive(session, drive_id), context.storage)


def _write_sidecars(context: Context) -> None:
    """Write the rows beside the files where that is missing: of older versions, and of servers that were killed."""

    def lacks(key: str, name: str) -> bool:
        folder = context.storage.folder(key)
        return folder.is_dir() and not (folder / name).exists()

    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL)
    with context.database.reading() as session:
        for id_ in session.scalars(select(Drive.id)).all():
            if lacks(drive_key(id_), sidecars.DRIVE_FILE) and (drive := session.get(Drive, id_)) is not None:
                sidecars.write(context.storage, drive)
        for id_ in session.scalars(select(Job.id).where(*is_result)).all():
            if lacks(f"jobs/{id_}", sidecars.JOB_FILE) and (job := session.get(Job, id_)) is not None:
                sidecars.write(context.storage, job)


class Sweeper:
    """What a server does on the side, from `start` to `stop`: it cleans up once per hour.

    Every two minutes it makes the reserve of disk space again, and writes when tokens were last used. Nothing is
    removed for its age within the first hour, and after the clock of the database has jumped: it may have been set
    wrongly, before the start too, and an hour is time to notice that.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._watch = ClockWatch(_JUMP_S)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sweeper", daemon=True)

    def start(self) -> None:
        """Begin, in the background."""
        self._thread.start()

    def stop(self) -> None:
        """End, having done what is done every two minutes once more."""
        self._stopping.set()
        self._thread.join(5)

    def _run(self) -> None:
        sweep_at = time.monotonic()
        while True:
            self._keep_up()
            if self._stopping.is_set():
                return
            if time.monotonic() >= sweep_at:
                sweep_at += PERIOD_S
                try:
                    sweep(self._context, by_age=self._clock_is_steady())
                except (SQLAlchemyError, OSError, InterLocError) as error:
                    _log.warning("clean-up: %s", error)
            self._stopping.wait(_KEEP_UP_S)

    def _keep_up(self) -> None:
        self._context.reserve.fill()
        try:
            self._context.tokens.write_uses()
        except SQLAlchemyError as error:
            _log.warning("when tokens were last used could not be written: %s", error)

    def _clock_is_steady(self) -> bool:
        with self._context.database.reading() as session:
            return self._watch.look(self._context.database.clock(session)) >= _STEADY_S
