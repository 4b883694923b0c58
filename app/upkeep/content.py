"""What belongs to a drive: its rows in the database, and the files that they stand for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from sqlalchemy import Select, Table, delete, insert, select, update
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.orm import Session

from app.drives.records import drive_key, files_key, reduced_key, stays_uploaded
from app.states import ACTIVE, DriveState, JobKind, JobState
from app.store import sidecars
from app.store.database import Database
from app.store.models import CityMap, Drive, DriveFile, Installation, Job, MapDrive, MapPlace, MapVerdict, Token
from app.store.storage import Storage
from app.work.places import TRAJECTORY
from interloc.drives.scans.reduced_format import MANIFEST
from interloc.errors import OutputError
from interloc.output.layout import RUN_FILE

Row = dict[str, Any]

_drives, _files, _jobs = (cast("Table", table.__table__) for table in (Drive, DriveFile, Job))

DRIVE_TABLES = (_drives, _files, _jobs)
"""Tables whose rows belong to a drive."""

SHARED_TABLES = tuple(
    cast("Table", table.__table__) for table in (Installation, Token, CityMap, MapDrive, MapPlace, MapVerdict)
)
"""Tables whose rows belong to the service as a whole."""


@dataclass(frozen=True)
class DriveContent:
    """The rows of a drive, as dictionaries by column: they are written into another database as they are."""

    drive: Row
    files: list[Row]
    jobs: list[Row]

    @property
    def id(self) -> str:
        """Id of the drive."""
        return str(self.drive["id"])


@dataclass
class Held:
    """Files of a drive that have a second name already, and need not be looked at again."""

    files: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Size and time by key."""
    folders: dict[tuple[str, float], list[str]] = field(default_factory=dict)
    """Keys of the files of a whole folder, by its key and the time at which the drive was last touched."""


@dataclass
class ContentFiles:
    """The files of a drive that were found."""

    keys: list[str] = field(default_factory=list)
    """Their keys in the storage."""
    new: list[str] = field(default_factory=list)
    """Those that are not held yet."""
    folders: dict[tuple[str, float], list[str]] = field(default_factory=dict)
    """As of `Held`."""
    faults: list[str] = field(default_factory=list)
    """What is missing, or is not as the rows say."""


def read_content(session: Session, drive_id: str, *, lock: bool = False) -> DriveContent | None:
    """Read the rows of a drive; None where there is no such drive.

    Parameters
    ----------
    lock
        Lock the drive until the transaction ends: no file of it takes or loses its name meanwhile.
    """
    query = select(_drives).where(_drives.c.id == drive_id)
    drives = _rows(session, query.with_for_update() if lock else query)
    if not drives:
        return None
    files = _rows(session, select(_files).where(_files.c.drive_id == drive_id))
    return DriveContent(drives[0], files, _rows(session, select(_jobs).where(_jobs.c.drive_id == drive_id)))


def _rows(session: Session, query: Select[Any]) -> list[Row]:
    found = session.execute(query)
    columns = tuple(found.keys())
    return [dict(zip(columns, row, strict=True)) for row in found]


def write_content(session: Session, content: DriveContent) -> None:
    """Write the rows of a drive in place of those that the database has of it."""
    delete_content(session, content.id)
    for job in content.jobs:
        if job["idempotency_key"] is not None:  # of a job that was removed since, of whatever drive
            key = _jobs.c.owner == job["owner"], _jobs.c.idempotency_key == job["idempotency_key"]
            session.execute(delete(_jobs).where(*key))
    if content.drive.get("idempotency_key") is not None:  # likewise of another drive
        taken = [_drives.c[name] == content.drive[name] for name in ("owner", "idempotency_key")]
        session.execute(update(_drives).where(*taken).values(idempotency_key=None))
    for table, rows in zip(DRIVE_TABLES, ([content.drive], content.files, content.jobs), strict=True):
        if rows:
            session.execute(insert(table), rows)


def write_missing_sidecars(storage: Storage, content: DriveContent) -> None:
    """Write beside the files what the rows say, where that is not there."""
    if not (storage.folder(drive_key(content.id)) / sidecars.DRIVE_FILE).is_file():
        sidecars.write(storage, Drive(**content.drive))
    for job in content.jobs:
        if _has_result(job) and not (storage.folder(f"jobs/{job['id']}") / sidecars.JOB_FILE).is_file():
            sidecars.write(storage, Job(**job))


def delete_content(session: Session, drive_id: str) -> None:
    """Remove the rows of a drive."""
    session.execute(delete(_drives).where(_drives.c.id == drive_id))


def read_shared(session: Session) -> dict[Table, list[Row]]:
    """Read the rows of the service as a whole."""
    return {table: _rows(session, select(table)) for table in SHARED_TABLES}


