"""Backups, made while servers run, and their restoration.

A backup is a new folder in the layout of a data folder, with all rows in ``backup.sqlite3``, whatever database the
service uses, and ``backup.json``, which says of what it is a backup; it is written last, once all else is on disk.

The rows come first, as of one moment, then the files that they stand for, as second names (hard links) or copies. No
file of a data folder is ever changed in place: each is written under another name, then renamed, and its row is written
before anybody is told that it is there. So what the rows of that moment stand for was whole on disk at that moment, and
the only way to miss it is that the service has removed or replaced it since: a drive was committed or purged, a file
deleted or sent anew. Such a file is missed, or its size or time is not that of its row. Then rows and files are taken
once more; what is there already stays, so each round is shorter than the one before, and what a service removes is soon
outrun. What two rounds in a row miss is not there in the service itself: the backup names it, and is complete without.
"""

import os
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ValidationError
from sqlalchemy import Connection, func, insert, inspect, select, update
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.settings import Settings
from app.states import DriveState, JobState
from app.store.database import Database
from app.store.installation import id_of_database, mark_folder
from app.store.models import Base, Drive, Job
from app.upkeep.check import Wanted, wanted_files
from interloc.errors import ConfigError, InterLocError, OutputError
from interloc.files import reason_of, write_file
from interloc.results import versions
from interloc.wording import listed

DATABASE = "backup.sqlite3"
RECORD = "backup.json"

_ROUNDS = 10
_ROWS_AT_ONCE = 1000
_SHOWN = 3

Advance = Callable[[int, int, str], None]
"""Called with how many files are done, of how many, and the name of what is at hand."""


