"""Rows follow files: what a server that was killed has left apart is brought together again.

A file is only ever renamed into its place whole, within the transaction that writes its row. A kill between the two
leaves a file without a row, a row without a file, or a row that describes the file of before. The bytes are what
counts: rows are made, corrected and removed until they agree with them; no file is touched.

A file is known by its size and the time at which its bytes were written; only those that differ are read.
"""

from __future__ import annotations

import hashlib
import logging
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, cast

from sqlalchemy import Table, delete, func, insert, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.records import files_key, find_drive, lock_drive, stays_uploaded
from app.http.problems import Problem
from app.jobs.queue import active_job
from app.paths import BadNameError, check_path, folded_hash
from app.states import DriveState, JobKind
from app.store.models import Drive, DriveFile
from interloc.osm.container import is_map

_AT_ONCE = 1000  # rows in one statement
_KILLED_AT_ONCE = 8  # deletions that may go on when servers are killed

_files = cast("Table", DriveFile.__table__)
_log = logging.getLogger(__name__)


class Stamp(NamedTuple):
    """By what a file is known without reading it."""

    size_bytes: int
    mtime_ns: int | None


@dataclass(frozen=True)
class Difference:
    """A file of a drive whose row says something else."""

    path: str
    listed: Stamp | None
    """What its row says; None without a row."""
    found: Stamp | None
    """What the disk says; None without a file."""


Correction = Literal["listed", "unlisted", "renewed"]
"""What was done to the row of a file: it had none, it had no file, or it said something else."""


def reconcile(
    context: Context, drive_id: str, *, maps_only: bool = False, may_unlist: bool = True, is_news: bool = True
) -> dict[str, Correction]:
    """Make the rows of a drive agree with its files; return what was done to those that did not.

    Parameters
    ----------
    maps_only
        Look at the maps on the disk only: all that can have changed in a drive that is ready.
    may_unlist
        Whether rows go that have no file.
    is_news
        Whether corrections are logged; False where somebody asked for them, and is told.

    Raises
    ------
    Problem
        404: there is no such drive.
    OSError
        A file cannot be read.
    """
    digests: dict[tuple[str, Stamp], str] = {}
    while True:
        with context.database.reading() as session:  # in most cases nothing differs, and nobody has to wait
            seen = differences(session, context, find_drive(session, drive_id), maps_only=maps_only)
        if not may_unlist:
            seen = [each for each in seen if each.found is not None]
        if not seen:
            return {}
        root = context.storage.folder(files_key(drive_id))
        for each in seen:
            if each.found is not None and (each.path, each.found) not in digests:
                digests[each.path, each.found] = sha256_of(root / each.path)
        with context.database.writing() as session:
            drive = lock_drive(session, drive_id)
            found = differences(session, context, drive, maps_only=maps_only)
            found = [each for each in found if may_unlist or each.found is not None]
            if all(each.found is None or (each.path, each.found) in digests for each in found):
                corrections = dict(_correct(session, drive, found, digests))
                break
    for path, done in corrections.items() if is_news else ():
        _log.warning("drive %s: %s: %s", drive_id, path, _WORDS[done], extra={"drive": drive_id})
    return corrections


def reconcile_all(context: Context) -> None:
    """Make rows and files of all drives agree, before a server answers requests; a drive that fails is left as it is.

    Where an archive is still to be unpacked its job does so: it places its files once more, all or none.

    A kill leaves a file that was being deleted listed, no more than one per drive. Where more are missing, the folder
    is not the one that it should be, as an older copy or a volume of which a part is not mounted: no row goes then.
    """
    with context.database.reading() as session:
        drives = session.execute(select(Drive.id, Drive.state).where(Drive.deleted_at.is_(None))).all()
        unpacking = {
            drive_id
            for drive_id, state in drives
            if state != DriveState.READY
            and any(active_job(session, drive_id, kind) for kind in (JobKind.UNPACK, JobKind.DEMO))
        }
    missing: dict[str, int] = {}  # files of each drive in which anything differs
    closed = {drive_id for drive_id, state in drives if state == DriveState.READY}
    for drive_id, _ in drives:
        with _told(drive_id), context.database.reading() as session:
            if drive_id not in unpacking:
                drive = find_drive(session, drive_id)
                if found := differences(session, context, drive, maps_only=drive_id in closed):
                    missing[drive_id] = sum(each.found is None for each in found)
    may_unlist = max(missing.values(), default=0) <= 1 and sum(missing.values()) <= _KILLED_AT_ONCE
    if not may_unlist:
        _log.error(
            "%d files of %d drives are listed, but are not in the data folder %s: they stay listed. Is it the right "
            "one, and are all of its volumes mounted? `interloc check` names them, and --repair lists them no more",
            sum(missing.values()),
            sum(map(bool, missing.values())),
            context.storage.root,
        )
    for drive_id in missing:
        with _told(drive_id):
            reconcile(context, drive_id, maps_only=drive_id in closed, may_unlist=may_unlist)


