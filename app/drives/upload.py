"""The last step of an upload: received files get their names and their rows in the database, all or none."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from sqlalchemy import Table, bindparam, delete, func, insert, select, update
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.models import UnpackedArchive
from app.drives.records import files_key, find_drive, refuse_map_in_use
from app.drives.work.unpack import ARCHIVE, MAGIC_BYTES, archive_kind
from app.http.intake import Arrival, Placement, check_drive, check_quota, job_limit
from app.http.problem_types import DRIVE_IS_BEING_CHECKED, DRIVE_IS_CLOSED, NOT_AN_ARCHIVE
from app.http.problems import Problem
from app.jobs.failures import raise_failure
from app.jobs.queue import no_drive, submit
from app.states import DriveState, JobKind
from app.store.models import Drive, DriveFile, Job
from app.work.requests import FilesOutcome
from interloc.arrays import JsonObject
from interloc.osm.untrusted import is_map

_AT_ONCE = 500  # paths in one query

_drives, _files = (cast("Table", table.__table__) for table in (Drive, DriveFile))
_COUNTS = (
    select(_drives.c.id, _drives.c.owner, _drives.c.state, _drives.c.file_count, _drives.c.size_bytes, _drives.c.source)
    .where(_drives.c.deleted_at.is_(None))
    .with_for_update()
)
_SIZES = select(_files.c.path, _files.c.size_bytes)
_REPLACE = delete(_files).where(_files.c.drive_id == bindparam("of"), _files.c.path == bindparam("at"))
_INSERT = insert(_files)
_COUNT = (
    update(_drives)
    .where(_drives.c.id == bindparam("of"))
    .values(
        file_count=_drives.c.file_count + bindparam("fresh"),
        size_bytes=_drives.c.size_bytes + bindparam("more"),
        stored_bytes=_drives.c.stored_bytes + bindparam("more"),
        touched_at=bindparam("now"),
    )
)


@dataclass(frozen=True)
class DriveCounts:
    """The columns of a drive that an upload needs; read without the ORM because this runs once per file."""

    id: str
    owner: str
    state: str
    file_count: int
    size_bytes: int
    source: str | None


def keep(context: Context, drive_id: str, arrivals: Sequence[Arrival], sender: str | None = None) -> bool:
    """Place received files of different names in a drive; return False if one replaced another.

    The sender is the owner of the drive where none is named. A problem (404; 409 it takes no files now, or a name is
    that of a folder or too similar to another one; 413 it would become too large) changes nothing.
    """
    with Placement(context.storage, files_key(drive_id)) as placement, context.database.writing() as session:
        counts = lock_counts(session, drive_id)
        refuse_unless_open(counts, [arrival.path for arrival in arrivals])
        for each in arrivals if counts.state == DriveState.READY else ():
            refuse_map_in_use(session, drive_id, each.path, each.sha256)
        return place(context, session, placement, counts, arrivals, sender or counts.owner)


def place(
    context: Context,
    session: Session,
    placement: Placement,
    drive: DriveCounts,
    arrivals: Sequence[Arrival],
    sender: str,
) -> bool:
    """Place files in a drive that the transaction has locked; return False if one replaced another."""
    paths = [arrival.path for arrival in arrivals]
    known: dict[str, int] = {}  # sizes of those files that exist already
    for start in range(0, len(paths), _AT_ONCE):
        found = session.execute(
            _SIZES.where(_files.c.drive_id == drive.id, _files.c.path.in_(paths[start : start + _AT_ONCE]))
        )
        known.update((path, size) for path, size in found)
    more = sum(arrival.size_bytes for arrival in arrivals) - sum(known.values())
    fresh = len(arrivals) - len(known)
    check_drive(context, drive.file_count + fresh, drive.size_bytes + more)
    check_quota(context, session, drive.owner, sender, more)
    rows: list[JsonObject] = [
        {
            "drive_id": drive.id,
            "path": each.path,
            "size_bytes": each.size_bytes,
            "sha256": each.sha256,
            "mtime_ns": each.temporary.stat().st_mtime_ns,  # stays the same when it is renamed
        }
        for each in arrivals
    ]
    connection = session.connection()
    if known:
        replaced = [{"of": row["drive_id"], "at": row["path"]} for row in rows if row["path"] in known]
        connection.execute(_REPLACE, replaced)
    connection.execute(_INSERT, rows)
    connection.execute(_COUNT, {"of": drive.id, "fresh": fresh, "more": more, "now": context.database.clock(session)})
    placement.move(arrivals)
    return not known


def lock_counts(session: Session, drive_id: str) -> DriveCounts:
    """Return the counts of a drive (404 where there is none) and lock it until the transaction ends."""
    row = session.execute(_COUNTS.where(_drives.c.id == drive_id)).one_or_none()
    if row is None:
        raise no_drive(drive_id)
    return DriveCounts(*row)


def refuse_unless_open(drive: Drive | DriveCounts, paths: Iterable[str]) -> None:
    """Refuse (409) files that a drive does not take in its state."""
    if drive.state == DriveState.CHECKING:
        raise Problem(
            DRIVE_IS_BEING_CHECKED,
            f"Drive {drive.id} is being checked after its commit and takes no files meanwhile. "
            "Try again when its state is uploading or ready.",
            headers={"Retry-After": "5"},
        )
    if (drive.state == DriveState.READY or drive.source is not None) and not all(is_map(path) for path in paths):
        raise Problem(
            DRIVE_IS_CLOSED,
            f"Drive {drive.id} was committed, or has a source; it takes maps only (.osm, .osm.gz, .osm.bz2, .osm.pbf). "
            "Make a new drive for other files.",
        )


def check_upload(
    context: Context, drive_id: str, paths: Sequence[str], length: int, sender: str, *, is_packed: bool = False
) -> None:
    """Refuse an upload before its body is read, if `keep` would refuse it afterwards; `paths`: those that are known."""
    with context.database.reading() as session:
        drive = find_drive(session, drive_id)
        refuse_unless_open(drive, paths)
        if paths:  # else `keep` tells: which files of a request with several are replaced is not known yet
            of_paths = (DriveFile.drive_id == drive_id, DriveFile.path.in_(paths))
            more = length - int(session.scalar(select(func.sum(DriveFile.size_bytes)).where(*of_paths)) or 0)
            check_drive(context, drive.file_count, drive.size_bytes + (0 if is_packed else more))
            check_quota(context, session, drive.owner, sender, more)


def check_magic(head: bytes) -> None:
    """Refuse (415) a file that is not an archive by its first bytes."""
    if archive_kind(head[:MAGIC_BYTES]) is None:
        raise Problem(
            NOT_AN_ARCHIVE,
            "By its first bytes this is neither .zip nor .tar, .tar.gz or .tar.zst. Usual causes: a file that was "
            "renamed or not downloaded whole; over HTTP, a form in place of the archive itself.",
        )


def queue_archive(context: Context, drive_id: str, owner: str, arrival: Arrival) -> Job:
    """Queue the job that unpacks an archive, and store that with it."""
    place: Path | None = None
    try:
        with context.database.writing() as session:
            drive = find_drive(session, drive_id, lock=True)
            refuse_unless_open(drive, ["archive"])
            check_quota(context, session, drive.owner, owner, arrival.size_bytes)
            job, _ = submit(
                session,
                context.database,
                kind=JobKind.UNPACK,
                drive_id=drive_id,
                owner=owner,
                request={},
                limit=job_limit(context, owner),
            )
            drive.touched_at = job.created_at
            place = context.storage.folder(f"jobs/{job.id}/scratch/{ARCHIVE}")
            place.parent.mkdir(parents=True, exist_ok=True)
            arrival.temporary.replace(place)
    except BaseException:
        if place is not None:
            place.unlink(missing_ok=True)
        raise
    context.jobs_changed.set()
    return job


def unpacked(job: Job) -> UnpackedArchive:
    """Return the outcome of the unpacking, or that it goes on."""
    raise_failure(job)
    if job.summary is None:
        return UnpackedArchive(job_id=job.id, state=job.state)
    outcome = FilesOutcome.model_validate(job.summary)
    return UnpackedArchive(job_id=job.id, state=job.state, files=outcome.files, size_bytes=outcome.size_bytes)
