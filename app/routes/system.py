"""Endpoints: health, readiness, metrics."""

from __future__ import annotations

from typing import Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field
from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError

from app.context import Context, ContextDep
from app.http.problems import ProblemDocument
from app.jobs.runner import Runner, RunnerDep
from app.metrics import CONTENT_TYPE
from app.security import ClientDep
from app.store.models import Drive

router = APIRouter(tags=["System"])


class Health(BaseModel):
    """The process runs."""

    status: Literal["ok"] = "ok"


class Readiness(BaseModel):
    """Whether requests can be answered and jobs can be done."""

    ready: bool
    reasons: dict[str, str] = Field(
        description="What is wrong, by part; empty if nothing is.",
        examples=[{"disk": "0.4 GB free, 1.0 GB must stay free (INTERLOC_MIN_FREE_BYTES)"}],
    )


@router.get("/healthz", summary="Show that the process runs")
async def show_health() -> Health:
    """Answer without any check. For the probe that restarts a container that hangs."""
    return Health()


@router.get(
    "/readyz",
    summary="Show whether the service can work",
    responses={503: {"model": Readiness, "description": "It cannot; `reasons` lists why."}},
)
def show_readiness(context: ContextDep, runner: RunnerDep, response: Response) -> Readiness:
    """Check the database, the disk and the workers. For load balancers: they send no requests while this is 503."""
    reasons = {part: reason for part, reason in _ailments(context, runner).items() if reason is not None}
    if reasons:
        response.status_code = 503
    return Readiness(ready=not reasons, reasons=reasons)


@router.get(
    "/metrics",
    summary="Show figures for Prometheus",
    response_class=Response,
    responses={
        200: {"content": {"text/plain": {}}, "description": "Prometheus text format."},
        401: {"model": ProblemDocument, "description": "The service needs an API token."},
    },
)
def show_metrics(context: ContextDep, _client: ClientDep) -> Response:
    """Show requests, uploads, jobs by state, queue wait, time of the stages, worker restarts, free disk."""
    return Response(context.metrics.render(context.database, context.storage), media_type=CONTENT_TYPE)


def _ailments(context: Context, runner: Runner) -> dict[str, str | None]:
    return {
        "server": "it is being stopped" if context.stopping.is_set() else None,
        "database": _ailment_of_database(context),
        "disk": _ailment_of_disk(context),
        "workers": runner.ailment(),
    }


def _ailment_of_database(context: Context) -> str | None:
    try:
        with context.database.reading() as session:
            session.execute(select(Drive.id).limit(1))
    except SQLAlchemyError as error:
        return f"it does not answer ({type(error).__name__})"
    return None


def _ailment_of_disk(context: Context) -> str | None:
    floor = context.settings.min_free_bytes
    try:
        free = context.storage.free_bytes()
    except OSError as error:
        return f"the data folder cannot be reached ({error.strerror})"
    if free >= floor:
        return None
    return f"{free / 1e9:.1f} GB free, {floor / 1e9:.1f} GB must stay free (INTERLOC_MIN_FREE_BYTES)"
