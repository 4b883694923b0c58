"""Rows against files: what the rows of a database stand for, and what is missing on either side.

Looked at are names and sizes: what a disk does to the bytes a file system or a backup program finds out.
"""

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from stat import S_ISREG
from typing import Literal, NamedTuple

from sqlalchemy import or_, select
from sqlalchemy.orm import Session, defer

from app.context import Context
from app.drives.records import files_key, reduced_key, stays_uploaded
from app.drives.work.unpack import ARCHIVE
from app.states import ACTIVE, DriveState, JobKind, JobState
from app.store.models import CityMap, Drive, DriveFile, Job
from app.store.storage import files_below
from app.upkeep.cleanup import unknown_folders
from app.work.task import TRAJECTORY
from interloc.drives.scans.reduced_format import MANIFEST, ground_path, read_manifest
from interloc.errors import InterLocError
from interloc.files import reason_of
from interloc.output.layout import RUN_FILE, TABLES, file_names

_AGAIN_S = 1.0  # between two looks: far more than an upload needs from the name of a file to its row


class Wanted(NamedTuple):
    """A file that rows stand for, by its path in the data folder."""

    key: str
    size_bytes: int | None = None
    mtime_ns: int | None = None
    """What its row says; None where no row says it."""


@dataclass(frozen=True)
class Discrepancy:
    """Something that is missing, of the rows or of the files."""

    kind: Literal["file-missing", "file-differs", "file-unlisted", "folder-unknown"]
    place: str
    """Where it is, as a path in the data folder."""
    message: str
    """What was found, what was expected, what to do."""


def check(context: Context) -> list[Discrepancy]:
    """Compare rows and files, while servers are at work: what two looks find counts. Nothing is changed."""
    found = list(_look(context))
    if found:
        time.sleep(_AGAIN_S)
        again = set(_look(context))
        found = [each for each in found if each in again]
    return found


def _look(context: Context) -> Iterator[Discrepancy]:
    root = context.storage.root
    with context.database.reading() as session:
        for each in wanted_files(session, root):
            try:
                there = (root / each.key).stat()
            except OSError as error:
                message = f"a row says that it is there: {reason_of(error)}. Bring it back from a backup."
                yield Discrepancy("file-missing", each.key, message)
                continue
            is_whole = there.st_size == each.size_bytes if each.size_bytes is not None else there.st_size > 0
            if not is_whole or not S_ISREG(there.st_mode):
                message = "its size is not that of its row, or none. Send it again, or bring it back from a backup."
                yield Discrepancy("file-differs", each.key, message)
        unpacking = select(Job.drive_id).where(
            Job.kind.in_([JobKind.UNPACK, JobKind.DEMO]), Job.state.in_(ACTIVE)
        )  # these are just placing files
        for drive_id in session.scalars(select(Drive.id).where(Drive.id.not_in(unpacking))).all():
            yield from _unlisted(session, root, drive_id)
    for key, holds in unknown_folders(context):
        if holds:
            message = "no row knows this folder. Restore the database that does; or remove it where nobody needs it."
            yield Discrepancy("folder-unknown", key, message)


def _unlisted(session: Session, root: Path, drive_id: str) -> Iterator[Discrepancy]:
    """Find files of a drive that no row lists."""
    found = set(files_below(root / files_key(drive_id)))
    listed = session.scalars(select(DriveFile.path).where(DriveFile.drive_id == drive_id)).all() if found else ()
    for path in sorted(found.difference(listed)):
        message = "no row lists it: an upload was cut off. The commit of its drive removes it."
        yield Discrepancy("file-unlisted", f"{files_key(drive_id)}/{path}", message)


def wanted_files(session: Session, root: Path, *, all_of_folders: bool = False) -> Iterator[Wanted]:
    """Yield the files that the rows of a database stand for, below a data folder or a backup, which has its layout.

    With `all_of_folders`, also what reduced drives and results hold beyond what they must hold.
    """
    is_kept = or_(Drive.deleted_at.is_(None), Drive.deleted_at > 0)  # otherwise it is being purged
    for drive in session.scalars(select(Drive).where(is_kept).options(defer(Drive.report))).all():
        files = select(DriveFile.path, DriveFile.size_bytes, DriveFile.mtime_ns)
        for path, size, mtime_ns in session.execute(files.where(DriveFile.drive_id == drive.id)):
            if stays_uploaded(drive, path):
                yield Wanted(f"{files_key(drive.id)}/{path}", size, mtime_ns)
        if drive.state == DriveState.READY:
            yield from _wanted_reduced(root, drive.id, all_of_folders=all_of_folders)
    of_kept = select(Job).join(Drive, Drive.id == Job.drive_id).where(is_kept)
    for job in session.scalars(of_kept.where(Job.kind == JobKind.UNPACK, Job.state.in_(ACTIVE))):
        older = job.request.get("archive")
        yield Wanted(f"drives/{job.drive_id}/{older}" if older else f"jobs/{job.id}/scratch/{ARCHIVE}")
    has_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL)
    is_there = or_(Job.deleted_at.is_(None), Job.deleted_at > 0)
    results = of_kept.where(*has_result, is_there).with_only_columns(Job.id, Job.summary)
    for job_id, summary in session.execute(results).all():
        is_placed = (summary or {}).get("georeferenced")
        names = [] if is_placed is None else [file_names(georeferenced=is_placed)[table] for table in TABLES]
        names += [RUN_FILE, "report.json"] if (summary or {}).get("report") else [RUN_FILE]
        yield from _wanted_folder(root, f"jobs/{job_id}/result", names, all_of_folders=all_of_folders)
    for map_id, name, osm_bytes in session.execute(select(CityMap.id, CityMap.osm, CityMap.osm_bytes)):
        if name is not None:
            yield Wanted(f"maps/{map_id}/osm/{name}", osm_bytes)
        for part in ("city", "audit"):
            yield from _wanted_folder(root, f"maps/{map_id}/{part}", [], all_of_folders=all_of_folders)


def _wanted_reduced(root: Path, drive_id: str, *, all_of_folders: bool) -> Iterator[Wanted]:
    folder = root / reduced_key(drive_id)
    names = [MANIFEST]
    with suppress(InterLocError):  # it is not there, or not readable: then nothing else of the drive is, either
        manifest = read_manifest(folder)
        oxts = manifest.files.oxts or MANIFEST
        is_folder = (folder / oxts).is_dir()  # which stands for its files
        names += [name for name in manifest.files.paths if not (is_folder and name == oxts)]
        names += [
            ground_path(labels.folder, int(frame)) for labels in manifest.labels for frame in manifest.kept_frames
        ]
    yield from _wanted_folder(root, reduced_key(drive_id), names, all_of_folders=all_of_folders)
    there = [name for name in TRAJECTORY if (folder.parent / name).is_file()]
    yield Wanted(f"drives/{drive_id}/{(there or TRAJECTORY)[0]}")


def _wanted_folder(root: Path, folder: str, names: list[str], *, all_of_folders: bool) -> Iterator[Wanted]:
    wanted = set(names)
    if all_of_folders:
        wanted.update(files_below(root / folder))
    for name in sorted(wanted):
        yield Wanted(f"{folder}/{name}")