@contextmanager
def _told(drive_id: str) -> Iterator[None]:
    """Leave a drive as it is where it cannot be compared, and tell of it."""
    try:
        yield
    except (OSError, SQLAlchemyError, Problem) as error:
        _log.warning("drive %s: rows and files could not be compared: %s", drive_id, error)


def differences(session: Session, context: Context, drive: Drive, *, maps_only: bool = False) -> list[Difference]:
    """Return the files of a drive whose rows say something else; exact only while the drive is locked."""
    found = dict(_stamps(context.storage.folder(files_key(drive.id)), maps_only=maps_only))
    query = select(_files.c.path, _files.c.size_bytes, _files.c.mtime_ns).where(_files.c.drive_id == drive.id)
    if maps_only:  # a drive may list many thousand scans that were reduced
        query = query.where(_files.c.path.in_(list(found)))
    listed = {path: Stamp(size, mtime_ns) for path, size, mtime_ns in session.execute(query)}
    return [
        Difference(path, listed.get(path), found.get(path))
        for path in sorted(listed.keys() | found.keys())
        if not _agree(listed.get(path), found.get(path))
        and (stays_uploaded(drive, path) if path in listed and path not in found else _can_be_listed(path))
    ]


def counts_of(session: Session, drive_id: str) -> tuple[int, int]:
    """Return how many files a drive lists, and their bytes."""
    query = select(func.count(), func.coalesce(func.sum(_files.c.size_bytes), 0))
    count, size = session.execute(query.where(_files.c.drive_id == drive_id)).one()
    return count, int(size)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_WORDS: dict[Correction, str] = {
    "listed": "it was on the disk but not listed; it is listed now",
    "unlisted": "it was listed but is not on the disk; it is listed no more",
    "renewed": "it was listed with another size or digest; it is listed as it is on the disk now",
}


def _agree(listed: Stamp | None, found: Stamp | None) -> bool:
    if listed is None or found is None:
        return False
    return listed.size_bytes == found.size_bytes and listed.mtime_ns in {None, found.mtime_ns}


def _can_be_listed(path: str) -> bool:
    try:
        check_path(path)
    except BadNameError:
        return False
    return True


def _stamps(root: Path, *, maps_only: bool) -> Iterator[tuple[str, Stamp]]:
    """Yield the files of a drive, as they are known without reading them."""
    for folder, _, names in os.walk(root):
        for name in names:
            path = os.path.join(folder, name)  # noqa: PTH118 - for tens of thousands of files
            relative = path[len(str(root)) + 1 :]
            if maps_only and not is_map(relative):
                continue
            try:
                found = os.lstat(path)
            except FileNotFoundError:
                continue
            if stat.S_ISREG(found.st_mode):
                yield relative, Stamp(found.st_size, found.st_mtime_ns)


def _correct(
    session: Session, drive: Drive, found: list[Difference], digests: dict[tuple[str, Stamp], str]
) -> Iterator[tuple[str, Correction]]:
    """Correct the rows of a drive that is locked, and its counts."""
    connection = session.connection()
    renewed = [each for each in found if each.listed is not None and each.found is not None]
    before = _digests(session, drive.id, [each.path for each in renewed])
    kept_before = _kept_bytes(session, drive)
    paths = [each.path for each in found if each.listed is not None]
    for start in range(0, len(paths), _AT_ONCE):
        some = paths[start : start + _AT_ONCE]
        connection.execute(delete(_files).where(_files.c.drive_id == drive.id, _files.c.path.in_(some)))
    rows = [
        {
            "drive_id": drive.id,
            "path": each.path,
            "size_bytes": each.found.size_bytes,
            "sha256": digests[each.path, each.found],
            "mtime_ns": each.found.mtime_ns,
            "folded": folded_hash(each.path),
        }
        for each in found
        if each.found is not None
    ]
    if rows:
        connection.execute(insert(_files), rows)
    count, size = counts_of(session, drive.id)
    stored = size if drive.state != DriveState.READY else drive.stored_bytes + _kept_bytes(session, drive) - kept_before
    session.execute(
        update(Drive).where(Drive.id == drive.id).values(file_count=count, size_bytes=size, stored_bytes=stored)
    )
    for each in found:
        if each.listed is None:
            yield each.path, "listed"
        elif each.found is None:
            yield each.path, "unlisted"
        elif before[each.path] != digests[each.path, each.found]:  # else it was only copied, or touched
            yield each.path, "renewed"


def _digests(session: Session, drive_id: str, paths: list[str]) -> dict[str, str]:
    known: dict[str, str] = {}
    for start in range(0, len(paths), _AT_ONCE):
        some = paths[start : start + _AT_ONCE]
        query = select(_files.c.path, _files.c.sha256).where(_files.c.drive_id == drive_id, _files.c.path.in_(some))
        known.update((path, sha256) for path, sha256 in session.execute(query))
    return known


def _kept_bytes(session: Session, drive: Drive) -> int:
    """Return the bytes of the files that a ready drive keeps as they were uploaded."""
    rows = session.execute(select(_files.c.path, _files.c.size_bytes).where(_files.c.drive_id == drive.id))
    return sum(size for path, size in rows if stays_uploaded(drive, path))
