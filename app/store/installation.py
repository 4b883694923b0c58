"""One id in the database and in the data folder: a service starts only where both are of the same installation.

Each alone looks plausible: an empty database beside a folder full of drives (another address, a lost file), a database
full of drives beside an empty folder (a volume that is not mounted), two services on one folder. A server that went on
would take the drives of others for leftovers. So both hold the same id, and a start is refused where they differ.
"""

from __future__ import annotations

import os
import re
import secrets
from contextlib import suppress
from pathlib import Path

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.store.database import Database
from app.store.models import Drive, Installation, Job, new_id
from interloc.errors import ConfigError
from interloc.files import atomic_write

FILE = "installation"
"""Name of the file in the data folder; its first line is the id."""

_ID = re.compile(r"[0-9a-f]{16}")
_NOTE = "This folder belongs to the InterLoc database that holds the same id. Keep this file."
_WAYS_OUT = (
    "bring a backup back with `interloc restore`; or make rows for what is in the folder with `interloc adopt`, which "
    "also binds the two"
)


class InstallationError(ConfigError):
    """Database and data folder do not belong together."""


def bind(session: Session, database: Database, folder: Path) -> str:
    """Return the id that a database and a data folder share; it is made where both are new.

    Parameters
    ----------
    session
        Of the transaction that brings the database up to date: servers that start together come one after the other.
    folder
        The data folder; `mark_folder` is to be called when the transaction has ended.

    Raises
    ------
    InstallationError
        They do not belong together. Nothing was changed.
    """
    in_folder, in_database = id_of_folder(folder), id_of_database(session)
    if in_folder is None or in_database is None:
        _refuse_strangers(session, database, folder, in_folder, in_database)
        return in_database or make_id(session, database)
    if in_folder != in_database:
        raise InstallationError(
            f"the data folder {folder} belongs to installation {in_folder} ({_contents(folder)}), the database "
            f"{_shown(database)} to installation {in_database} ({_rows(session)}). Nothing was changed. Usual causes: "
            "INTERLOC_DATA_DIR or INTERLOC_DATABASE_URL is that of another service, or one of them was changed. Set it "
            f"back; or {_WAYS_OUT}."
        )
    return in_database


def id_of_database(session: Session) -> str | None:
    """Return the id in the database."""
    return session.scalar(select(Installation.id))


def make_id(session: Session, database: Database) -> str:
    """Give the database an id."""
    made = Installation(id=new_id(), created_at=database.clock(session))
    session.add(made)
    session.flush()
    return made.id


def id_of_folder(folder: Path) -> str | None:
    """Return the id in the data folder; None if there is none.

    Raises
    ------
    InstallationError
        The file holds something else.
    """
    try:
        text = (folder / FILE).read_text(errors="replace")
    except FileNotFoundError:
        return None
    found = text.split("\n", 1)[0].strip()
    if not _ID.fullmatch(found):
        raise InstallationError(
            f"{folder / FILE}: its first line is {found[:80]!r}, expected the id of the installation, 16 hexadecimal "
            "digits. Nothing was changed. Usual cause: the file was edited or cut off. Bring it back from a backup, or "
            "remove it: `interloc adopt` then writes it anew."
        )
    return found


def refuse_lost_database(database: Database, folder: Path) -> None:
    """Refuse a data folder whose SQLite database is not there, before a new one is made in its place.

    Raises
    ------
    InstallationError
        The folder has an id. The database is always made before the id is written.
    """
    in_folder, path = id_of_folder(folder), database.url.database
    if in_folder is not None and database.is_sqlite and path is not None and not Path(path).exists():
        raise InstallationError(
            f"the data folder {folder} belongs to installation {in_folder} ({_contents(folder)}), but there is no "
            f"database {path}. Nothing was changed. Usual causes: INTERLOC_DATABASE_URL was changed or mistyped, or "
            f"the database was lost. Set it back; or {_WAYS_OUT}."
        )


def mark_folder(folder: Path, installation: str) -> None:
    """Write the id into a data folder that has none yet; after the transaction of `bind`.

    Raises
    ------
    InstallationError
        Another service was faster.
    """
    temporary = folder / f".{FILE}-{secrets.token_hex(4)}"
    if id_of_folder(folder) is None:
        try:
            with atomic_write(temporary) as file:
                file.write(_text(installation))
            with suppress(FileExistsError):
                _link(temporary, folder / FILE)  # unlike a rename, it takes nobody's place
        finally:
            temporary.unlink(missing_ok=True)
    if (found := id_of_folder(folder)) != installation:
        raise InstallationError(
            f"the data folder {folder} was taken by installation {found} while installation {installation} started. "
            "Usual cause: two services with different databases on one folder. Give each its own INTERLOC_DATA_DIR."
        )


def remark_folder(folder: Path, installation: str) -> None:
    """Write the id into a data folder, in place of another one."""
    with atomic_write(folder / FILE) as file:
        file.write(_text(installation))


def _text(installation: str) -> bytes:
    return f"{installation}\n{_NOTE}\n".encode()


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        with target.open("xb") as file:
            file.write(source.read_bytes())


def _refuse_strangers(
    session: Session, database: Database, folder: Path, in_folder: str | None, in_database: str | None
) -> None:
    """Refuse a folder and a database of which one has no id, unless they are new or visibly belong together."""
    held = _folders(folder)
    if in_folder is None:
        # Both are new, or their first start was cut short; or, of a version without ids, they know each other.
        fits = in_database is None and _knows_any(session, held) if held else not _has_files(session)
        if fits:
            return
    if in_folder is not None or (in_database is None and held):
        of = f"belongs to installation {in_folder}" if in_folder is not None else "comes from a version without ids"
        raise InstallationError(
            f"the data folder {folder} {of} ({_contents(folder)}), but the database {_shown(database)} has no id and "
            f"knows nothing of it ({_rows(session)}). Nothing was changed. Usual causes: INTERLOC_DATABASE_URL was "
            f"changed or mistyped, or the database was lost. Set it back; or {_WAYS_OUT}."
        )
    of = f"belongs to installation {in_database}" if in_database is not None else "comes from a version without ids"
    raise InstallationError(
        f"the database {_shown(database)} {of} ({_rows(session)}), but the data folder {folder} has no id "
        f"({_contents(folder)}). Nothing was changed. Usual causes: the volume of the data folder is not mounted, or "
        f"INTERLOC_DATA_DIR was changed or mistyped. Mount it or set it back; or {_WAYS_OUT}."
    )


def _folders(folder: Path) -> list[str]:
    """Return the ids of the drives and jobs that have a folder."""
    return [name for kind in ("drives", "jobs") for name in _names(folder / kind)]


def _names(folder: Path) -> list[str]:
    try:
        return [entry.name for entry in os.scandir(folder) if entry.is_dir(follow_symlinks=False)]
    except FileNotFoundError:
        return []


def _knows_any(session: Session, ids: list[str]) -> bool:
    known = {*session.scalars(select(Drive.id)), *session.scalars(select(Job.id))}
    return not known.isdisjoint(ids)


def _has_files(session: Session) -> bool:
    return session.scalar(select(Drive.id).where(Drive.file_count > 0).limit(1)) is not None


def _contents(folder: Path) -> str:
    return f"folders of {len(_names(folder / 'drives'))} drives and {len(_names(folder / 'jobs'))} jobs"


def _rows(session: Session) -> str:
    drives, jobs = (session.scalar(select(func.count()).select_from(table)) for table in (Drive, Job))
    return f"{drives} drives and {jobs} jobs"


def _shown(database: Database) -> str:
    return database.url.render_as_string(hide_password=True)
