"""The queue: jobs in a table, each leased to one server at a time. Every change is one short transaction.

A lease is a name that is written into the job when it is claimed, new at every claim. Every change of a running job
names its lease: a server that was silent for too long, and whose job another one has taken over, changes nothing.
All times are those of the clock of the database; where that is set, jobs are taken over too early or too late, and
nothing else is lost.
"""

import json
import secrets
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from sqlalchemy import CursorResult, Float, and_, bindparam, case, func, or_, select, update
from sqlalchemy.orm import Session, aliased

from app.http.problem_types import DRIVE_NOT_FOUND, DRIVE_NOT_READY, IDEMPOTENCY_KEY_USED_BEFORE, TOO_MANY_JOBS
from app.http.problems import Problem
from app.jobs.failures import cancelled
from app.jobs.webhooks import note
from app.states import ACTIVE, FINAL, DriveState, JobKind, JobState
from app.store.database import Database
from app.store.models import Drive, Job
from app.work.kinds import DRIVE_CHANGING, URGENT
from app.work.requests import StoredRequest, StoredSummary
from interloc.arrays import JsonObject

Held = Literal["held", "lost", "cancelled"]

URGENT_AT_ONCE = 4
"""Number of jobs that a server works on beside the others because somebody waits for them."""

FAR_S = 7200.0
"""No lease is given for so long: one that ends later is of a server whose clock was wrong."""

_WAITS_FOR_CHECK = "Waiting for the check of its drive."
_ANY_ACTIVE = select(Job.id).where(Job.state.in_(ACTIVE)).limit(1)


@dataclass(frozen=True)
class Claim:
    """A job that a server has taken."""

    job: Job
    """As it was when it was claimed."""
    drive_name: str
    drive_state: str
    lease: str
    """The name under which the server holds it."""


@cache
def _claimable(enough_urgent: bool, enough_long: bool) -> Any:  # noqa: ANN401 - a Select
    """Return the query for the job that is next; see `JobQueue.claim`. Made once: it takes longer than its answer."""
    now = bindparam("now", type_=Float)
    other = aliased(Job)
    is_urgent = Job.kind.in_(URGENT)
    is_over = or_(Job.lease_until <= now, Job.lease_until > now + FAR_S)
    running = (  # jobs of the same client and class
        select(func.count())
        .select_from(other)
        .where(
            other.owner == Job.owner,
            other.state == JobState.RUNNING,
            other.lease_until > now,
            other.kind.in_(URGENT) == is_urgent,
        )
        .correlate(Job)
        .scalar_subquery()
    )
    full = [is_class for is_class, enough in ((is_urgent, enough_urgent), (~is_urgent, enough_long)) if enough]
    return (
        select(Job, Drive.name, Drive.state)
        .join(Drive, Drive.id == Job.drive_id)
        .where(
            or_(Job.state == JobState.ACCEPTED, and_(Job.state == JobState.RUNNING, is_over)),
            or_(Job.kind.in_(DRIVE_CHANGING), Drive.state != DriveState.CHECKING),
            *(or_(~is_class, running == 0) for is_class in full),
        )
        .order_by(case((is_urgent, 0), else_=1), running, Job.created_at, Job.id)
        .limit(1)
    )