class BackupRecord(BaseModel):
    """What ``backup.json`` holds."""

    format: Literal[1] = 1
    installation: str
    """Id of the service that it is a backup of."""
    version: str
    """Of InterLoc."""
    begun_at: datetime
    ended_at: datetime | None = None
    complete: bool = True
    """False: a version before was stopped while it made it."""
    drives: int = 0
    jobs: int = 0
    files: int = 0
    size_bytes: int = 0
    missing: list[str] = []
    """Files that rows stand for, and that were missing in the service already."""

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read the record of a backup; None where there is none, an `InterLocError` where it cannot be understood."""
        try:
            return cls.model_validate_json((folder / RECORD).read_bytes())
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValidationError) as error:
            raise InterLocError(
                f"{folder / RECORD} cannot be read as the record of a backup; it was damaged, or written by a newer "
                "version of InterLoc."
            ) from error


def back_up(context: Context, out: Path, advance: Advance) -> BackupRecord:
    """Make a backup in a new or empty folder, while servers may run; return its record.

    A `ConfigError` refuses another folder, or one that lies where it cannot be a backup of this data folder.
    """
    root, out = context.storage.root, Path(os.path.realpath(out))
    if out.is_relative_to(root):
        raise ConfigError(f"{out} lies in the data folder {root}; a backup belongs elsewhere.")
    if root.is_relative_to(out):
        raise ConfigError(f"{out} holds the data folder {root}; a backup needs a folder of its own.")
    _refuse_unless_empty(out, "a backup is made in a new folder")
    with context.database.reading() as session:
        installation = id_of_database(session)
    with _written(out, f"The backup {out} is of no use: remove it."):
        out.mkdir(parents=True, exist_ok=True)
        record = BackupRecord(
            installation=installation, version=str(versions()["interloc"]), begun_at=datetime.now(UTC)
        )
        keys, missed = set[str](), set[str]()
        for number in range(_ROUNDS):
            for path in out.glob(f"{DATABASE}*"):
                path.unlink()
            _dump(context.database, out / DATABASE)
            with _rows_in(out / DATABASE) as rows, rows.reading() as session:
                record.drives, record.jobs = (
                    session.scalar(select(func.count()).select_from(table)) or 0 for table in (Drive, Job)
                )
                wanted = list(wanted_files(session, root, all_of_folders=True))
            before, missed = missed, _bring(root, out, wanted, advance)
            keys.update(each.key for each in wanted)
            if not missed or (number and missed == before):
                break
        else:
            raise InterLocError(
                f"the service changes faster than the backup {out} follows: {listed(sorted(missed), _SHOWN)}. "
                "Make it again when less is going on."
            )
        for key in keys.difference(each.key for each in wanted):  # removed in the service since an earlier round
            (out / key).unlink(missing_ok=True)
        there = [each.key for each in wanted if (out / each.key).is_file()]
        record.missing = sorted(missed.difference(there))
        record.files, record.size_bytes = len(there), sum((out / key).stat().st_size for key in there)
        record.ended_at = datetime.now(UTC)
        os.sync()
        write_file(out / RECORD, record.model_dump_json(indent=2) + "\n")
    return record


def _dump(database: Database, path: Path) -> None:
    """Write all rows as of one moment into a new SQLite file."""
    if database.is_sqlite:
        with closing(sqlite3.connect(str(database.url.database))) as connection:
            connection.execute("VACUUM INTO ?", (str(path),))
    else:
        with _rows_in(path) as rows, database.snapshot() as source, rows.writing() as session:
            copy_rows(source, session.connection())


def restore(settings: Settings, backup: Path, advance: Advance) -> BackupRecord:
    """Restore a backup into a new data folder and a new database, of whatever kind; return its record.

    The settings are those with which the service will run; the backup stays as it is. All is looked at before anything
    is written. Rows come last, in one transaction, then the id of the data folder: no server starts on what a
    restoration has left that was stopped.
    """
    backup, folder = Path(os.path.realpath(backup)), settings.data_dir
    record = BackupRecord.read(backup)
    if record is None or not (backup / DATABASE).is_file():
        lacks = RECORD if record is None else DATABASE
        raise ConfigError(f"{backup} is not a backup: it has no {lacks}. `interloc admin backup` makes backups.")
    if not record.complete:
        raise ConfigError(f"the backup {backup} was not made to its end. Make it again with `interloc admin backup`.")
    _refuse_unless_empty(folder, "a backup is restored into a new data folder only")
    if Path(os.path.realpath(folder)).is_relative_to(backup):
        raise ConfigError(f"{folder} lies in the backup {backup}; a data folder belongs elsewhere.")
    with tempfile.TemporaryDirectory() as temporary, _written(folder, "Nothing was restored."):
        copy = Path(temporary, DATABASE)
        shutil.copyfile(backup / DATABASE, copy)
        with _rows_in(copy, name=f"{backup / DATABASE}, written by InterLoc {record.version}") as rows:
            with rows.reading() as session:
                wanted = list(wanted_files(session, backup, all_of_folders=True))
            wanted = [each for each in wanted if each.key not in record.missing]
            gone = {each.key for each in wanted if not (backup / each.key).is_file()}
            size = sum((backup / each.key).stat().st_size for each in wanted if each.key not in gone)
            is_less = len(wanted) < record.files or size < record.size_bytes
            if gone or (is_less and record.version != "0.2.0"):  # which counted files that are none any more
                has = f"it has {len(wanted):,} of {record.files:,} files, {size:,} of {record.size_bytes:,} bytes"
                lacks = listed(sorted(gone), _SHOWN) if gone else has
                raise ConfigError(f"the backup {backup} is not whole: {lacks}. Make it again, or take another.")
            with closing(Database(settings.sqlalchemy_url)) as database:
                _refuse_unless_new(database)
                with _written(folder, f"What was restored so far is of no use: remove {folder}, and restore again."):
                    _bring(backup, folder, wanted, advance)
                    os.sync()
                    with rows.snapshot() as source:
                        database.upgrade(lambda session: _fill(database, session, source))
                    mark_folder(folder, record.installation)
    return record


def copy_rows(source: Connection, target: Connection) -> None:
    """Copy the rows of all tables but those of the index of features, which a start of the service makes anew."""
    for table in Base.metadata.sorted_tables:
        if table.name.startswith("feature"):
            continue
        columns = [column for column in table.columns if column is not table.autoincrement_column]
        query = select(*columns).order_by(*table.primary_key)
        with source.execution_options(yield_per=_ROWS_AT_ONCE).execute(query) as found:
            for rows in found.mappings().partitions():
                target.execute(insert(table), [dict(row) for row in rows])


def _fill(database: Database, session: Session, source: Connection) -> None:
    """Copy rows into a new database; jobs go back into the queue, and what goes for its age is young again."""
    copy_rows(source, session.connection())
    now = database.clock(session)
    anew = {"done": 0, "total": None, "attempts": 0, "lease_owner": None, "lease_until": None, "started_at": None}
    waiting = {"state": JobState.ACCEPTED, "stage": "waiting", "message": None, "version": Job.version + 1}
    session.execute(update(Job).where(Job.state == JobState.RUNNING).values(**anew, **waiting))
    session.execute(update(Drive).where(Drive.state != DriveState.READY).values(touched_at=now))
    for table in (Drive, Job):
        session.execute(update(table).where(table.deleted_at > 0).values(deleted_at=now))


def _bring(root: Path, out: Path, wanted: Sequence[Wanted], advance: Advance) -> set[str]:
    """Bring files into a folder; return the keys of those that are not there, or are not what their rows say."""
    missed = set()
    for number, each in enumerate(wanted):
        advance(number, len(wanted), "")
        try:
            found = _bring_one(root / each.key, out / each.key)
        except (FileNotFoundError, NotADirectoryError):
            missed.add(each.key)
            continue
        if each.size_bytes not in {None, found.st_size} or each.mtime_ns not in {None, found.st_mtime_ns}:
            missed.add(each.key)
    return missed


def _bring_one(source: Path, target: Path) -> os.stat_result:
    """Give a file a second name, or copy it where that is not possible; one that is there already stays."""
    found = source.stat()
    if target.is_file():
        there = target.stat()
        if (found.st_size, found.st_mtime_ns) == (there.st_size, there.st_mtime_ns):
            return there
        target.unlink()
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except FileNotFoundError:
        raise
    except OSError:  # another file system, or one without links; else the copy finds out what is wrong
        with source.open("rb") as file, target.open("wb") as copy:
            found = os.fstat(file.fileno())
            shutil.copyfileobj(file, copy, 2**20)
        os.utime(target, ns=(found.st_atime_ns, found.st_mtime_ns))
    return target.stat()


def _refuse_unless_empty(folder: Path, remark: str) -> None:
    """Refuse a file, or a folder that holds something; the root of a disk always holds lost+found."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file. Give the name of a new or an empty folder.")
    names = {entry.name for entry in folder.iterdir()} - {"lost+found"} if folder.exists() else set()
    if names:
        raise ConfigError(
            f"{folder} is not empty: it holds {listed(sorted(names), _SHOWN)}; {remark}. It was not touched. Give "
            "the name of a new or an empty folder."
        )


