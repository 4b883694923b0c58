"""The end of a commit, an unpacking or a demo, written into the drive in the transaction that ends the job."""

from __future__ import annotations

import logging
import os
import secrets
from contextlib import suppress
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.context import Context
from app.drives.commit import queue_commit
from app.drives.records import drive_key, files_key, note_extent, reduced_key
from app.drives.upload import Placement, lock_counts, refuse_similar_names, refuse_unless_open, register, sizes_of
from app.http.intake import Arrival
from app.http.limits import check_quota
from app.http.problems import Problem
from app.states import DriveState, JobKind, JobState
from app.store.database import afterwards
from app.store.incoming import size_of
from app.store.models import Drive, DriveFile, Job
from app.work.documents import CommitOutcome, Outcome, UnpackJob
from app.work.places import REDUCED, TRAJECTORY, UNPACKED, link, read_listing
from interloc.osm.container import is_map

_log = logging.getLogger(__name__)


def finish_drive(session: Session, context: Context, job: Job, outcome: Outcome | Problem) -> None:
    """Write the outcome of a job into its drive.

    Parameters
    ----------
    session
        The transaction in which the job ends.
    job
        Its end is written already; it becomes a failure if its files cannot be placed in the drive.
    outcome
        Its outcome, or why it failed.

    Notes
    -----
    Files are removed only after the transaction; `tidy_drive` decides which, and the clean-up repeats it.
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
    archive = UnpackJob.model_validate(job.request).archive if job.kind == JobKind.UNPACK else None

    def tidy() -> None:
        try:
            context.storage.delete(f"jobs/{job_id}/result")  # its contents were moved into the drive
            if archive is not None:
                context.storage.delete(f"{drive_key(drive_id)}/{archive}")
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
    if drive.source is not None:  # what was sent was counted when it came
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
    maps = [
        size
        for path, size in session.execute(
            select(DriveFile.path, DriveFile.size_bytes).where(
                DriveFile.drive_id == drive.id, DriveFile.path.contains(".osm", autoescape=True)
            )
        )
        if is_map(path)
    ]
    kept = drive.size_bytes if drive.keep_raw else sum(maps)
    drive.stored_bytes = outcome.reduced_bytes + kept
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
        with session.begin_nested(), Placement(context.storage, drive.id) as placement:
            refuse_unless_open(drive, ["archive"])
            for arrival in arrivals:
                # A second name: if the server dies before the end of the transaction, all of this is repeated.
                link(scratch / UNPACKED / arrival.path, arrival.temporary)
            paths = [arrival.path for arrival in arrivals]
            known = sizes_of(session, drive.id, paths)
            refuse_similar_names(session, drive.id, paths)
            register(context, session, lock_counts(session, drive.id), arrivals, known, job.owner)
            placement.move(arrivals)
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
        context.metrics.count_removal("reduced", size, len(raw))
    for path in raw:
        with suppress(OSError):
            path.unlink()
    for folder, folders, _ in os.walk(root, topdown=False):
        for name in folders:
            with suppress(OSError):
                Path(folder, name).rmdir()
