"""The runner of a server: takes jobs from the queue, works on each in a thread, and keeps the leases alive."""

from __future__ import annotations

import logging
import threading
import time
from typing import TYPE_CHECKING

from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from app.jobs.attempt import Attempt
from app.jobs.executors import WorkExecutor, open_executor
from app.jobs.folders import jobs_with_scratch, tidy
from app.jobs.queue import FINAL, JobQueue
from app.store.models import Job
from app.work.kinds import QUICK

if TYPE_CHECKING:
    from app.context import Context

_POLL_S = 0.5
_JOBS_AT_ONCE = 2
_QUICK_AT_ONCE = 4  # besides: nobody who uploads waits for somebody's long job
_log = logging.getLogger(__name__)


class Runner:
    """Works on jobs from `start` to `stop`."""

    def __init__(self) -> None:
        self._threads: list[threading.Thread] = []
        self._attempts: dict[str, tuple[Attempt, threading.Thread]] = {}
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._executor: WorkExecutor | None = None

    @property
    def executor(self) -> WorkExecutor:
        """Where the work is done; for short work of requests too."""
        assert self._executor is not None, "the runner has not been started"
        return self._executor

    @property
    def is_stopping(self) -> bool:
        """True once `stop` was called: who waits for a job should not wait on."""
        return self._stopping.is_set()

    @property
    def running(self) -> int:
        """Jobs that this server works on."""
        return len(self._attempts)

    def ailment(self) -> str | None:
        """Return why no job could be worked on, None where all is well."""
        if self._executor is None or not all(thread.is_alive() for thread in self._threads):
            return "the runner does not run"
        return None if self._executor.alive else "there is no worker"

    def start(self, context: Context) -> None:
        """Begin; workers start in the background.

        Raises
        ------
        ConfigError
            The Dask cluster of the settings cannot be used.
        """
        self._executor = open_executor(context.settings, context.metrics.worker_restarts.inc)
        queue = JobQueue(context.database, context.settings.lease_s)
        for target in (self._claim_jobs, self._keep_leases):
            thread = threading.Thread(target=target, args=(context, queue), name=target.__name__, daemon=True)
            thread.start()
            self._threads.append(thread)

    def wake(self) -> None:
        """Look for new jobs at once."""
        self._wake.set()

    def stop(self) -> None:
        """End soon: work that runs is given up, its job given back to the queue with all parts that are done."""
        self._stopping.set()
        self._wake.set()
        with self._lock:
            attempts = list(self._attempts.values())
        for attempt, _ in attempts:
            attempt.stop("shutdown")
        if self._executor is not None:
            self._executor.stop()
        for thread in [*self._threads, *(thread for _, thread in attempts)]:
            thread.join(5)

    def _claim_jobs(self, context: Context, queue: JobQueue) -> None:
        self._tidy_scratch(context)
        while not self._stopping.is_set():
            try:
                found = self._claim(context, queue)
            except SQLAlchemyError as error:
                _log.warning("no job could be claimed: %s", error)
                found = False
            if not found:
                self._wake.wait(_POLL_S)
                self._wake.clear()

    def _claim(self, context: Context, queue: JobQueue) -> bool:
        """Take one job, where there is room for it; tell whether there was one."""
        with self._lock:
            kinds = [attempt.claim.job.kind for attempt, _ in self._attempts.values()]
        quick = sum(kind in QUICK for kind in kinds)
        room = len(kinds) - quick < (context.settings.jobs_at_once or _JOBS_AT_ONCE)
        if not room and quick >= _QUICK_AT_ONCE:
            return False
        claim = queue.claim(quick_only=not room)
        if claim is None:
            return False
        attempt = Attempt(context, queue, self.executor, claim)
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
            self.wake()

    def _keep_leases(self, context: Context, queue: JobQueue) -> None:
        """Say that this server lives, and hear what was cancelled or lost."""
        lease_s = context.settings.lease_s
        heard = said = time.monotonic()
        while not self._stopping.wait(_POLL_S):
            with self._lock:
                attempts = {lease: attempt for lease, (attempt, _) in self._attempts.items()}
            now = time.monotonic()
            if not attempts:
                heard = now
                continue
            try:
                if now - said >= lease_s / 5:
                    held = queue.heartbeat(attempts)
                    heard = said = now
                else:
                    held = queue.look(attempts)
            except SQLAlchemyError as error:
                _log.warning("the leases of %d jobs could not be renewed: %s", len(attempts), error)
                if now - heard > lease_s:  # others have taken the jobs over, or will
                    for attempt in attempts.values():
                        attempt.stop("lost")
                continue
            for lease, state in held.items():
                if state != "held":
                    attempts[lease].stop(state)

    @staticmethod
    def _tidy_scratch(context: Context) -> None:
        """Remove what a server left behind that was killed between the end of a job and its tidying."""
        try:
            found = jobs_with_scratch(context.storage)
            with context.database.reading() as session:
                ended = session.execute(select(Job.id, Job.state).where(Job.id.in_(found), Job.state.in_(FINAL))).all()
        except (SQLAlchemyError, OSError) as error:
            _log.warning("left-over scratch folders could not be looked for: %s", error)
            return
        for job_id, state in ended:
            tidy(context.storage, job_id, keep_result=state == "successful")
