"""The commit of a drive: its begin, its outcome for the client, and what the end of a job means for its drive."""

import logging
import os
import secrets
from contextlib import suppress
from pathlib import Path

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.models import CommitRequest, DriveModel, DriveOptionsModel
from app.drives.records import files_key, find_drive, note_extent, reduced_key, whole_drive_model
from app.drives.upload import lock_counts, place, refuse_unless_open
from app.http.intake import Arrival, Placement, check_free_space, check_quota, job_limit
from app.http.problem_types import ARCHIVE_IS_BEING_UNPACKED, DRIVE_IS_BEING_CHECKED, DRIVE_IS_CLOSED, DRIVE_NOT_USABLE
from app.http.problems import Problem
from app.jobs.failures import raise_failure
from app.jobs.queue import active_job, submit
from app.jobs.webhooks import check_subscriber
from app.networks import work as models
from app.states import DriveState, JobKind, JobState
from app.store.database import Database, afterwards
from app.store.models import IS_MAP, Drive, DriveFile, Job
from app.store.storage import files_below, remove_empty, size_of
from app.work.requests import CommitOutcome, Outcome, StoredRequest
from app.work.task import REDUCED, TRAJECTORY, UNPACKED, link, read_listing
from interloc.arrays import JsonObject
from interloc.drives.inspect import DriveReport
from interloc.osm.untrusted import is_map

_log = logging.getLogger(__name__)


def begin_commit(context: Context, drive_id: str, owner: str, request: CommitRequest) -> Job | None:
    """Queue the check of a drive; return the running one if there is one, None if the drive is ready."""
    check_free_space(context, 0)
    root = context.storage.folder(files_key(drive_id))
    found = set(files_below(root))
    webhook = check_subscriber(context.settings, request.subscriber)
    with context.database.writing() as session:
        drive = find_drive(session, drive_id, lock=True)
        if drive.state == DriveState.READY:
            _refuse_others(drive, None, request)
            return None
        if (
            drive.state == DriveState.CHECKING
            and (running := active_job(session, drive_id, JobKind.COMMIT)) is not None
        ):
            if running.cancel_requested:
                refuse_unless_open(drive, [])
            _refuse_others(drive, running, request)
            return running
        if (unpacking := active_job(session, drive_id, JobKind.UNPACK)) is not None:
            raise Problem(
                ARCHIVE_IS_BEING_UNPACKED,
                f"Job {unpacking.id} still unpacks an archive of the drive. Commit it when "
                f"GET /api/v1/jobs/{unpacking.id} shows that it has ended.",
                headers={"Retry-After": "5"},
            )
        _compare_files(session, drive, root, found)
        if request.options is not None:
            drive.options = {**_options_of(drive), **_given(request)}
            if (model := drive.options.get("model")) is not None:
                models.find(context.settings.models, model)
        if request.keep_raw is not None:
            drive.keep_raw = request.keep_raw and drive.source is None
        limit = job_limit(context, owner)
        job = queue_commit(session, context.database, drive, owner, limit=limit, webhook=webhook)
    context.jobs_changed.set()
    return job


def _compare_files(session: Session, drive: Drive, root: Path, found: set[str]) -> None:
    """Remove files that no row lists, of uploads that were cut off; refuse (422) a drive that lacks files it lists."""
    listed = set(session.scalars(select(DriveFile.path).where(DriveFile.drive_id == drive.id)))
    for path in found - listed:
        (root / path).unlink(missing_ok=True)
        remove_empty((root / path).parent, root)
    gone = sorted(path for path in listed - found if not (root / path).is_file())  # some have come meanwhile
    if gone:
        more = f" and {len(gone) - 1:,} more" if len(gone) > 1 else ""
        raise Problem(
            DRIVE_NOT_USABLE,
            f"{gone[0]}{more}: listed, but no longer on the disk of the service. Send what is missing again (PUT), or "
            "DELETE it; the operator finds all of it with `interloc admin check`.",
        )


def _options_of(drive: Drive) -> JsonObject:
    return DriveOptionsModel.model_validate(drive.options).model_dump(mode="json")