class JobQueue:
    """What servers do with jobs; one whose lease was not renewed for `lease_s` is taken over by another server."""

    def __init__(self, database: Database, lease_s: float) -> None:
        self._database = database
        self._lease_s = lease_s
        self._server = f"{socket.gethostname()[:64]}-{secrets.token_hex(4)}"

    def claim(self, *, enough_urgent: bool = False, enough_long: bool = False) -> Claim | None:
        """Take the job that is next: one that somebody waits for, else one of the client with the fewest running.

        Where enough run that somebody waits for, or enough others, only a job of a client that has none of that class
        running is taken: whoever has many keeps only himself waiting. A job whose drive is being checked is left alone;
        one whose lease has run out is taken over, which counts as another attempt.
        """
        with self._database.reading() as session:  # an idle server must not take the write lock twice per second
            if session.execute(_ANY_ACTIVE).first() is None:
                return None
            query = _claimable(enough_urgent, enough_long)
            if session.execute(query, {"now": self._database.clock(session)}).first() is None:
                return None
        with self._database.writing(patient=True) as session:
            now = self._database.clock(session)
            if not self._database.is_sqlite:
                query = query.with_for_update(skip_locked=True, of=Job)
            found = session.execute(query, {"now": now}).first()
            if found is None:
                return None
            job, drive_name, drive_state = found
            is_first = job.started_at is None  # an attempt that a stopping server gave back has been told
            job.state = JobState.RUNNING
            job.stage = "preparing"
            job.message = None
            job.attempts += 1
            stood_s = max(0.0, now - (job.lease_until or now))  # that no server worked on it
            job.started_at = now if job.started_at is None else job.started_at + stood_s
            job.lease_owner = f"{self._server}-{secrets.token_hex(8)}"
            job.lease_until = now + self._lease_s
            job.version += 1
            if is_first:
                note(session, job, JobState.RUNNING, now)
            return Claim(job, drive_name, drive_state, job.lease_owner)

    def heartbeat(self, leases: Iterable[str]) -> dict[str, Held]:
        """Renew leases; return which of them are lost and which jobs were cancelled."""
        leases = list(leases)
        with self._database.writing(patient=True) as session:
            until = self._database.clock(session) + self._lease_s
            held = update(Job).where(Job.lease_owner.in_(leases), Job.state == JobState.RUNNING)
            rows = session.execute(held.values(lease_until=until).returning(Job.lease_owner, Job.cancel_requested))
            ours = {lease: cancelled for lease, cancelled in rows if lease is not None}
        return {lease: ("cancelled" if ours[lease] else "held") if lease in ours else "lost" for lease in leases}

    def is_cancelled(self, session: Session, claim: Claim) -> bool:
        """Return whether a client has cancelled a job; until the transaction of the caller ends none can."""
        query = select(Job.cancel_requested).where(Job.id == claim.job.id)
        return bool(session.scalar(query.with_for_update()))

    def progress(self, claim: Claim, **values: Any) -> bool:  # noqa: ANN401 - columns of the job
        """Write the progress of a job; False if the lease is lost."""
        with self._database.writing(patient=True) as session:
            return _change(session, claim, **values)

    def release(self, claim: Claim, message: str) -> bool:
        """Give a job back unfinished, with what it waits for; the attempt does not count."""
        with self._database.writing(patient=True) as session:
            return _change(
                session,
                claim,
                state=JobState.ACCEPTED,
                stage="waiting",
                message=message,
                attempts=Job.attempts - 1,
                lease_owner=None,
            )

    def finish(
        self,
        session: Session,
        claim: Claim,
        state: JobState,
        *,
        error: JsonObject | None = None,
        summary: StoredSummary | None = None,
    ) -> bool:
        """End a job in a transaction of the caller; False if the lease is lost: then nothing else may be written."""
        return _change(
            session,
            claim,
            state=state,
            stage="finished",
            message=None,
            error=error,
            summary=summary,
            finished_at=self._database.clock(session),
            lease_owner=None,
            lease_until=None,
        )


def _change(session: Session, claim: Claim, **values: Any) -> bool:  # noqa: ANN401
    result = session.execute(
        update(Job)
        .where(Job.id == claim.job.id, Job.lease_owner == claim.lease, Job.state == JobState.RUNNING)
        .values(version=Job.version + 1, **values)
    )
    assert isinstance(result, CursorResult)
    return result.rowcount == 1


