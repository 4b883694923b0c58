"""Backups, made while servers run: every drive as it was at one moment, with its jobs and their results.

A backup is a folder in the layout of a data folder (``drives/<id>/...``, ``jobs/<id>/result/...``), with the rows in
``backup.sqlite3``, whatever database the service uses, and ``backup.json``, which says what it is a backup of and
whether it is complete.

Each drive is locked for the moment that it takes to give its files a second name, in the folder of this process below
``incoming/``, and to read its rows: uploads name files under the same lock, so within it rows and files agree. The
bytes are brought to the backup afterwards. There, the rows of a drive are written once its files are in place, and what
it no longer has is removed last: a backup that was stopped half-way is as good as it can be, and the next one goes on
from there.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, Self, TypeVar

from filelock import FileLock, Timeout
from pydantic import BaseModel, ValidationError
from sqlalchemy import Table, select
from sqlalchemy.exc import OperationalError
from sqlalchemy.exc import TimeoutError as WaitedTooLong

from app.context import Context
from app.drives.records import drive_key
from app.store.database import Database
from app.store.incoming import remove_dead
from app.store.installation import id_of_database
from app.store.models import Drive, Job
from app.store.storage import INCOMING
from app.upkeep.content import (
    DriveContent,
    Held,
    Row,
    back_in_queue,
    delete_content,
    find_files,
    read_content,
    read_shared,
    reason_of,
    write_content,
    write_shared,
    writing_rows,
)
from app.upkeep.transfer import Advance, Transfer, no_progress, prune, writing
from interloc.errors import ConfigError, InterLocError, OutputError
from interloc.files import atomic_write
from interloc.pipeline import versions

DATABASE = "backup.sqlite3"
RECORD = "backup.json"

LOCK = "lock"
_PAUSES_S = (0.2, 0.5, 1, 2, 4, 8)

Returned = TypeVar("Returned")


class BackupRecord(BaseModel):
    """What ``backup.json`` holds."""

    format: Literal[1] = 1
    installation: str
    """Id of the service that it is a backup of."""
    version: str
    """Of InterLoc."""
    begun_at: datetime
    ended_at: datetime | None = None
    complete: bool = False
    """Whether the backup went to its end; the other figures are those of its end."""
    drives: int = 0
    jobs: int = 0
    files: int = 0
    size_bytes: int = 0

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read the record of a backup; None where there is none.

        Raises
        ------
        InterLocError
            It cannot be understood.
        """
        try:
            return cls.model_validate_json((folder / RECORD).read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValidationError) as error:
            raise InterLocError(
                f"{folder / RECORD} cannot be read as the record of a backup; it was damaged, or written by a newer "
                "version of InterLoc."
            ) from error

    def write(self, folder: Path) -> None:
        """Write the record of a backup."""
        with atomic_write(folder / RECORD) as file:
            file.write(self.model_dump_json(indent=2).encode() + b"\n")


@dataclass
class BackupReport:
    """What a backup has done."""

    record: BackupRecord
    brought_files: int = 0
    brought_bytes: int = 0
    """What was not there from an earlier backup."""
    removed_files: int = 0
    """What an earlier backup had and the service has no longer."""
    longest_lock_s: float = 0.0
    """Longest time for which a drive was locked."""
    faults: list[str] = field(default_factory=list)
    """What is missing in the data folder, or not as listed."""


def back_up(context: Context, out: Path, advance: Advance = no_progress) -> BackupReport:
    """Make a backup, or bring an older one up to date.

    Parameters
    ----------
    context
        Of the service; its servers may run.
    out
        A new or an empty folder, or a backup of the same service.

    Raises
    ------
    ConfigError
        `out` is something else, or lies where it cannot be a backup of this data folder.
    InterLocError
        Another backup of the data folder is being made; or the database does not answer.
    OutputError
        The backup cannot be written, as on a full disk; the next one goes on from there.
    """
    out = Path(os.path.realpath(out))
    _check_place(context, out)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    with _alone(out):
        try:
            return _Backup(context, out, advance).run()
        except OutputError as error:
            raise OutputError(f"{error} The backup is not complete; the next one goes on where it stopped.") from error


