"""One id in the database and in the data folder: a service starts only where both are of the same installation.

Each alone looks plausible: an empty database beside a folder full of drives (another address, a lost file), a database
full of drives beside an empty folder (a volume that is not mounted), two services on one folder.
"""

import os
import secrets
from contextlib import suppress
from pathlib import Path

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.store.database import Database
from app.store.models import Drive, Installation, Job, new_id
from interloc.errors import ConfigError
from interloc.files import reason_of, write_file

FILE = "installation"
"""Name of the file in the data folder; its first line is the id."""

_NOTE = "This folder belongs to the InterLoc database that holds the same id. Keep this file."
_CAUSES = (
    "Nothing was changed. Usual causes: INTERLOC_DATA_DIR or INTERLOC_DATABASE_URL was changed or mistyped, the volume "
    "of the data folder is not mounted, or the database was lost. Set it back, or mount it; or bring back a backup "
    "with `interloc admin restore`, into a new data folder."
)


class InstallationError(ConfigError):
    """Database and data folder do not belong together."""


def bind(session: Session, database: Database, folder: Path) -> str:
    """Return the id that a database and a data folder share; it is made where both are new.

    The transaction is the one that brings the database up to date, as servers that start together come one after the
    other; `mark_folder` is to be called when it has ended. An `InstallationError` says that they do not belong
    together; nothing was changed then.
    """
    in_folder, in_database = id_of_folder(folder), id_of_database(session)
    if in_folder is not None and in_folder == in_database:
        return in_folder
    folders = {kind: len(list((folder / kind).glob("*"))) for kind in ("drives", "jobs")}
    drives, jobs = (session.scalar(select(func.count()).select_from(table)) for table in (Drive, Job))
    has_files = session.scalar(select(Drive.id).where(Drive.file_count > 0).limit(1)) is not None
    if in_folder is not None or any(folders.values()) or has_files:  # else both are new, or a first start was cut short
        shown = database.url.render_as_string(hide_password=True)
        raise InstallationError(
            f"the data folder {folder} ({_belongs(in_folder)}, folders of {folders['drives']} drives and "
            f"{folders['jobs']} jobs) and the database {shown} ({_belongs(in_database)}, {drives} drives and {jobs} "
            f"jobs) do not belong together. {_CAUSES}"
        )
    if in_database is None:
        in_database = new_id()
        session.add(Installation(id=in_database, created_at=database.clock(session)))
        session.flush()
    return in_database


def _belongs(id_: str | None) -> str:
    return "no id" if id_ is None else f"id {id_}"


def id_of_database(session: Session) -> str | None:
    """Return the id in the database."""
    return session.scalar(select(Installation.id))


def id_of_folder(folder: Path) -> str | None:
    """Return the id in the data folder; None if there is none."""
    try:
        return (folder / FILE).read_text(errors="replace").split("\n", 1)[0].strip()[:80]
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(f"{folder / FILE} cannot be read: {reason_of(error)}.") from error


def refuse_lost_database(database: Database, folder: Path) -> None:
    """Refuse a data folder whose SQLite database is not there, before a new one is made in its place.

    Its id tells: the database is always made before the id is written.
    """
    in_folder, path = id_of_folder(folder), database.url.database
    if in_folder is not None and database.is_sqlite and path is not None and not Path(path).exists():
        raise InstallationError(
            f"the data folder {folder} has a database ({_belongs(in_folder)}), but there is no {path}. {_CAUSES}"
        )


def mark_folder(folder: Path, installation: str) -> None:
    """Write the id into a data folder that has none, after the transaction of `bind`, unless another was faster."""
    temporary = folder / f".{FILE}-{secrets.token_hex(4)}"
    if id_of_folder(folder) is None:
        write_file(temporary, f"{installation}\n{_NOTE}\n")
        try:
            with suppress(FileExistsError):
                os.link(temporary, folder / FILE)  # unlike a rename, it takes nobody's place
        except OSError:  # a file system without links
            with suppress(FileExistsError), (folder / FILE).open("xb") as file:
                file.write(temporary.read_bytes())
        temporary.unlink(missing_ok=True)
    if (found := id_of_folder(folder)) != installation:
        raise InstallationError(
            f"the data folder {folder} was taken by installation {found} while installation {installation} started. "
            "Usual cause: two services with different databases on one folder. Give each its own INTERLOC_DATA_DIR."
        )
