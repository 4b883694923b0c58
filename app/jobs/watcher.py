"""Changes of jobs for all listeners of this server: a few queries per second, however many listeners there are."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import defaultdict
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Annotated

from fastapi.concurrency import run_in_threadpool
from sqlalchemy import select
from sqlalchemy.exc import OperationalError

from app.context import Context, part_of_app
from app.jobs.models import JobModel
from app.jobs.view import find_job, is_alive, job_models
from app.states import FINAL, JobState
from app.store.database import Database
from app.store.models import Drive, Job

_POLL_S = 0.5
_FIRST_LOOK_S, _LAST_LOOK_S = 0.05, 0.5
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Change:
    """A job after a change."""

    version: int
    message: str | None
    """What it is waiting for: where all workers are lost this changes without the job itself."""
    is_final: bool
    """Whether no further change can follow."""
    data: str
    """`JobModel` as JSON, made once for all listeners."""

    @classmethod
    def of(cls, job: JobModel) -> Change:
        """Return the change that led to this job."""
        return cls(job.version, job.message, job.state in FINAL, job.model_dump_json())


class JobWatcher:
    """Reports the changes of jobs; to be used in the event loop."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._listeners: defaultdict[str, set[asyncio.Queue[Change | None]]] = defaultdict(set)
        self._versions: dict[str, int] = {}
        """Of the jobs that are followed, as all their listeners know them."""
        self._polling: asyncio.Task[None] | None = None

    async def follow(self, job_id: str, last: Change) -> AsyncIterator[Change]:
        """Yield what comes after a change of a job, until the job has ended, is deleted, or the server stops."""
        queue: asyncio.Queue[Change | None] = asyncio.Queue()
        self._listeners[job_id].add(queue)
        self._versions.pop(job_id, None)  # the next look passes on what it finds
        if self._polling is None or self._polling.done():
            self._polling = asyncio.create_task(self._poll())
        try:
            while (change := await queue.get()) is not None:
                if change.version >= last.version and (change.version, change.message) != (last.version, last.message):
                    last = change
                    yield change
                if change.is_final:
                    return
        finally:
            self._listeners[job_id].discard(queue)
            if not self._listeners[job_id]:
                del self._listeners[job_id]

    async def _poll(self) -> None:
        try:
            while self._listeners and not self._context.stopping.is_set():
                followed = {job_id: self._versions.get(job_id) for job_id in self._listeners}
                try:
                    changes = await run_in_threadpool(_changes, self._context, followed)
                except OperationalError as error:
                    _log.warning("changes of jobs could not be read: %s", error)
                    changes = {}  # the next look finds them all
                for job_id, change in changes.items():
                    if change is not None and self._versions.get(job_id) == followed[job_id]:
                        self._versions[job_id] = change.version
                    for queue in self._listeners.get(job_id, ()):
                        queue.put_nowait(change)
                await asyncio.sleep(_POLL_S)
        except Exception:  # noqa: BLE001 - the listeners must not wait for ever
            _log.exception("changes of jobs could not be passed on")
        finally:  # whatever happened, end the streams of all listeners
            for queues in self._listeners.values():
                for queue in queues:
                    queue.put_nowait(None)


def _changes(context: Context, followed: dict[str, int | None]) -> dict[str, Change | None]:
    """Return the jobs whose version is another one, and those that wait; None for those that were removed."""
    alive = select(Job, Drive.name).join(Drive, Drive.id == Job.drive_id).where(is_alive())
    with context.database.reading() as session:
        rows = session.execute(
            alive.with_only_columns(Job.id, Job.version, Job.state).where(Job.id.in_(list(followed)))
        ).all()
        changed = [row.id for row in rows if row.version != followed[row.id] or row.state == JobState.ACCEPTED]
        found = session.execute(alive.where(Job.id.in_(changed))).all() if changed else []
        models = job_models(session, context, [(job, name) for job, name in found])
    gone: dict[str, Change | None] = dict.fromkeys(followed.keys() - {row.id for row in rows})
    return gone | {model.id: Change.of(model) for model in models}


WatcherDep = Annotated[JobWatcher, part_of_app("watcher")]


async def wait_for_job(context: Context, job_id: str, seconds: float) -> Job:
    """Wait until a job (else a 404) has ended, some seconds have passed or the server stops; return the job."""
    end = time.monotonic() + seconds
    pause_s = _FIRST_LOOK_S
    while True:
        job = await run_in_threadpool(_look, context.database, job_id)
        left_s = end - time.monotonic()
        if job.state in FINAL or left_s <= 0 or context.stopping.is_set():
            return job
        await asyncio.sleep(min(pause_s, left_s))
        pause_s = min(1.3 * pause_s, _LAST_LOOK_S)


def _look(database: Database, job_id: str) -> Job:
    with database.reading() as session:
        return find_job(session, job_id)[0]
