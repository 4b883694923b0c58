"""Drives in the database: making, finding, listing and removing them and their files."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session, defer

from app.context import Context
from app.drives.models import DriveList, DriveModel, FileList, NewDrive, UploadedFile
from app.http import problem_types as kinds
from app.http.parameters import cursor_of, newest_first, rows_after
from app.http.problems import Problem
from app.jobs.folders import label_folders
from app.jobs.queue import key_used, no_drive
from app.jobs.view import chosen_results
from app.paths import check_path
from app.settings import Settings
from app.states import ACTIVE, DriveState, JobKind, JobState
from app.store.database import moment
from app.store.models import IS_MAP, Drive, DriveFile, Job, columns_for
from app.store.storage import Storage, remove_empty
from app.work.task import TRAJECTORY
from interloc.arrays import JsonObject
from interloc.drives.inspect import DriveReport
from interloc.errors import ConfigError, InterLocError
from interloc.osm.untrusted import is_map
from interloc.output.geojson import read_json
from interloc.storage import check_address, is_within

MAX_UPLOADS = 1000
"""Drives of one client that take files."""


def drive_key(drive_id: str) -> str:
    """Return the key of everything that belongs to a drive."""
    return f"drives/{drive_id}"


def files_key(drive_id: str) -> str:
    """Return the key of the files of a drive as uploaded."""
    return f"drives/{drive_id}/files"


def reduced_key(drive_id: str) -> str:
    """Return the key of a committed drive."""
    return f"drives/{drive_id}/reduced"


def create_drive(context: Context, owner: str, new: NewDrive, key: str | None = None) -> tuple[DriveModel, bool]:
    """Make a drive without files, or find the one that this key has made before; return it, and whether it is new."""
    _check_source(context.settings, new.source)
    as_before = {"source"} if new.source is None else None  # keys of older versions stay valid
    request = None if key is None else hashlib.sha256(new.model_dump_json(exclude=as_before).encode()).hexdigest()
    with context.database.writing() as session:
        context.database.lock_owner(session, owner)
        if key is not None:
            earlier = session.scalar(select(Drive).where(Drive.owner == owner, Drive.idempotency_key == key))
            if earlier is not None and earlier.deleted_at is not None:
                earlier.idempotency_key = None  # from the trash it comes back without
                session.flush()
            elif earlier is not None:
                if earlier.request_sha256 != request:
                    raise key_used(key, f"drive {earlier.id}")
                return whole_drive_model(session, context, earlier), False
        of_owner = (Drive.owner == owner, Drive.state == DriveState.UPLOADING, Drive.deleted_at.is_(None))
        if (session.scalar(select(func.count()).where(*of_owner)) or 0) >= MAX_UPLOADS:
            raise Problem(
                kinds.TOO_MANY_UPLOADS,
                f"{MAX_UPLOADS:,} drives of {owner} still take files, and that is the limit. Commit or delete some of "
                "them (GET /api/v1/drives?state=uploading lists them).",
            )
        now = context.database.clock(session)
        drive = Drive(
            name=new.name,
            owner=owner,
            options=new.options.model_dump(mode="json"),
            keep_raw=new.keep_raw,
            source=new.source,
            created_at=now,
            touched_at=now,
            idempotency_key=key,
            request_sha256=request,
        )
        session.add(drive)
        session.flush()
        return drive_model(drive, context.settings), True


def _check_source(settings: Settings, source: str | None) -> None:
    if source is None:
        return
    if not settings.sources:
        raise Problem(
            kinds.SOURCE_REFUSED,
            "source: this service reads from no object storage. Its operator sets INTERLOC_SOURCES.",
        )
    try:
        check_address(source)
    except ConfigError as error:
        raise Problem(kinds.SOURCE_REFUSED, f"source: {error}") from error
    if not is_within(source, settings.sources):
        raise Problem(
            kinds.SOURCE_REFUSED, f"source: {source} lies below none of the prefixes that the operator allows."
        )


def find_drive(session: Session, drive_id: str, *, lock: bool = False) -> Drive:
    """Return a drive, locked until the transaction ends if that is wanted; a 404 where there is none."""
    drive = session.get(Drive, drive_id, with_for_update=lock or None, populate_existing=lock)
    if drive is None or drive.deleted_at is not None:
        raise no_drive(drive_id)
    return drive


def list_drives(
    context: Context, after: str | None, limit: int, conditions: Sequence[ColumnElement[bool]] = ()
) -> DriveList:
    """Return a page of drives that meet conditions, the newest first, without their reports."""
    query = select(Drive).options(defer(Drive.report)).where(Drive.deleted_at.is_(None), *conditions)
    query = query.order_by(*newest_first(Drive))
    if after is not None:
        query = query.where(rows_after(Drive, after))
    with context.database.reading() as session:
        drives = session.scalars(query.limit(limit + 1)).all()
        page = drives[:limit]
        results = _results(session, page)
        columns = (Drive.report["scans"].as_integer(), Drive.report["length_m"].as_float())
        facts = session.execute(select(Drive.id, *columns).where(Drive.id.in_([drive.id for drive in page])))
        known = {drive_id: {"scans": scans, "length_m": length} for drive_id, scans, length in facts}
    there = [drive for drive in page if drive.id in known]  # else it was purged meanwhile
    return DriveList(
        drives=[drive_model(drive, context.settings, known[drive.id], result=results.get(drive.id)) for drive in there],
        next=cursor_of(page[-1]) if len(drives) > limit else None,
    )


def _results(session: Session, drives: Sequence[Drive]) -> dict[str, str]:
    """Return the job that stands for each of these drives, where there is one."""
    found = chosen_results(Drive.id.in_([drive.id for drive in drives])).with_only_columns(Job.drive_id, Job.id)
    return {row.drive_id: row.id for row in session.execute(found)}


def pin_job(session: Session, drive: Drive, job_id: str | None) -> None:
    """Let a job (404, or 409 without a result) stand for its drive; None: the best one does."""
    job = None if job_id is None else session.get(Job, job_id)
    if job_id is not None:
        if job is None or job.drive_id != drive.id or job.deleted_at is not None:
            raise Problem(kinds.JOB_NOT_FOUND, f"Drive {drive.id} has no job {job_id}.")
        if job.state != JobState.SUCCESSFUL or job.kind != JobKind.INTERSECTIONS:
            raise Problem(kinds.RESULT_NOT_READY, f"Job {job_id} is {job.state} and has no intersections to show.")
    drive.pinned_job = job_id


def note_extent(drive: Drive, storage: Storage) -> None:
    """Write into the row of a ready drive where it is, from its trajectory."""
    path = storage.folder(drive_key(drive.id)) / TRAJECTORY[0]
    with suppress(InterLocError, ValueError):  # it has no georeference, or its files are damaged
        drive.west, drive.south, drive.east, drive.north = read_json(path).get("bbox", [])


def list_files(context: Context, drive_id: str, after: str | None, limit: int) -> FileList:
    """Return a page of files in the order of the code points of their paths."""
    path = DriveFile.path if context.database.is_sqlite else DriveFile.path.collate("C")
    query = select(DriveFile).where(DriveFile.drive_id == drive_id).order_by(path)
    if after is not None:
        query = query.where(path > after)
    with context.database.reading() as session:
        find_drive(session, drive_id)
        files = session.scalars(query.limit(limit + 1)).all()
    page = files[:limit]
    shown = [UploadedFile(path=file.path, size_bytes=file.size_bytes, sha256=file.sha256) for file in page]
    return FileList(files=shown, next=page[-1].path if len(files) > limit else None)


def open_file(context: Context, drive_id: str, path: str) -> BinaryIO:
    """Open an uploaded file; a 404 where there is none, a 410 where it is there no more."""
    with context.database.reading() as session:
        drive = find_drive(session, drive_id)
        row = _row_of(session, drive_id, path)
    for key in (files_key, reduced_key):
        with suppress(FileNotFoundError, NotADirectoryError):
            file = (context.storage.folder(key(drive_id)) / path).open("rb")
            if key is files_key or hashlib.file_digest(file, "sha256").hexdigest() == row.sha256:
                file.seek(0)
                return file
            file.close()  # what the commit made of it: it was cut to a part, or read from a source
    if stays_uploaded(drive, path):
        raise Problem(
            kinds.FILE_MISSING,
            f"{path} is listed, but it is no longer on the disk of the service. Send it again if the drive still takes "
            "files; the operator finds what else is missing with `interloc admin check`.",
        )
    raise Problem(
        kinds.FILE_NOT_KEPT,
        f"{path} was reduced to what the method needs when the drive was committed. "
        "Make the drive with keep_raw to keep its scans as they come.",
    )


def _row_of(session: Session, drive_id: str, path: str) -> DriveFile:
    """Return the row of a file, also of one whose name is not taken any more: older versions took more names."""
    can_be = "\0" not in path and not any("\ud800" <= letter <= "\udfff" for letter in path)
    row = session.get(DriveFile, (drive_id, path)) if can_be else None
    if row is None:
        check_path(path)
        raise Problem(
            kinds.FILE_NOT_FOUND, f"The drive has no file {path!r}. GET /api/v1/drives/{drive_id}/files lists them."
        )
    return row


def stays_uploaded(drive: Drive, path: str) -> bool:
    """Return whether an uploaded file stays as it is: a commit reduces the scans of a drive, but never its maps."""
    return drive.state != DriveState.READY or drive.keep_raw or is_map(path)


def find_trajectory(context: Context, drive_id: str) -> Path:
    """Return the trajectory of a drive."""
    with context.database.reading() as session:
        drive = find_drive(session, drive_id)
    if drive.state != DriveState.READY:
        raise Problem(
            kinds.DRIVE_NOT_READY, f"Drive {drive_id} is {drive.state}; it has a trajectory once it is committed."
        )
    folder = context.storage.folder(drive_key(drive_id))
    path = next((path for name in TRAJECTORY if (path := folder / name).is_file()), None)
    if path is None:
        raise Problem(kinds.DRIVE_NOT_WHOLE, f"The trajectory of drive {drive_id} is no longer on disk.")
    return path


def delete_file(context: Context, drive_id: str, path: str) -> None:
    """Remove a file of a drive that is not committed yet, or a map of a ready one."""
    with context.database.writing() as session:
        drive = find_drive(session, drive_id, lock=True)
        if drive.state != DriveState.UPLOADING and not (drive.state == DriveState.READY and is_map(path)):
            raise Problem(
                kinds.DRIVE_IS_CLOSED,
                f"Drive {drive_id} is {drive.state}; files are removed only while it is uploading, and of a ready "
                "drive maps only.",
            )
        row = _row_of(session, drive_id, path)
        refuse_map_in_use(session, drive_id, path)
        drive.file_count -= 1
        drive.size_bytes -= row.size_bytes
        drive.stored_bytes -= row.size_bytes
        drive.touched_at = context.database.clock(session)
        session.delete(row)
    # The file goes after its row, unless another one has taken its name meanwhile: no row is ever without its file.
    with suppress(Problem), context.database.writing() as session:
        find_drive(session, drive_id, lock=True)
        if session.get(DriveFile, (drive_id, path)) is None:
            root = context.storage.folder(files_key(drive_id))
            (root / path).unlink(missing_ok=True)
            remove_empty((root / path).parent, root)


def refuse_map_in_use(session: Session, drive_id: str, path: str, sha256: str = "") -> None:
    """Refuse (409) to delete a map that a job needs, or to put another in its place."""
    active = session.scalars(select(Job).where(Job.drive_id == drive_id, Job.state.in_(ACTIVE)))
    using = next((job for job in active if (job.request.get("osm") or {}).get("file") == path), None)
    if using is not None and (not sha256 or _row_of(session, drive_id, path).sha256 != sha256):
        raise Problem(
            kinds.MAP_IN_USE,
            f"Job {using.id} is {using.state} and needs {path}. Change the map when the job has ended, or cancel the "
            f"job (DELETE /api/v1/jobs/{using.id}).",
        )


def drive_model(
    drive: Drive, settings: Settings, facts: JsonObject | None = None, *, result: str | None = None
) -> DriveModel:
    """Return a drive as clients see it; `facts` of its report in place of it; `result`: the job that stands for it."""
    report = drive.report if facts is None else None
    expires_at = drive.touched_at + 3600 * settings.upload_expires_h
    return DriveModel(
        **columns_for(DriveModel, drive, but=("pinned_job", "report", "scans", "length_m")),
        files=drive.file_count,
        bbox=None if drive.west is None else [drive.west, drive.south, drive.east, drive.north],
        result_job=result,
        pinned_job=drive.pinned_job if drive.pinned_job == result else None,
        expires_at=moment(expires_at) if drive.state == DriveState.UPLOADING else None,
        **(facts or {name: (report or {}).get(name) for name in ("scans", "length_m")}),
        report=DriveReport.model_validate(report) if report else None,
    )


def whole_drive_model(session: Session, context: Context, drive: Drive) -> DriveModel:
    """Return a drive as clients see it, with its report and what jobs can take of it."""
    model = drive_model(drive, context.settings, result=_results(session, [drive]).get(drive.id))
    if drive.state != DriveState.READY:
        return model
    paths = session.scalars(select(DriveFile.path).where(DriveFile.drive_id == drive.id, IS_MAP))
    return model.model_copy(update={"maps": sorted(paths), "label_folders": label_folders(context.storage, drive.id)})
