"""Endpoints: health, readiness, metrics."""

import time
from typing import Annotated

from anyio import CapacityLimiter, to_thread
from fastapi import Response
from fastapi.responses import JSONResponse
from sqlalchemy.exc import SQLAlchemyError

from app.context import Context, ContextDep, part_of_app
from app.http.prices import priced
from app.http.routing import Router
from app.jobs.runner import Runner
from app.metrics import CONTENT_TYPE
from app.store.storage import DataFolderGoneError

_BELIEVED_S = 1.0  # a probe cannot be used to load the database

router = Router(include_in_schema=False)


class Probe:
    """Finds out whether the service can work; many who ask at the same time are answered by one look.

    It has a thread of its own, so that it answers where all others wait for the database.
    """

    def __init__(self, context: Context, runner: Runner) -> None:
        self._context = context
        self._runner = runner
        self._thread = CapacityLimiter(1)
        self._found: dict[str, str] = {}
        self._began = self._ended = float("-inf")

    async def reasons(self) -> dict[str, str]:
        """Return why the service cannot work, by part; empty if it can."""
        if self._context.stopping.is_set():
            return {"server": "it is being stopped"}
        await to_thread.run_sync(self._look, time.monotonic(), limiter=self._thread)
        return self._found

    def _look(self, asked: float) -> None:
        """Look, unless others have since this was asked, or found a moment ago that all is well."""
        if self._began >= asked or (not self._found and time.monotonic() < self._ended + _BELIEVED_S):
            return
        self._began = time.monotonic()
        ailments = {
            "database": self._ailment_of_database(),
            "disk": self._ailment_of_disk(),
            "workers": self._runner.ailment(),
        }
        self._found = {part: reason for part, reason in ailments.items() if reason is not None}
        self._ended = time.monotonic()

    def _ailment_of_database(self) -> str | None:
        try:
            self._context.database.check_writable()
        except SQLAlchemyError as error:
            cause = getattr(error, "orig", None) or error
            # What PostgreSQL says may name its host; this answer is open to everybody.
            return f"nothing can be written ({cause if self._context.database.is_sqlite else type(cause).__name__})"
        return None

    def _ailment_of_disk(self) -> str | None:
        floor = self._context.settings.min_free_bytes
        try:
            free = self._context.storage.free_bytes()
            self._context.storage.check_writable()
        except DataFolderGoneError as error:
            return str(error)
        except OSError as error:
            return f"the data folder cannot be used ({error.strerror})"
        if free >= floor:
            return None
        return f"{free / 1e9:.1f} GB free, {floor / 1e9:.1f} GB must stay free (INTERLOC_MIN_FREE_BYTES)"


@router.get("/healthz")
@priced("cheap")
async def show_health() -> dict[str, str]:
    """Answer without any check. For the probe that restarts a container that hangs."""
    return {"status": "ok"}


@router.get("/readyz")
@priced("cheap")
async def show_readiness(probe: Annotated[Probe, part_of_app("probe")]) -> JSONResponse:
    """Check the database by a write, the disk and the workers. For load balancers: while this is 503, none is sent."""
    reasons = await probe.reasons()
    return JSONResponse({"ready": not reasons, "reasons": reasons}, 503 if reasons else 200)


@router.get("/metrics", response_class=Response)
@priced("cheap")
def show_metrics(context: ContextDep) -> Response:
    """Show requests, uploads, jobs by state, queue wait, worker restarts, free disk."""
    return Response(context.metrics.render(context.database, context.storage), media_type=CONTENT_TYPE)