def _given(request: CommitRequest) -> JsonObject:
    return {} if request.options is None else request.options.model_dump(mode="json", exclude_unset=True)


def _refuse_others(drive: Drive, running: Job | None, request: CommitRequest) -> None:
    """Refuse options that are not those of the commit, done or running: whoever sends them expects that they count."""
    in_force, given = {**_options_of(drive), "keep_raw": drive.keep_raw}, _given(request)
    if request.keep_raw is not None:
        given["keep_raw"] = request.keep_raw
    if running is not None and request.subscriber is not None:
        in_force["subscriber"] = running.request.get("subscriber")
        given["subscriber"] = request.subscriber.model_dump(exclude_none=True)
    differing = [name for name, value in given.items() if in_force[name] != value]
    others = "; ".join(f"{name} is {in_force[name]!r}, not {given[name]!r}" for name in differing)
    if others and running is None:
        raise Problem(
            DRIVE_IS_CLOSED,
            f"Drive {drive.id} was committed with other options: {others}. Make a new drive to read its files in "
            "another way.",
        )
    if others and running is not None:
        raise Problem(
            DRIVE_IS_BEING_CHECKED,
            f"Drive {drive.id} is being checked with other options: {others}. Send this again when "
            f"GET /api/v1/jobs/{running.id} shows that the check has ended, or cancel it (DELETE).",
            headers={"Retry-After": "5"},
        )


def queue_commit(
    session: Session,
    database: Database,
    drive: Drive,
    owner: str,
    *,
    limit: int | None = None,
    webhook: StoredRequest | None = None,
) -> Job:
    """Queue the check of a drive, in a transaction that has locked it."""
    work: StoredRequest = {"options": drive.options}
    if drive.source is not None:
        work["source"] = drive.source
    work |= webhook or {}
    job, _ = submit(session, database, kind=JobKind.COMMIT, drive_id=drive.id, owner=owner, request=work, limit=limit)
    drive.state = DriveState.CHECKING
    drive.touched_at = job.created_at
    return job


def committed(context: Context, drive_id: str, job: Job | None) -> DriveModel:
    """Return the drive when its check has ended, or while it goes on."""
    with context.database.reading() as session:
        drive = find_drive(session, drive_id)
        if job is not None:
            raise_failure(job)
            if job.summary is not None and not CommitOutcome.model_validate(job.summary).ok:
                raise not_usable(drive)
        return whole_drive_model(session, context, drive)


def not_usable(drive: Drive) -> Problem:
    """Return the problem of a drive that has errors."""
    report = DriveReport.model_validate(drive.report or {"path": drive.name, "name": drive.name})
    errors = [problem for problem in report.problems if problem.severity == "error"]
    first = f"{errors[0].path}: {errors[0].message}" if errors else "see its report."
    more = f" And {len(errors) - 1} more." if len(errors) > 1 else ""
    return Problem(
        DRIVE_NOT_USABLE,
        f"{first}{more} The drive is open again: mend the files, and commit it once more.",
        problems=report.problems,
        report=report.to_dict(),
    )


def finish_drive(session: Session, context: Context, job: Job, outcome: Outcome | Problem) -> None:
    """Write the outcome of a job, or why it failed, into its drive, in the transaction in which the job ends.

    The end of the job is written already; it becomes a failure if its files cannot be placed in the drive. Files are
    removed only after the transaction; `tidy_drive` decides which, and the clean-up repeats it.
    """
    drive = session.get(Drive, job.drive_id, with_for_update=True, populate_existing=True)
    if drive is None:
        return
    drive.touched_at = context.database.clock(session)
    if job.kind == JobKind.COMMIT:
        _finish_commit(session, context, job, drive, outcome)
    elif job.kind in {JobKind.UNPACK, JobKind.DEMO}:
        _finish_unpack(session, context, job, drive, outcome)
        if job.kind == JobKind.DEMO and job.state == JobState.SUCCESSFUL:  # its client may be gone
            queue_commit(session, context.database, drive, job.owner)
    session.flush()
    session.refresh(drive)  # the counts of an unpacking were written past it
    job_id, drive_id, keep_raw, state = job.id, drive.id, drive.keep_raw, drive.state

    def tidy() -> None:
        try:
            context.storage.delete(f"jobs/{job_id}/result")  # its contents were moved into the drive
            if state == DriveState.READY:
                tidy_drive(context, drive_id, keep_raw=keep_raw)
        except OSError:  # the clean-up tries again
            _log.exception("drive %s: not all could be tidied up", drive_id)

    afterwards(session, tidy)  # thousands of files, and it waits for the disk