def _refuse_unless_new(database: Database) -> None:
    path = database.url.database
    if database.is_sqlite and path is not None and not Path(path).exists():
        return
    with _written(Path(path or ""), "Nothing was restored."):
        tables = set(inspect(database.engine).get_table_names()) & Base.metadata.tables.keys()
    if tables:
        raise ConfigError(
            f"the database {database.url.render_as_string(hide_password=True)} is not new: it holds the tables "
            f"{listed(sorted(tables), _SHOWN)}. A backup is restored into a new one only: set INTERLOC_DATABASE_URL "
            "to one, or leave it out for a SQLite file in the data folder."
        )


@contextmanager
def _rows_in(path: Path, name: str | None = None) -> Iterator[Database]:
    """Open the rows of a backup, made or brought up to date."""
    with closing(Database(f"sqlite:///{path.as_posix()}")) as rows:
        try:
            rows.upgrade()
        except InterLocError as error:
            raise InterLocError(f"{name or path} cannot be read: {error}") from error
        yield rows


@contextmanager
def _written(place: Path, remark: str) -> Iterator[None]:
    """Say what could not be read or written, and what that means."""
    try:
        yield
    except (SQLAlchemyError, sqlite3.Error) as error:
        reason = " ".join(str(error.orig if isinstance(error, DBAPIError) else error).split())
        raise InterLocError(f"the database could not be read or written: {reason}. {remark}") from error
    except OSError as error:
        raise OutputError(
            f"{error.filename or place} could not be read or written: {reason_of(error)}. {remark}"
        ) from error
