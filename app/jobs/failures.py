"""Why a job failed, as the problem document that its client reads."""

from app.http.problem_types import CANCELLED, FAULT_OF_THE_SERVICE, LIMIT_REACHED, SERVER_LOST, WORKER_LOST
from app.http.problems import OUT_OF_SPACE, Problem, disk_full, from_error, stored
from app.jobs.processes import WorkerLimitError
from app.states import JobState
from app.store.models import Job
from interloc.errors import InterLocError


def final_problem(error: BaseException, what: str) -> Problem | None:
    """Return the problem of an error that another try would meet too: bad input, a limit reached, a full disk."""
    if isinstance(error, Problem):
        return error
    if isinstance(error, InterLocError):
        return from_error(error)
    if isinstance(error, WorkerLimitError):
        return limit_reached(error, what, "job_stage_s")
    if isinstance(error, OSError) and error.errno in OUT_OF_SPACE:
        return disk_full()
    return None


def problem_of(error: BaseException, what: str, tries: int) -> Problem:
    """Return the problem document for an error of a piece of work ("keyframes 240 to 480") after some tries."""
    return final_problem(error, what) or Problem(
        FAULT_OF_THE_SERVICE,
        f"The service failed at {what}, {_times(tries)}. This is a fault of the service, and its log has the details; "
        "please report it.",
    )


_MEANINGS = {
    "job_stage_s": "one stage of a job may take",
    "job_s": "a job may take",
    "request_work_s": "the work for a request may take",
    "worker_memory_bytes": "a worker process may have",
}


def limit_reached(error: WorkerLimitError, what: str, time_setting: str) -> Problem:
    """Return the problem of work that was ended because it used more than it may; `time_setting` sets the time."""
    setting = time_setting if error.limit == "time" else "worker_memory_bytes"
    raised_by = {"job_s": "job_stage_s", "request_work_s": None}.get(setting, setting)
    advice = ""
    if raised_by is not None:
        now = f", now {error.bound:.0f}" if raised_by == setting else ""
        advice = f" Who runs the service can raise the limit: INTERLOC_{raised_by.upper()}{now}."
    amount = _duration if error.limit == "time" else _size
    verb = "took longer than the" if error.limit == "time" else f"needed {_size(error.used)} of memory, more than the"
    usual = "a file that is far larger than needed (cut the map of a country to the area), or very fine cells"
    return Problem(
        LIMIT_REACHED,
        f"{what[0].upper()}{what[1:]} {verb} {amount(error.bound)} that {_MEANINGS[setting]}, so it was ended. "
        f"Usual cause: {usual}.{advice}",
        limit=setting,
        bound=error.bound,
        used=round(error.used, 1),
    )


def lost_workers(reason: str, what: str, tries: int) -> Problem:
    """Return the problem of a piece of work that killed its workers."""
    return Problem(
        WORKER_LOST,
        f"The worker at {what} died {_times(tries)} ({reason}), so the service gave up. Usual cause: too little memory "
        "on the machine of the worker; fewer workers at a time (INTERLOC_WORKERS) need less of it.",
    )


def lost_servers(attempts: int) -> Problem:
    """Return the problem of a job whose servers were ended too often."""
    return Problem(
        SERVER_LOST,
        f"The server that worked on the job was ended {_times(attempts)}, so the service gave up. Usual cause: too "
        "little memory on its machine. Start the job again when there is more.",
    )


def cancelled() -> Problem:
    """Return the problem of a job that a client cancelled."""
    return Problem(CANCELLED, "The job was cancelled before it ended.")


def raise_failure(job: Job) -> None:
    """Raise the problem of a job that has failed or was cancelled."""
    if job.state in {JobState.FAILED, JobState.DISMISSED}:
        raise cancelled() if job.error is None else stored(job.error)


def _duration(seconds: float) -> str:
    """Return a time as people read it: "30 minutes"."""
    for unit, name in ((3600, "hours"), (60, "minutes")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.3g} seconds"


def _size(size_bytes: float) -> str:
    return f"{size_bytes / 1024**3:.2g} GB"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
