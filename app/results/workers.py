"""Short work that a request waits for, done by the workers of the jobs: the server itself stays quick."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar

from app.context import Context
from app.http.problems import Problem
from app.jobs.executors import WorkerLostError

Outcome = TypeVar("Outcome")


async def in_worker(context: Context, function: Callable[..., Outcome], *args: Any) -> Outcome:  # noqa: ANN401
    """Call a function in a worker process; once more where the worker dies.

    Raises
    ------
    Problem
        503 where two workers died of it.
    """
    try:
        return await asyncio.wrap_future(context.runner.executor.submit_urgent(function, *args))
    except WorkerLostError:
        pass
    try:
        return await asyncio.wrap_future(context.runner.executor.submit_urgent(function, *args))
    except WorkerLostError as error:
        detail = f"The work for this request could not be done: {error}. Usual cause: too little memory."
        raise Problem(503, "Worker lost", detail, headers={"Retry-After": "5"}) from error