def submit(
    session: Session,
    database: Database,
    *,
    kind: str,
    drive_id: str,
    owner: str,
    request: StoredRequest,
    key: str | None = None,
    limit: int | None = None,
) -> tuple[Job, bool]:
    """Put a job into the queue, in a transaction of the caller; return it, and whether it is new.

    The same idempotency key returns the same job, unless its drive is deleted. The limit is that of the jobs of this
    owner and kind that may wait or run. Problems are 404 no such drive, 409 it is not committed, 422 the key was used
    for another request, 429 too many jobs.
    """
    database.lock_owner(session, owner)
    if key is not None:
        earlier = _job_of_key(session, owner, key)
        if earlier is not None:
            if (earlier.kind, earlier.drive_id) != (kind, drive_id) or _text(earlier.request) != _text(request):
                raise key_used(key, f"job {earlier.id}")
            return earlier, False
    drive = session.get(Drive, drive_id)
    if drive is None or drive.deleted_at is not None:
        raise no_drive(drive_id)
    if kind not in DRIVE_CHANGING and drive.state == DriveState.UPLOADING:
        raise not_ready(drive)
    if limit is not None:
        _check_room(session, kind, owner, limit)
    job = Job(
        kind=kind,
        drive_id=drive_id,
        owner=owner,
        request=request,
        name=request.get("name"),
        idempotency_key=key,
        message=_WAITS_FOR_CHECK if kind not in DRIVE_CHANGING and drive.state == DriveState.CHECKING else None,
        created_at=database.clock(session),
    )
    session.add(job)
    session.flush()
    return job, True


def active_job(session: Session, drive_id: str, kind: JobKind) -> Job | None:
    """Return the job of a kind that waits or runs for a drive."""
    return session.scalars(
        select(Job)
        .where(Job.drive_id == drive_id, Job.kind == kind, Job.state.in_(ACTIVE))
        .order_by(Job.created_at)
        .limit(1)
    ).first()


def no_drive(drive_id: str) -> Problem:
    """Return the problem of a drive that does not exist."""
    return Problem(
        DRIVE_NOT_FOUND,
        f"There is no drive {drive_id[:64]}; it may have been deleted, or an upload that was left alone has expired. "
        "GET /api/v1/drives lists those that there are, GET /api/v1/trash those that can be restored.",
    )


def not_ready(drive: Drive) -> Problem:
    """Return the problem of a drive that must be committed first."""
    return Problem(
        DRIVE_NOT_READY,
        f"{drive.name} (drive {drive.id}) is still open for files. Commit it first (POST /api/v1/drives/{drive.id}"
        "/commit); where that finds errors, its report lists them.",
    )


def cancel(session: Session, database: Database, job: Job) -> None:
    """Cancel a job in a transaction of the caller; one that does not run yet ends at once."""
    if job.state in FINAL or job.cancel_requested:
        return
    job.version += 1
    job.cancel_requested = True
    # The runner ends those that change their drive, and the drive with them.
    if job.state == JobState.ACCEPTED and job.kind not in DRIVE_CHANGING:
        job.state = JobState.DISMISSED
        job.stage = "finished"
        job.message = None
        job.finished_at = database.clock(session)
        job.error = cancelled().document()
        note(session, job, JobState.DISMISSED, job.finished_at, {"summary": None, "error": job.error})
    else:
        job.message = "It is being cancelled."


def _job_of_key(session: Session, owner: str, key: str) -> Job | None:
    """Return the job that was made with a key; that of a deleted drive gives the key up: another is meant."""
    query = select(Job, Drive.deleted_at).join(Drive, Drive.id == Job.drive_id)
    found = session.execute(query.where(Job.owner == owner, Job.idempotency_key == key)).first()
    if found is None:
        return None
    job, drive_deleted_at = found
    if job.deleted_at is None and drive_deleted_at is None:
        return job
    job.idempotency_key = None
    session.flush()  # before another row takes it
    return None


def key_used(key: str, what: str) -> Problem:
    """Return the problem of an idempotency key that was sent with another request, which made something."""
    return Problem(
        IDEMPOTENCY_KEY_USED_BEFORE,
        f"The key {key!r} was sent with another request before; that made {what}. Send a new key with a new request.",
    )


def _text(value: StoredRequest) -> str:
    return json.dumps(value, sort_keys=True)


def _check_room(session: Session, kind: str, owner: str, limit: int) -> None:
    waiting = session.scalar(
        select(func.count()).select_from(Job).where(Job.owner == owner, Job.kind == kind, Job.state.in_(ACTIVE))
    )
    if waiting is not None and waiting >= limit:
        raise Problem(
            TOO_MANY_JOBS,
            f"{waiting} jobs of {owner} wait or run, and that is the limit. Wait until one has ended, or cancel one "
            "(DELETE /api/v1/jobs/{id}).",
            headers={"Retry-After": "30"},
        )
