"""The runner of a server takes jobs from the queue, works on each in a thread, and renews the leases."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Annotated, TypeVar, TypeVarTuple

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from app.context import Context, part_of_app
from app.http.problem_types import WORKER_LOST
from app.http.problems import Problem
from app.jobs.attempt import Attempt, FinishDrive, IndexResult
from app.jobs.executors import WorkExecutor, open_executor
from app.jobs.failures import limit_reached
from app.jobs.folders import jobs_with_scratch, tidy
from app.jobs.processes import WorkerLimitError, WorkerLostError
from app.jobs.queue import URGENT_AT_ONCE, JobQueue
from app.states import FINAL, JobState
from app.store.models import Job
from app.work.kinds import URGENT

_POLL_S = 0.5
_log = logging.getLogger(__name__)

Given = TypeVarTuple("Given")
Returned = TypeVar("Returned")


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
                raise limit_reached(error, "the work for this request", "request_work_s") from error
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
        self._tidy_scratch()
        told = ""
        while not self._stopping.is_set():
            try:
                found, told = self._claim(), ""
            except SQLAlchemyError as error:
                if str(error) != told:  # once, not twice a second
                    _log.warning("no job could be claimed: %s", error)
                found, told = False, str(error)
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

    def _keep_leases(self) -> None:
        """Renew the leases of this server, and stop what was cancelled or lost."""
        lease_s = self._context.settings.lease_s
        asked = renewed = time.monotonic()
        while not self._stopping.wait(_POLL_S):
            with self._lock:
                attempts = {lease: attempt for lease, (attempt, _) in self._attempts.items()}
            now = time.monotonic()
            if not attempts:
                asked = now
                continue
            try:
                if now - renewed >= lease_s / 5:
                    held = self._queue.heartbeat(attempts)
                    asked = renewed = now
                else:
                    held = self._queue.look(attempts)
            except SQLAlchemyError as error:
                _log.warning("the leases of %d jobs could not be renewed: %s", len(attempts), error)
                if now - asked > lease_s:  # other servers have taken the jobs over, or will
                    for attempt in attempts.values():
                        attempt.stop("lost")
                continue
            for lease, state in held.items():
                if state != "held":
                    attempts[lease].stop(state)

    def _tidy_scratch(self) -> None:
        """Remove the scratch of jobs that have ended, left behind by a server that was killed before it could tidy."""
        try:
            found = jobs_with_scratch(self._context.storage)
            with self._context.database.reading() as session:
                ended = session.execute(select(Job.id, Job.state).where(Job.id.in_(found), Job.state.in_(FINAL))).all()
        except (SQLAlchemyError, OSError) as error:
            _log.warning("left-over scratch folders could not be looked for: %s", error)
            return
        for job_id, state in ended:
            tidy(self._context.storage, job_id, keep_result=state == JobState.SUCCESSFUL)


RunnerDep = Annotated[Runner, part_of_app("runner")]
