"""The last step of an upload: files that came in take their names, all or none, together with their rows."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sqlalchemy import insert, select, update
from sqlalchemy.orm import Session

from app.drives.intake import INCOMING, Arrival
from app.drives.limits import check_drive, check_free_space
from app.drives.names import is_map
from app.drives.records import files_key, find_drive, lock_drive
from app.models import Drive, DriveFile
from app.problems import Problem
from app.service import Service

_AT_ONCE = 500  # paths in one query


def keep(service: Service, drive_id: str, arrivals: Sequence[Arrival]) -> bool:
    """Give files their places in a drive.

    Parameters
    ----------
    service
    drive_id
    arrivals
        Files of different names.

    Returns
    -------
    bool
        True where all of them are new, False where one replaced another.

    Raises
    ------
    Problem
        404: there is no such drive (any more). 409: it takes no files now, or a name is that of a folder. 413: it
        would become too large. Nothing has changed then.
    """
    with Placement(service, drive_id) as placement, service.database.writing() as session:
        drive = lock_drive(session, drive_id)
        refuse_unless_open(drive, [arrival.path for arrival in arrivals])
        known = sizes_of(session, drive_id, [arrival.path for arrival in arrivals])
        register(service, session, drive, arrivals, known)
        placement.move(arrivals)
    return not known


def refuse_unless_open(drive: Drive, paths: Iterable[str]) -> None:
    """Refuse files that a drive does not take in its state.

    Raises
    ------
    Problem
        409.
    """
    if drive.state == "checking":
        raise Problem(
            409,
            "Drive is being checked",
            f"Drive {drive.id} is being checked after its commit and takes no files meanwhile. "
            "Try again when its state is uploading or ready.",
            headers={"Retry-After": "5"},
        )
    if drive.state == "ready" and not all(is_map(path) for path in paths):
        raise Problem(
            409,
            "Drive is closed",
            f"Drive {drive.id} was committed; it takes maps only (.osm, .osm.gz, .osm.bz2, .osm.pbf). "
            "Make a new drive for other files.",
        )


def check_upload(service: Service, drive_id: str, path: str, length: int) -> None:
    """Refuse before a long body is read what would be refused after it.

    Raises
    ------
    Problem
        404, 409, 413, 507: as of `keep`.
    """
    with service.database.reading() as session:
        drive = find_drive(session, drive_id)
    refuse_unless_open(drive, [path])
    check_drive(service, drive.file_count, drive.size_bytes + length)
    check_free_space(service, length)


def sizes_of(session: Session, drive_id: str, paths: Sequence[str]) -> dict[str, int]:
    """Return the sizes of those files that are there already."""
    known: dict[str, int] = {}
    for start in range(0, len(paths), _AT_ONCE):
        rows = session.execute(
            select(DriveFile.path, DriveFile.size_bytes).where(
                DriveFile.drive_id == drive_id, DriveFile.path.in_(paths[start : start + _AT_ONCE])
            )
        )
        known.update((path, size) for path, size in rows)
    return known


def register(
    service: Service, session: Session, drive: Drive, arrivals: Sequence[Arrival], known: dict[str, int]
) -> None:
    """List files in the database, and count them.

    Raises
    ------
    Problem
        413: the drive would become too large.
    """
    more = sum(arrival.size_bytes for arrival in arrivals) - sum(known.values())
    check_drive(service, drive.file_count + len(arrivals) - len(known), drive.size_bytes + more)
    rows: list[dict[str, Any]] = [
        {"drive_id": drive.id, "path": each.path, "size_bytes": each.size_bytes, "sha256": each.sha256}
        for each in arrivals
    ]
    if fresh := [row for row in rows if row["path"] not in known]:
        session.execute(insert(DriveFile), fresh)
    if changed := [row for row in rows if row["path"] in known]:
        session.execute(update(DriveFile), changed)
    drive.file_count += len(fresh)
    drive.size_bytes += more
    drive.stored_bytes += more
    drive.touched_at = service.database.clock(session)


class Placement:
    """Moves files to their places; a block that fails, its transaction included, gets the old ones back."""

    def __init__(self, service: Service, drive_id: str) -> None:
        self._incoming = service.storage.folder(INCOMING)
        self._files = service.storage.folder(files_key(drive_id))
        self._moved: list[tuple[Path, Path | None]] = []

    def __enter__(self) -> Self:
        return self

    def move(self, arrivals: Iterable[Arrival]) -> None:
        """Rename files from their temporary names.

        Raises
        ------
        Problem
            409: a file has the name of a folder, or the other way round.
        """
        for arrival in arrivals:
            target = self._files / arrival.path
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                old = None if target.is_dir() else self._save(target)
                self._moved.append((target, old))
                arrival.temporary.replace(target)  # fails where a folder has the name
            except (NotADirectoryError, FileExistsError, IsADirectoryError):
                raise Problem(
                    409,
                    "Names in conflict",
                    f"{arrival.path}: the drive has a folder of this name, or a file that has the name of one of its "
                    "folders. Nothing of this request was kept; DELETE what is in the way first.",
                ) from None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for target, old in reversed(self._moved):
            with suppress(OSError):
                if kind is None:
                    if old is not None:
                        old.unlink()
                elif old is not None:
                    old.replace(target)
                else:
                    target.unlink(missing_ok=True)

    def _save(self, target: Path) -> Path | None:
        """Keep the file that is about to be replaced; readers find it under its name all the while."""
        old = self._incoming / secrets.token_hex(12)
        try:
            os.link(target, old)
        except FileNotFoundError:
            return None
        except OSError:  # a file system without links
            target.replace(old)
        return old
