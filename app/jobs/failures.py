"""Why a job failed, as the problem document that its client reads."""

from __future__ import annotations

import errno

from app.http.problems import Problem, disk_full, from_error
from app.states import JobState
from app.store.models import Job
from interloc.errors import InterLocError

_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def is_final(error: BaseException) -> bool:
    """Return whether another try would fail the same way: the input is at fault, or the disk is full."""
    return isinstance(error, InterLocError | Problem) or (isinstance(error, OSError) and error.errno in _DISK)


def problem_of(error: BaseException, what: str, tries: int) -> Problem:
    """Return the problem document for an error of the work.

    Parameters
    ----------
    error
    what
        Which piece of work: "keyframes 240 to 480".
    tries
        Number of times that it was tried.
    """
    if isinstance(error, Problem):
        return error
    if isinstance(error, InterLocError):
        return from_error(error)
    if isinstance(error, OSError) and error.errno in _DISK:
        return disk_full()
    return Problem(
        500,
        "Fault of the service",
        f"The service failed at {what}, {_times(tries)}. This is a fault of the service, and its log has the details; "
        "please report it.",
    )


def lost_workers(reason: str, what: str, tries: int) -> Problem:
    """Return the problem of a piece of work that killed its workers."""
    return Problem(
        500,
        "Worker lost",
        f"The worker at {what} died {_times(tries)} ({reason}), so the service gave up. Usual cause: too little memory "
        "on the machine of the worker; fewer workers at a time (INTERLOC_WORKERS) need less of it.",
    )


def lost_servers(attempts: int) -> Problem:
    """Return the problem of a job whose servers were ended too often."""
    return Problem(
        500,
        "Server lost",
        f"The server that worked on the job was ended {_times(attempts)}, so the service gave up. Usual cause: too "
        "little memory on its machine. Start the job again when there is more.",
    )


def cancelled() -> Problem:
    """Return the problem of a job that a client cancelled."""
    return Problem(409, "Cancelled", "The job was cancelled before it ended.")


def raise_failure(job: Job) -> None:
    """Raise the problem of a job that has failed or was cancelled."""
    if job.state in {JobState.FAILED, JobState.DISMISSED}:
        document = dict(job.error or {"title": "Cancelled", "status": 409, "detail": "The job was cancelled."})
        status, title, detail = (document.pop(name) for name in ("status", "title", "detail"))
        for name in ("type", "instance"):
            document.pop(name, None)
        raise Problem(status, title, detail, **document)


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