class _Backup:
    """A backup that is being made."""

    def __init__(self, context: Context, out: Path, advance: Advance) -> None:
        self._context = context
        self._out = out
        self._advance = advance
        record = BackupRecord(
            installation=installation_of(context), version=str(versions()["interloc"]), begun_at=datetime.now(UTC)
        )
        self._report = BackupReport(record)
        record.write(out)  # it is not complete from here on
        remove_dead(context.storage.folder(INCOMING))  # what a backup that was killed has staged
        self._database = Database(f"sqlite:///{(out / DATABASE).as_posix()}")
        self._staging = Transfer(context.storage.incoming() / "backup")
        self._transfer = Transfer(out)
        self._done_bytes = self._total_bytes = 0

    def run(self) -> BackupReport:
        """Make it."""
        record = self._report.record
        try:
            self._database.upgrade()
            shared = _patiently(self._read_shared)
            with writing_rows(self._database) as session:
                write_shared(session, shared)
            drives = _patiently(self._read_drives)
            self._total_bytes = sum(drives.values())
            held = set()
            for drive_id, size in drives.items():
                before = self._done_bytes
                if self._back_up_drive(drive_id):
                    held.add(drive_id)
                self._done_bytes = before + size
            self._forget_all_but(held)
        finally:
            self._database.close()
            self._transfer.close()
        os.sync()
        self._report.brought_files, self._report.brought_bytes = self._transfer.files, self._transfer.size_bytes
        record.ended_at = datetime.now(UTC)
        record.complete = True
        record.write(self._out)
        return self._report

    def _read_shared(self) -> dict[Table, list[Row]]:
        with self._context.database.reading() as session:
            return read_shared(session)

    def _read_drives(self) -> dict[str, int]:
        """Return the ids of all drives, the oldest first, and how much is stored of each."""
        with self._context.database.reading() as session:
            rows = session.execute(select(Drive.id, Drive.stored_bytes).order_by(Drive.created_at, Drive.id))
            return {row.id: row.stored_bytes for row in rows}

    def _back_up_drive(self, drive_id: str) -> bool:
        """Bring the backup of a drive up to date; False if there is no such drive any more."""
        held = _patiently(lambda: self._hold(drive_id))
        if held is None:
            return False
        content, keys = held
        record = self._report.record
        end = self._done_bytes + int(content.drive["stored_bytes"])
        for key in keys:
            size = self._transfer.bring(self._staging.root / key, key)
            record.size_bytes += size
            self._done_bytes = min(end, self._done_bytes + size)
            self._advance(self._done_bytes, self._total_bytes, str(content.drive["name"]))
        self._transfer.finish()
        jobs = [back_in_queue(job) for job in content.jobs]
        with writing_rows(self._database) as session:
            write_content(session, DriveContent(content.drive, content.files, jobs))
        known = set(keys)
        for folder in (drive_key(drive_id), *(f"jobs/{job['id']}" for job in jobs)):
            self._report.removed_files += prune(self._out, folder, known)
        record.drives += 1
        record.jobs += len(jobs)
        record.files += len(keys)
        shutil.rmtree(self._staging.root, ignore_errors=True)
        return True

    def _hold(self, drive_id: str) -> tuple[DriveContent, list[str]] | None:
        """Read the rows of a drive, and give its files a second name, all as of one moment; None if it is deleted."""
        held = Held()
        with self._context.database.reading() as session:
            content = read_content(session, drive_id)
        if content is not None:
            self._stage(content, held)  # so that under the lock only that is left which changes from here on
        with self._context.database.writing() as session:
            began = time.monotonic()
            content = read_content(session, drive_id, lock=True)
            if content is None:
                return None
            keys, faults = self._stage(content, held)
            if faults:  # a job may have been removed since its row was read
                content = read_content(session, drive_id) or content
                keys, faults = self._stage(content, held)
        self._report.longest_lock_s = max(self._report.longest_lock_s, time.monotonic() - began)
        self._report.faults += faults
        return content, keys

    def _stage(self, content: DriveContent, held: Held) -> tuple[list[str], list[str]]:
        """Give the files of a drive a second name; returns their keys, and what is wrong with them."""
        root = self._context.storage.root
        found = find_files(self._context.storage, content, held)
        gone = set()
        for key in found.new:
            try:
                self._staging.bring(root / key, key)
            except FileNotFoundError:
                gone.add(key)
        self._staging.finish()
        for key in found.new:
            if key not in gone:  # known by what has the second name: the first may be another file by now
                stat = (self._staging.root / key).stat()
                held.files[key] = stat.st_size, stat.st_mtime_ns
        held.folders.update({known: keys for known, keys in found.folders.items() if gone.isdisjoint(keys)})
        keys = [key for key in found.keys if key not in gone]
        return keys, [*found.faults, *(f"{key} is not there" for key in gone)]

    def _forget_all_but(self, drives: Collection[str]) -> None:
        """Remove drives and jobs that the service has no longer."""
        with writing_rows(self._database) as session:
            for drive_id in session.scalars(select(Drive.id)).all():
                if drive_id not in drives:
                    delete_content(session, drive_id)
        with self._database.reading() as session:
            known = {
                "drives": set(session.scalars(select(Drive.id))),
                "jobs": set(session.scalars(select(Job.id))),
            }
        for folder, ids in known.items():
            for path in (self._out / folder).glob("*"):
                if path.name not in ids:
                    self._report.removed_files += prune(self._out, f"{folder}/{path.name}", ())


