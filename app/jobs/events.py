"""Endpoint for the changes of a job as they happen."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header
from fastapi.sse import EventSourceResponse, ServerSentEvent

from app.context import ContextDep
from app.jobs.models import JobModel
from app.jobs.routes import NOT_FOUND, load_job
from app.jobs.watcher import Change, WatcherDep

router = APIRouter(tags=["Jobs"])

_EXAMPLE = 'event: job\nid: 7\ndata: {"id": "9b1e44f00c7a2d53", "state": "running", "version": 7}\n\n'


_EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The stream of events.",
        "content": {"text/event-stream": {"schema": {}, "example": _EXAMPLE}},
    },
    **NOT_FOUND,
}


@router.get("/jobs/{job_id}/events", response_class=EventSourceResponse, responses=_EVENTS, summary="Follow a job")
async def follow_job(
    job: Annotated[JobModel, Depends(load_job)],
    context: ContextDep,
    watcher: WatcherDep,
    last_event_id: Annotated[
        str | None, Header(max_length=40, description="Id of the last event that arrived; it is not sent again.")
    ] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Send the job as it is now, then after each change, until it has ended (server-sent events).

    Each event is named `job`; its data is the job as JSON, its id the number of changes. Comments keep the connection
    open meanwhile. After a broken connection go on with `Last-Event-ID`, as browsers do.
    """
    current = Change.of(job)
    with context.metrics.listeners.track_inprogress():
        if current.is_final or last_event_id != str(current.version):
            yield _event(current)
        if current.is_final:
            return
        async for change in watcher.follow(job.id, current):
            yield _event(change)


def _event(change: Change) -> ServerSentEvent:
    return ServerSentEvent(event="job", id=str(change.version), raw_data=change.data)
