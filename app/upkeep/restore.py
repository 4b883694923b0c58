"""Restoration of a backup into an empty data folder and an empty database, of whatever kind.

Drive by drive, files first, then rows: a restoration that was stopped goes on with the drive where it was stopped.
Until it has ended, no server starts on the data folder.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from pydantic import ValidationError
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.context import RESTORING, Context
from app.settings import Settings
from app.states import DriveState
from app.store.database import Database
from app.store.installation import id_of_database, remark_folder
from app.store.models import Drive, Installation, Job, Token
from app.store.storage import Storage
from app.upkeep.backup import DATABASE, RECORD, BackupRecord, refuse_unless_empty
from app.upkeep.check import Discrepancy, check
from app.upkeep.content import (
    DriveContent,
    find_files,
    read_content,
    read_shared,
    write_content,
    write_missing_sidecars,
    write_shared,
    writing_rows,
)
from app.upkeep.transfer import Advance, Transfer, no_progress, writing
from interloc.errors import ConfigError, InterLocError
from interloc.files import atomic_write

_SHOWN = 3


@dataclass
class RestoreReport:
    """What was restored."""

    record: BackupRecord
    """Of the backup."""
    drives: int = 0
    jobs: int = 0
    """Number of them that the service has now."""
    files: int = 0
    size_bytes: int = 0
    """What was brought from the backup."""
    findings: list[Discrepancy] = field(default_factory=list)
    """What the quick check at the end has found: something only where the backup is not whole."""


def restore(
    settings: Settings, backup: Path, *, incomplete: bool = False, advance: Advance = no_progress
) -> RestoreReport:
    """Restore a backup, or go on with it.

    Parameters
    ----------
    settings
        Those with which the service will run: data folder and database.
    backup
        Folder of the backup; it stays as it is.
    incomplete
        Restore what there is of a backup that was not made to its end, or of which something is missing.

    Raises
    ------
    ConfigError
        The folder is not a backup, or is not whole; the data folder or the database is not empty.
    OutputError
        The data folder cannot be written, as on a full disk.
    """
    backup = Path(os.path.realpath(backup))
    record = BackupRecord.read(backup)
    if record is None:
        raise ConfigError(f"{backup} is not a backup: it has no {RECORD}. `interloc backup` makes backups.")
    if not (record.complete or incomplete):
        raise ConfigError(
            f"the backup {backup} was not made to its end. Make it again with `interloc backup`, which goes on where "
            "it stopped; or --incomplete restores the drives that it holds already."
        )
    resumed = _check_folder(settings.data_dir, record)
    with _rows_of(backup, record) as rows:
        with rows.reading() as session:
            drives = list(session.scalars(select(Drive.id).order_by(Drive.created_at, Drive.id)))
        if not incomplete:
            _refuse_damaged(Storage(backup), rows, drives)
        with _target(settings, record, resumed=resumed, drives=drives) as database:
            report = RestoreReport(record)
            _bring_all(Storage(backup), rows, drives, Storage(settings.data_dir), database, report, advance)
    remark_folder(settings.data_dir, record.installation)
    (settings.data_dir / RESTORING).unlink()
    context = Context.open(settings)
    try:
        report.findings = check(context, quick=True)
    finally:
        context.close()
    return report


def _bring_all(
    backup: Storage,
    rows: Database,
    drives: Sequence[str],
    storage: Storage,
    database: Database,
    report: RestoreReport,
    advance: Advance,
) -> None:
    """Bring all drives that are not there yet, then what belongs to the service as a whole."""
    with database.reading() as session:
        there = set(session.scalars(select(Drive.id)))
    missing = [drive_id for drive_id in drives if drive_id not in there]
    with rows.reading() as session:
        sizes = session.execute(select(Drive.id, Drive.stored_bytes))
        total = sum(size for drive_id, size in sizes if drive_id in missing)
    transfer = Transfer(storage.root)
    done = 0
    for drive_id in missing:
        with rows.reading() as session:
            content = read_content(session, drive_id)
        assert content is not None
        end = done + int(content.drive["stored_bytes"])
        for key in find_files(backup, content).keys:
            done = min(end, done + transfer.bring(backup.root / key, key))
            advance(done, total, str(content.drive["name"]))
        transfer.finish()
        done = end
        with writing_rows(database) as session:
            content = _from_now_on(content, database.clock(session))
            write_content(session, content)
        write_missing_sidecars(storage, content)
    transfer.close()
    with rows.reading() as session:
        shared = read_shared(session)
    with writing_rows(database) as session:
        write_shared(session, shared)
        if id_of_database(session) is None:  # of a version without ids, or of a backup that had hardly begun
            session.add(Installation(id=report.record.installation, created_at=report.record.begun_at.timestamp()))
            session.flush()
        report.drives = session.scalar(select(func.count()).select_from(Drive)) or 0
        report.jobs = session.scalar(select(func.count()).select_from(Job)) or 0
    os.sync()
    report.files, report.size_bytes = transfer.files, transfer.size_bytes


def _from_now_on(content: DriveContent, now: float) -> DriveContent:
    """Let begin anew the times after which an upload expires and the trash is emptied, however old the backup is."""
    drive = dict(content.drive)
    if drive["state"] != DriveState.READY:
        drive["touched_at"] = now
    rows = [drive, *(dict(job) for job in content.jobs)]
    for row in rows:
        if row["deleted_at"] is not None:
            row["deleted_at"] = now
    return DriveContent(drive, content.files, rows[1:])


def _refuse_damaged(backup: Storage, rows: Database, drives: Sequence[str]) -> None:
    """Refuse a backup that has no longer what its rows stand for, before anything is restored."""
    faults: list[str] = []
    for drive_id in drives:
        with rows.reading() as session:
            content = read_content(session, drive_id)
        assert content is not None
        faults += find_files(backup, content).faults
    if faults:
        shown = ", ".join(faults[:_SHOWN]) + (f" and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else "")
        raise ConfigError(
            f"the backup {backup.root} is not whole: {shown}. Make it again with `interloc backup`, which brings what "
            "is missing; or --incomplete restores what there is, and `interloc check` says what is to be done about "
            "the rest."
        )


def _check_folder(data_dir: Path, record: BackupRecord) -> bool:
    """Refuse a data folder that holds something; return whether it holds the beginning of this restoration."""
    if not data_dir.exists():
        return False
    if not data_dir.is_dir():
        raise ConfigError(f"{data_dir} is a file; --data-dir (INTERLOC_DATA_DIR) names a new or an empty folder.")
    try:
        begun = BackupRecord.model_validate_json((data_dir / RESTORING).read_bytes())
    except FileNotFoundError:
        refuse_unless_empty(data_dir, "and a backup is restored into an empty data folder only")
        return False
    except (OSError, ValidationError) as error:
        raise InterLocError(
            f"{data_dir / RESTORING} cannot be read; remove the data folder {data_dir}, and restore it anew."
        ) from error
    if begun != record:
        raise ConfigError(
            f"the data folder {data_dir} holds the beginning of another restoration, of the backup of "
            f"{begun.begun_at:%Y-%m-%d %H:%M} UTC. End that one, or remove the data folder (and empty the database)."
        )
    return True


@contextmanager
def _rows_of(backup: Path, record: BackupRecord) -> Iterator[Database]:
    """Open a copy of the rows of a backup, brought up to date where an older version wrote them."""
    with tempfile.TemporaryDirectory() as folder:
        for name in (DATABASE, f"{DATABASE}-wal"):  # a backup that was killed leaves the second one
            with suppress(FileNotFoundError):
                shutil.copyfile(backup / name, Path(folder, name))
        if not Path(folder, DATABASE).is_file():
            raise ConfigError(f"the backup {backup} has no {DATABASE}: there is nothing to be restored.")
        rows = Database(f"sqlite:///{Path(folder, DATABASE).as_posix()}")
        try:
            rows.upgrade()
        except InterLocError as error:
            raise InterLocError(
                f"{backup / DATABASE}, written by InterLoc {record.version}, cannot be read: {error}"
            ) from error
        try:
            yield rows
        finally:
            rows.close()


@contextmanager
def _target(settings: Settings, record: BackupRecord, *, resumed: bool, drives: Sequence[str]) -> Iterator[Database]:
    """Open the database that is to be filled, and mark the data folder as one that is being restored."""
    folder = settings.data_dir
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if not resumed:
        with atomic_write(folder / RESTORING) as file:
            file.write(record.model_dump_json(indent=2).encode())
    database = Database(settings.sqlalchemy_url)

    def refuse(session: Session) -> None:
        _refuse_unless_empty(session, database, resumed=resumed, drives=drives)

    try:
        try:
            database.upgrade(refuse)
        except ConfigError:
            if not resumed:
                (folder / RESTORING).unlink()
            raise
        yield database
    finally:
        database.close()


def _refuse_unless_empty(session: Session, database: Database, *, resumed: bool, drives: Sequence[str]) -> None:
    """Refuse a database that holds something else than what this restoration has brought already."""
    counts = {
        name: session.scalar(select(func.count()).select_from(table)) or 0
        for name, table in (("drives", Drive), ("jobs", Job), ("tokens", Token))
    }
    others = set(session.scalars(select(Drive.id))) - set(drives)
    if any(counts.values()) and (others or not resumed):
        found = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        raise ConfigError(
            f"the database {database.url.render_as_string(hide_password=True)} is not empty: it holds {found}. A "
            "backup is restored into an empty one only: set INTERLOC_DATABASE_URL to a new database, or leave it out "
            "for a SQLite file in the data folder."
        )