def _check_place(context: Context, out: Path) -> None:
    """Refuse a folder that cannot hold a backup of this service."""
    root = context.storage.root
    if out.is_relative_to(root):
        raise ConfigError(f"{out} lies in the data folder {root}; a backup belongs elsewhere, best on another disk.")
    if root.is_relative_to(out):
        raise ConfigError(f"{out} holds the data folder {root}; a backup needs a folder of its own.")
    if not out.exists():
        return
    if not out.is_dir():
        raise ConfigError(f"{out} is a file; a backup needs a folder. Give the name of a new or an empty one.")
    record = BackupRecord.read(out)
    if record is None:
        refuse_unless_empty(out, f"and no {RECORD}, so it is not a backup", but=LOCK)
    elif record.installation != installation_of(context):
        raise ConfigError(
            f"{out} is the backup of another service (installation {record.installation}, this one is "
            f"{installation_of(context)}). It was not touched. Give the name of a new or an empty folder."
        )


def refuse_unless_empty(folder: Path, remark: str, *, but: str = "lost+found") -> None:
    """Refuse a folder that holds something; the root of a disk always holds lost+found."""
    names = sorted(entry.name for entry in folder.iterdir() if entry.name not in {"lost+found", but})
    if names:
        shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise ConfigError(
            f"{folder} is not empty: it holds {shown} {remark}. It was not touched. Give the name of a new or an empty "
            "folder."
        )


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Keep others from making the same backup."""
    lock = FileLock(out / LOCK, timeout=0)
    try:
        with suppress(NotImplementedError):  # a file system without locks
            lock.acquire()
    except Timeout as error:
        raise InterLocError(f"the backup {out} is being made by another process; wait for it.") from error
    try:
        yield
    finally:
        lock.release()


def _patiently(work: Callable[[], Returned]) -> Returned:
    """Do work with the database of the service; again where it was busy or restarted."""
    for pause_s in (*_PAUSES_S, None):
        try:
            return work()
        except (OperationalError, WaitedTooLong) as error:
            if pause_s is None:
                raise InterLocError(
                    f"the database of the service does not answer: {reason_of(error)}. Make the backup again when it "
                    "does; what was brought so far is kept."
                ) from error
            time.sleep(pause_s)
    raise AssertionError


def installation_of(context: Context) -> str:
    """Return the id of a service."""
    with context.database.reading() as session:
        found = id_of_database(session)
    assert found is not None  # it has one since it was opened
    return found