def _finish_commit(session: Session, context: Context, job: Job, drive: Drive, outcome: Outcome | Problem) -> None:
    """Make the drive ready, or reopen it with the report of what is wrong."""
    drive.state = DriveState.UPLOADING
    if not isinstance(outcome, CommitOutcome):
        return
    drive.report = None if outcome.report is None else outcome.report.to_dict()
    if outcome.reduced_bytes is None:
        return
    if drive.source is not None or drive.keep_raw:  # what was sent was counted when it came
        try:
            check_quota(context, session, drive.owner, drive.owner, outcome.reduced_bytes)
        except Problem as problem:
            job.state, job.error, job.summary = JobState.FAILED, problem.document(), None
            return
    built = context.storage.folder(f"jobs/{job.id}/result")
    target = context.storage.folder(reduced_key(drive.id))
    if (built / REDUCED).is_dir():  # otherwise it was moved by a transaction that failed and is repeated now
        context.storage.delete(reduced_key(drive.id))
        (built / REDUCED).replace(target)
    for name in TRAJECTORY:
        with suppress(FileNotFoundError):
            (built / name).replace(target.parent / name)
    note_extent(drive, context.storage)
    maps = select(func.sum(DriveFile.size_bytes)).where(DriveFile.drive_id == drive.id, IS_MAP)
    drive.stored_bytes = outcome.reduced_bytes + (drive.size_bytes if drive.keep_raw else session.scalar(maps) or 0)
    drive.state = DriveState.READY


def _finish_unpack(session: Session, context: Context, job: Job, drive: Drive, outcome: Outcome | Problem) -> None:
    """Place the unpacked files in the drive: all or none."""
    if isinstance(outcome, Problem):
        return
    scratch = context.storage.folder(f"jobs/{job.id}/scratch")
    incoming = context.storage.incoming()
    arrivals = [
        Arrival(file.path, incoming / secrets.token_hex(12), file.size_bytes, file.sha256)
        for file in read_listing(scratch)
    ]
    try:
        with session.begin_nested(), Placement(context.storage, files_key(drive.id)) as placement:
            refuse_unless_open(drive, ["archive"])
            for arrival in arrivals:
                # A second name: if the server dies before the end of the transaction, all of this is repeated.
                link(scratch / UNPACKED / arrival.path, arrival.temporary)
            place(context, session, placement, lock_counts(session, drive.id), arrivals, job.owner)
    except Problem as problem:
        job.state = JobState.FAILED
        job.error = problem.document()
        job.summary = None
    finally:
        for arrival in arrivals:
            with suppress(OSError):
                arrival.temporary.unlink(missing_ok=True)


def tidy_drive(context: Context, drive_id: str, *, keep_raw: bool) -> None:
    """Remove the uploaded files of a ready drive except maps, which jobs read from there.

    Small files and reduced scans are in its reduced folder. Doing it again changes nothing.
    """
    if keep_raw:
        return
    root = context.storage.folder(files_key(drive_id))
    if not context.storage.folder(reduced_key(drive_id)).is_dir():
        _log.error("drive %s is ready, but its reduced folder is not there", drive_id)
        return
    raw = [
        path
        for folder, _, names in os.walk(root)
        for path in (Path(folder, name) for name in names)
        if not is_map(path.relative_to(root).as_posix())
    ]
    if raw:
        os.sync()  # what replaces them, and the row in the database, must survive a power failure
        size = sum(size_of(path) for path in raw)
        _log.info("drive %s: %d raw files are reduced, %d bytes removed", drive_id, len(raw), size)
    for path in raw:
        with suppress(OSError):
            path.unlink()
    for folder, folders, _ in os.walk(root, topdown=False):
        for name in folders:
            with suppress(OSError):
                Path(folder, name).rmdir()
