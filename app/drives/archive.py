"""Uploaded archives: each becomes a job that unpacks it."""

from __future__ import annotations

import secrets

from app.context import Context
from app.drives.models import UnpackedArchive
from app.drives.records import drive_key, lock_drive
from app.drives.upload import refuse_unless_open
from app.drives.work.unpack import MAGIC_BYTES, archive_kind
from app.http.intake import Arrival
from app.http.limits import check_quota, job_limit
from app.http.problem_types import NOT_AN_ARCHIVE
from app.http.problems import Problem
from app.jobs.failures import raise_failure
from app.jobs.queue import submit
from app.states import JobKind
from app.store.models import Job
from app.work.documents import FilesOutcome


def check_magic(head: bytes) -> None:
    """Refuse (415) a file that is not an archive by its first bytes."""
    if archive_kind(head[:MAGIC_BYTES]) is None:
        raise Problem(
            NOT_AN_ARCHIVE,
            "The body is neither .zip nor .tar, .tar.gz or .tar.zst by its first bytes. Send the archive as it is, or "
            "as part `archive` of multipart/form-data.",
        )


def queue_archive(context: Context, drive_id: str, owner: str, arrival: Arrival) -> Job:
    """Store an archive, and queue the job that unpacks it.

    Raises
    ------
    Problem
        404, 409: there is no such drive, or it takes no files now. 413, 429: a limit of the client.
    """
    name = f"archives/{secrets.token_hex(8)}"
    place = context.storage.folder(f"{drive_key(drive_id)}/{name}")
    try:
        with context.database.writing() as session:
            drive = lock_drive(session, drive_id)
            refuse_unless_open(drive, ["archive"])
            check_quota(context, session, drive.owner, owner, arrival.size_bytes)
            job, _ = submit(
                session,
                context.database,
                kind=JobKind.UNPACK,
                drive_id=drive_id,
                owner=owner,
                request={"archive": name},
                limit=job_limit(context, owner),
            )
            drive.touched_at = job.created_at
            place.parent.mkdir(parents=True, exist_ok=True)
            arrival.temporary.replace(place)
    except BaseException:
        place.unlink(missing_ok=True)
        raise
    context.jobs_changed.set()
    return job


def unpacked(job: Job) -> UnpackedArchive:
    """Return the outcome of the unpacking, or that it goes on.

    Raises
    ------
    Problem
        The archive was refused, or the service failed.
    """
    raise_failure(job)
    if job.summary is None:
        return UnpackedArchive(job_id=job.id, state=job.state)
    outcome = FilesOutcome.model_validate(job.summary)
    return UnpackedArchive(job_id=job.id, state=job.state, files=outcome.files, size_bytes=outcome.size_bytes)
