"""The runner of a server takes jobs from the queue, works on each in a thread, and renews the leases."""

import asyncio
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, TypeVarTuple

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context, part_of_app
from app.http.problem_types import WORKER_LOST
from app.http.problems import Problem
from app.jobs import failures
from app.jobs.executors import WorkExecutor, open_executor
from app.jobs.folders import place_result, progress_files, task_of, tidy, without_paths
from app.jobs.processes import NoWorkersError, WorkerLimitError, WorkerLostError
from app.jobs.queue import URGENT_AT_ONCE, Claim, JobQueue, not_ready
from app.jobs.webhooks import Told, note
from app.states import DriveState, JobKind, JobState
from app.store.models import Drive, Job
from app.work import kinds
from app.work.kinds import URGENT
from app.work.requests import JobRequest, Outcome
from app.work.task import Cancelled, Part, Plan, Task
from interloc.arrays import JsonObject

FinishDrive = Callable[[Session, Context, Job, Outcome | Problem], None]
"""Writes what the end of a job, successful or not, means for its drive, in the transaction that ends the job."""

WriteFeatures = Callable[[Session, Job], None]
IndexResult = Callable[[Path], WriteFeatures]
"""Reads a new result ahead of the transaction that ends the job; what it returns writes its features within that."""

Stop = Literal["cancelled", "lost", "shutdown"]

_POLL_S = 0.5  # in which a job is looked for
_LOOK_S = 0.5  # interval at which progress is read
_RENEW_S = 1.0  # interval at which leases are renewed, and cancelled jobs found
_GRACE_S = 1.5  # time for work to end by itself once it was asked to, and to tidy up; then its process is killed
_log = logging.getLogger(__name__)

Given = TypeVarTuple("Given")
Returned = TypeVar("Returned")


class _StoppedError(Exception):
    """The attempt was stopped."""


