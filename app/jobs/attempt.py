"""One attempt at a job: prepare, all parts and finish in the executor; then the end of the job in the database."""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, TypeVar, TypeVarTuple

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.http.problems import Problem
from app.jobs import failures
from app.jobs.executors import WorkExecutor
from app.jobs.folders import place_result, progress_files, task_of, tidy, without_paths
from app.jobs.processes import NoWorkersError, WorkerLimitError, WorkerLostError
from app.jobs.queue import Claim, JobQueue, not_ready
from app.states import DriveState, JobKind, JobState
from app.store.models import Drive, Job
from app.work import kinds
from app.work.documents import JobRequest, Outcome
from app.work.task import Cancelled, Part, Plan, Task

FinishDrive = Callable[[Session, Context, Job, Outcome | Problem], None]
"""Writes what the end of a job, successful or not, means for its drive, in the transaction that ends the job."""

WriteFeatures = Callable[[Session, Job], None]
IndexResult = Callable[[Path], WriteFeatures]
"""Reads a new result ahead of the transaction that ends the job; what it returns writes its features within that."""

Stop = Literal["cancelled", "lost", "shutdown"]

_LOOK_S = 0.5  # interval at which progress is read
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
        self._total: int | None = None
        self._reported: dict[str, Any] = {"done": claim.job.done}  # as it is in the database
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
            seconds, most = time.monotonic() - self._began, self._context.settings.job_s
            if seconds > most:
                raise failures.limit_reached(WorkerLimitError("time", most, seconds), "the job", "job_s")
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
        if failures.is_final(error) and not isinstance(error, Cancelled):
            raise without_paths(failures.problem_of(error, what, 1), self._task) from error
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
        for wait_s in (0.5, 1, 2, 4, 8, 0):
            try:
                job = None if self._stop == "lost" else self._finish(outcome, write_features)
                break
            except SQLAlchemyError as error:
                _log.warning("job %s: its end could not be written: %s", job_id, error)
                if not wait_s:
                    return "left to its lease"  # whoever takes it over finds all parts done
                time.sleep(wait_s)
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
        return job

    def _leave(self) -> str:
        """Leave a job that another server has taken over, or that was deleted with its drive."""
        with suppress(SQLAlchemyError), self._context.database.reading() as session:
            if session.get(Job, self.claim.job.id) is None:
                tidy(self._context.storage, self.claim.job.id, keep_result=False)
                return "deleted"
        return "taken over"
