"""Wait for the end of a job within a request."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

from fastapi.concurrency import run_in_threadpool

from app.jobs.queue import FINAL
from app.jobs.view import find_job
from app.store.models import Job

if TYPE_CHECKING:
    from app.context import Context

_FIRST_LOOK_S, _LAST_LOOK_S = 0.05, 0.5


async def wait_for_async(context: Context, job_id: str, seconds: float) -> Job:
    """Return a job when it has ended, or as it is after some seconds, or when the server is to stop.

    Raises
    ------
    Problem
        404 there is no such job (any more).
    """
    end = time.monotonic() + seconds
    pause_s = _FIRST_LOOK_S
    while True:
        job = await run_in_threadpool(_look, context, job_id)
        left_s = end - time.monotonic()
        if job.state in FINAL or left_s <= 0 or context.stopping.is_set():
            return job
        await asyncio.sleep(min(pause_s, left_s))
        pause_s = min(1.3 * pause_s, _LAST_LOOK_S)


def _look(context: Context, job_id: str) -> Job:
    with context.database.reading() as session:
        return find_job(session, job_id)[0]