class Attempt:
    """A job under a lease of this server."""

    def __init__(
        self,
        context: Context,
        queue: JobQueue,
        executor: WorkExecutor,
        claim: Claim,
        *,
        finish_drive: FinishDrive,
        index_result: IndexResult,
    ) -> None:
        self._context = context
        self._queue = queue
        self._executor = executor
        self._finish_drive = finish_drive
        self._index_result = index_result
        self.claim = claim
        self._kind = kinds.KINDS[claim.job.kind]
        self._task: Task[JobRequest]  # made when the work begins: where its row cannot be read the job fails
        self._progress = progress_files(context.storage, claim)
        self._stop: Stop | None = None
        self._stopped: Future[None] = Future()  # ends with the stop, so that whoever waits for work wakes up
        self._at_work: set[Future[Any]] = set()
        self._began = time.monotonic()
        self._stage = ""
        self._done: dict[int, int] = {}  # units of the parts that have ended
        self._total = claim.job.total
        self._reported: JsonObject = {"done": claim.job.done}  # as it is in the database
        self._tries: Counter[str] = Counter()

    def stop(self, reason: Stop) -> None:
        """Let the attempt end soon; the first reason counts."""
        if self._stop is None:
            self._stop = reason
            self._progress.stop()
            self._stopped.set_result(None)

    def run(self) -> None:
        """Work on the job until it has ended, well or not."""
        job = self.claim.job
        extra = {"job": job.id, "drive": job.drive_id}
        _log.info("job %s (%s): attempt %d", job.id, job.kind, job.attempts, extra=extra)
        try:
            outcome: Outcome | Problem = self._work()
        except Problem as problem:
            outcome = problem
        except Exception as error:  # noqa: BLE001 - a job always ends
            if self._stop is None and isinstance(error, NoWorkersError):
                self._give_back("It waits for workers.")
                return
            if self._stop is None:
                _log.exception("job %s: the service itself failed", job.id, extra=extra)
                outcome = failures.problem_of(error, "the whole", 1)
            elif self._stop == "shutdown":
                self._give_back("Its server was stopped; it goes on as soon as one is free.")
                return
            else:
                outcome = failures.cancelled()
        state = self._end(outcome)
        _log.info("job %s (%s): %s", job.id, job.kind, state, extra=extra)

    def _give_back(self, message: str) -> None:
        """Return the job to the queue with all that is done of it; the attempt does not count."""
        with suppress(SQLAlchemyError):  # else the lease runs out
            self._queue.release(self.claim, message)
        _log.info("job %s (%s): given back", self.claim.job.id, self.claim.job.kind)

    def _work(self) -> Outcome:
        job = self.claim.job
        if job.cancel_requested:
            self._stop = "cancelled"
            raise _StoppedError
        if job.attempts > self._context.settings.max_attempts:
            raise failures.lost_servers(job.attempts - 1)
        if not self._kind.changes_drive and self.claim.drive_state == DriveState.UPLOADING:
            raise not_ready(Drive(id=job.drive_id, name=self.claim.drive_name))
        self._task = task_of(self._context, self.claim, self._executor.slots)
        self._stage, second, third = self._kind.stages
        self._progress.open()
        try:
            plan = self._call("the preparation", kinds.prepare, self._task)
            self._total = plan.total
            self._enter(plan.stage or second)
            self._do_parts(plan)
            self._enter(third)
            return self._call("the result", kinds.finish, self._task, plan)
        finally:
            self._give_up_rest()

    def _call(self, what: str, function: Callable[[*Given], Returned], *args: *Given) -> Returned:
        while True:
            future = self._begin(function, *args)
            self._wait({future})
            try:
                return future.result()
            except Exception as error:  # noqa: BLE001 - judged there
                self._count_failure(error, what)

    def _do_parts(self, plan: Plan) -> None:
        """Do all parts; few at a time are handed over, so that the parts of other jobs come in between."""
        waiting = deque(plan.parts)
        running: dict[Future[None], Part] = {}
        while waiting or running:
            while waiting and len(running) <= self._executor.slots:
                part = waiting.popleft()
                running[self._begin(kinds.run, self._task, part)] = part
            for future in self._wait(set(running)):
                part = running.pop(future)
                try:
                    future.result()
                except Exception as error:  # noqa: BLE001 - judged there
                    self._count_failure(error, f"part {part.number + 1} of {len(plan.parts)}")
                    waiting.appendleft(part)
                else:
                    self._done[part.number] = part.stop - part.start

    def _begin(self, function: Callable[[*Given], Returned], *args: *Given) -> Future[Returned]:
        future = self._executor.submit(
            function,
            *args,
            client=self.claim.job.owner,
            seconds=self._context.settings.job_stage_s,
            urgent=self._kind.urgent,
        )
        self._at_work.add(future)
        return future

    def _wait(self, futures: set[Future[Any]]) -> set[Future[Any]]:
        """Return those that have ended, reporting meanwhile how far they are."""
        while True:
            ended, _ = wait({*futures, self._stopped}, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            if self._stop is not None:
                raise _StoppedError
            seconds, maximum = time.monotonic() - self._began, self._context.settings.job_s
            if seconds > maximum:
                raise failures.limit_reached(WorkerLimitError("time", maximum, seconds), "the job", "job_s")
            self._report()
            self._at_work -= ended
            if ended:
                return ended

    def _give_up_rest(self) -> None:
        """End what is still at work when the job ends, well or not; a worker that does not listen is killed."""
        if not self._at_work:
            return
        self._progress.stop()
        begun = {future for future in self._at_work if not future.cancel()}
        wait(begun, timeout=_GRACE_S)
        for future in begun:
            self._executor.kill(future)
        wait(begun, timeout=_GRACE_S)  # until the process is dead: its files are removed next

    def _count_failure(self, error: Exception, what: str) -> None:
        """Return when the work is to be tried again; otherwise raise the problem of the job."""
        if self._stop is not None:
            raise _StoppedError from error
        if (problem := failures.final_problem(error, what)) is not None and not isinstance(error, Cancelled):
            raise without_paths(problem, self._task) from error
        self._tries[what] += 1
        tries = self._tries[what]
        _log.warning("job %s: %s failed: %s", self.claim.job.id, what, error, exc_info=error)
        if tries >= self._context.settings.max_attempts:
            if isinstance(error, WorkerLostError):
                raise failures.lost_workers(str(error), what, tries) from error
            raise failures.problem_of(error, what, tries) from error
        if tries >= self.claim.job.attempts:
            self._write(attempts=tries + 1)

    def _enter(self, stage: str) -> None:
        self._stage = stage
        self._progress.forget_stage()
        self._report()

    def _report(self) -> None:
        """Write how far the job is, where that has changed."""
        progress = self._progress.read()
        done = sum({**progress.done, **self._done}.values())
        now = {
            "stage": progress.stage or self._stage,
            "message": progress.message,
            "done": max(done, self._reported.get("done", 0)),  # a part that starts anew takes nothing back
            "total": self._total,
        }
        if now != self._reported:
            self._reported = now
            self._write(**now)

    def _write(self, **values: Any) -> None:  # noqa: ANN401 - columns of the job
        try:
            if not self._queue.progress(self.claim, **values):
                self.stop("lost")
        except SQLAlchemyError as error:  # the next report writes it all again
            self._reported = {}
            _log.warning("job %s: its progress could not be written: %s", self.claim.job.id, error)

    def _end(self, outcome: Outcome | Problem) -> str:
        """Write how the job ended, and put its result in place: both or neither."""
        job_id, storage = self.claim.job.id, self._context.storage
        write_features = self._features() if isinstance(outcome, Outcome) else None
        try:
            job = None if self._stop == "lost" else self._finish(outcome, write_features)
        except SQLAlchemyError as error:
            _log.warning("job %s: its end could not be written: %s", job_id, error)
            return "left to its lease"  # whoever takes it over finds all parts done
        if job is None:
            return self._leave()
        tidy(storage, job_id, keep_result=job.state == JobState.SUCCESSFUL)
        return job.state

    def _features(self) -> WriteFeatures | None:
        """Return what writes the features of the result into the index; without it the clean-up tries again."""
        if self.claim.job.kind != JobKind.INTERSECTIONS:
            return None
        try:
            return self._index_result(self._task.result)
        except Exception:  # noqa: BLE001 - the result is there all the same
            _log.exception("job %s: its features could not be indexed", self.claim.job.id)
            return None

    def _finish(self, outcome: Outcome | Problem, write_features: WriteFeatures | None) -> Job | None:
        """Write the end of the job, with all that it means; returns its row, None where the lease is lost."""
        job_id = self.claim.job.id
        with self._context.database.writing(patient=True) as session:
            if isinstance(outcome, Outcome) and self._queue.is_cancelled(session, self.claim):
                self._stop, outcome = "cancelled", failures.cancelled()  # too late to be seen before
            error = summary = None
            if isinstance(outcome, Outcome):
                state, summary = JobState.SUCCESSFUL, outcome.summary()
            else:
                state = JobState.DISMISSED if self._stop == "cancelled" else JobState.FAILED
                error = outcome.document() | {"instance": f"/api/v1/jobs/{job_id}"}
            if not self._queue.finish(session, self.claim, state, error=error, summary=summary):
                return None
            job = session.get_one(Job, job_id, populate_existing=True)
            if state == JobState.SUCCESSFUL:
                place_result(self._context.storage, self._task)
                if write_features is not None:
                    write_features(session, self.claim.job)
            if self._kind.changes_drive:
                self._finish_drive(session, self._context, job, outcome)
            known: Told = {"summary": job.summary, "error": job.error}
            note(session, job, JobState(job.state), job.finished_at or 0.0, known)
        return job

    def _leave(self) -> str:
        """Leave a job that another server has taken over, or that was deleted with its drive."""
        with suppress(SQLAlchemyError), self._context.database.reading() as session:
            if session.get(Job, self.claim.job.id) is None:
                tidy(self._context.storage, self.claim.job.id, keep_result=False)
                return "deleted"
        return "taken over"


class Runner:
    """Works on jobs from `start` to `stop`."""

    def __init__(self, context: Context, *, finish_drive: FinishDrive, index_result: IndexResult) -> None:
        self._context = context
        self._attempt = partial(Attempt, finish_drive=finish_drive, index_result=index_result)
        self._queue = JobQueue(context.database, context.settings.lease_s)
        self._threads: list[threading.Thread] = []
        self._attempts: dict[str, tuple[Attempt, threading.Thread]] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._executor: WorkExecutor | None = None

    def ailment(self) -> str | None:
        """Return why no job can be worked on; None if jobs can be."""
        if self._executor is None or not all(thread.is_alive() for thread in self._threads):
            return "the runner does not run"
        return None if self._executor.alive else "there is no worker"

    def start(self) -> None:
        """Begin; workers start in the background. A Dask cluster that cannot be used is a `ConfigError`."""
        self._executor = open_executor(self._context.settings, self._context.metrics.worker_restarts.inc)
        for target in (self._claim_jobs, self._keep_leases):
            thread = threading.Thread(target=target, name=target.__name__, daemon=True)
            thread.start()
            self._threads.append(thread)

    def submit(
        self, function: Callable[[*Given], Returned], *args: *Given, client: str, seconds: float
    ) -> Future[Returned]:
        """Have a worker call a function when none of the work that somebody waits for is left to begin.

        The future fails with `WorkerLimitError` or `WorkerLostError` as those of jobs do.
        """
        assert self._executor is not None, "the runner has not been started"
        return self._executor.submit(function, *args, client=client, seconds=seconds, urgent=False)

    async def run_in_worker(self, function: Callable[[*Given], Returned], *args: *Given, client: str) -> Returned:
        """Call a function in a worker process, before all that waits; once more where the worker dies.

        For short work that a request of a client waits for: the server itself stays quick. A 422 where it takes more
        time or memory than it may, a 503 where two workers died of it.
        """
        assert self._executor is not None, "the runner has not been started"
        seconds = self._context.settings.request_work_s
        for attempt in (1, 2):
            try:
                return await asyncio.wrap_future(
                    self._executor.submit(function, *args, client=client, seconds=seconds, urgent=True)
                )
            except WorkerLimitError as error:
                raise failures.limit_reached(error, "the work for this request", "request_work_s") from error
            except WorkerLostError as error:
                if attempt == 2:
                    detail = f"The work for this request could not be done: {error}. Usual cause: too little memory."
                    raise Problem(WORKER_LOST, detail, status=503, headers={"Retry-After": "5"}) from error
        raise AssertionError

    def stop(self) -> None:
        """End soon: running work is given up, and its job returned to the queue with all parts that are done."""
        self._stopping.set()
        self._context.jobs_changed.set()
        with self._lock:
            attempts = list(self._attempts.values())
        for attempt, _ in attempts:
            attempt.stop("shutdown")
        if self._executor is not None:
            self._executor.stop()
        for thread in [*self._threads, *(thread for _, thread in attempts)]:
            thread.join(5)

    def _claim_jobs(self) -> None:
        known = ""
        while not self._stopping.is_set():
            try:
                found, known = self._claim(), ""
            except SQLAlchemyError as error:
                if str(error) != known:  # once, not twice a second
                    _log.warning("no job could be claimed: %s", error)
                found, known = False, str(error)
            if not found:
                self._context.jobs_changed.wait(_POLL_S)
                self._context.jobs_changed.clear()

    def _claim(self) -> bool:
        """Take one job if there are workers, and room for it; return whether there was one."""
        assert self._executor is not None
        if not self._executor.alive:
            self._context.lacks_workers.set()
            return False
        self._context.lacks_workers.clear()
        with self._lock:
            kinds = [attempt.claim.job.kind for attempt, _ in self._attempts.values()]
        urgent = sum(kind in URGENT for kind in kinds)
        claim = self._queue.claim(
            enough_urgent=urgent >= URGENT_AT_ONCE,
            enough_long=len(kinds) - urgent >= self._context.settings.jobs_at_once,
        )
        if claim is None:
            return False
        attempt = self._attempt(self._context, self._queue, self._executor, claim)
        thread = threading.Thread(target=self._work, args=(attempt,), name=f"job-{claim.job.id}", daemon=True)
        with self._lock:
            self._attempts[claim.lease] = attempt, thread
            if self._stopping.is_set():
                attempt.stop("shutdown")
        thread.start()
        return True

    def _work(self, attempt: Attempt) -> None:
        try:
            attempt.run()
        except Exception:  # noqa: BLE001 - the server goes on
            _log.exception("job %s: left to its lease", attempt.claim.job.id)
        finally:
            with self._lock:
                del self._attempts[attempt.claim.lease]
            self._context.jobs_changed.set()
            self._context.maps_changed.set()

    def _keep_leases(self) -> None:
        """Renew the leases of this server, and stop what was cancelled or lost."""
        lease_s = self._context.settings.lease_s
        renewed = time.monotonic()
        while not self._stopping.wait(min(_RENEW_S, lease_s / 5)):
            with self._lock:
                attempts = {lease: attempt for lease, (attempt, _) in self._attempts.items()}
            now = time.monotonic()
            try:
                held = self._queue.heartbeat(attempts) if attempts else {}
                renewed = now
            except SQLAlchemyError as error:
                _log.warning("the leases of %d jobs could not be renewed: %s", len(attempts), error)
                if now - renewed > lease_s:  # other servers have taken the jobs over, or will
                    for attempt in attempts.values():
                        attempt.stop("lost")
                continue
            for lease, state in held.items():
                if state != "held":
                    attempts[lease].stop(state)


RunnerDep = Annotated[Runner, part_of_app("runner")]