def write_shared(session: Session, shared: dict[Table, list[Row]]) -> None:
    """Write the rows of the service as a whole in place of those that the database has."""
    for table, rows in shared.items():
        session.execute(delete(table))
        if rows:
            session.execute(insert(table), rows)


@contextmanager
def writing_rows(database: Database) -> Iterator[Session]:
    """Open a transaction for rows that are brought from another database.

    Raises
    ------
    OutputError
        They could not be written, as on a full disk.
    """
    try:
        with database.writing() as session:
            yield session
    except SQLAlchemyError as error:
        shown = database.url.render_as_string(hide_password=True)
        raise OutputError(f"rows could not be written into the database {shown}: {reason_of(error)}.") from error


def reason_of(error: SQLAlchemyError) -> str:
    """Return what a database says is wrong, in one line."""
    return " ".join(str(error.orig if isinstance(error, DBAPIError) else error).split())


def back_in_queue(job: Row) -> Row:
    """Return a job as a service can go on with it that knows nothing of who works on it now."""
    if job["state"] not in ACTIVE:
        return job
    anew = {"done": 0, "total": None, "attempts": 0, "lease_owner": None, "lease_until": None, "started_at": None}
    message = job["message"] if job["state"] == JobState.ACCEPTED else None
    return {
        **job,
        **anew,
        "state": JobState.ACCEPTED,
        "stage": "waiting",
        "message": message,
        "version": job["version"] + 1,
    }


def find_files(storage: Storage, content: DriveContent, held: Held | None = None) -> ContentFiles:
    """Find the files that a drive and its jobs need.

    Parameters
    ----------
    held
        What is not to be looked at again where its rows are the same.

    Notes
    -----
    Only files that rows stand for: what an upload leaves behind that was cut off belongs to nothing.
    """
    held, found = held or Held(), ContentFiles()
    for key, size, mtime_ns in _listed(storage, content):
        found.keys.append(key)
        if held.files.get(key) == (size, mtime_ns):
            continue
        try:
            actual = (storage.root / key).stat().st_size
        except (FileNotFoundError, NotADirectoryError):
            found.faults.append(f"{key} is not there")
            found.keys.pop()
            continue
        if size not in {None, actual}:
            found.faults.append(f"{key} has {actual:,} bytes, not {size:,} as listed")
        found.new.append(key)
    for folder, marker in _folders(content):
        known = folder, float(content.drive["touched_at"])
        keys = held.folders.get(known)
        if keys is None:
            keys = list(_below(storage, folder))
            found.new += keys
        if f"{folder}/{marker}" not in keys:
            found.faults.append(f"{folder}/{marker} is not there")
        found.folders[known] = keys
        found.keys += keys
    return found


def _listed(storage: Storage, content: DriveContent) -> Iterator[tuple[str, int | None, int | None]]:
    """Yield the keys of single files, with their sizes and times where they are known."""
    drive, folder, files = Drive(**content.drive), drive_key(content.id), files_key(content.id)
    is_reduced = storage.folder(reduced_key(content.id)).is_dir()
    for row in content.files:
        key = f"{files}/{row['path']}"
        # What a commit reduces goes, unless nothing has replaced it.
        if stays_uploaded(drive, row["path"]) or (not is_reduced and (storage.root / key).is_file()):
            yield key, row["size_bytes"], row["mtime_ns"]
    if drive.state == DriveState.READY:
        names = [name for name in TRAJECTORY if (storage.folder(folder) / name).is_file()]
        yield f"{folder}/{(names or TRAJECTORY)[0]}", None, None
    for job in content.jobs:
        if job["kind"] == JobKind.UNPACK and job["state"] in ACTIVE:
            yield f"{folder}/{job['request']['archive']}", None, None
    for key in (f"{folder}/{sidecars.DRIVE_FILE}", *(f"jobs/{job['id']}/{sidecars.JOB_FILE}" for job in content.jobs)):
        if (storage.root / key).is_file():  # the clean-up writes one that is missing
            yield key, None, None


def _folders(content: DriveContent) -> Iterator[tuple[str, str]]:
    """Yield the keys of whole folders, each with the name of a file that it must hold."""
    if content.drive["state"] == DriveState.READY:
        yield reduced_key(content.id), MANIFEST
    for job in content.jobs:
        if _has_result(job):
            yield f"jobs/{job['id']}/result", RUN_FILE


def _has_result(job: Row) -> bool:
    return bool(job["kind"] == JobKind.INTERSECTIONS and job["state"] == JobState.SUCCESSFUL)


def _below(storage: Storage, folder: str) -> Iterator[str]:
    root = str(storage.root)
    for parent, _, names in os.walk(f"{root}/{folder}"):
        below = Path(parent).relative_to(root).as_posix()
        for name in names:
            yield f"{below}/{name}"
