"""Webhooks: who is told of a job, kept in the database until it is told.

A request names addresses (the `subscriber` of OGC API - Processes). What happens to the job is written as a row in the
same transaction, so that no kill comes in between; `app.jobs.deliverer` makes the calls, as Standard Webhooks says.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Mapping
from datetime import datetime
from typing import Any, Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import select
from sqlalchemy.orm import Session

from app.http.problem_types import WEBHOOK_REFUSED
from app.http.problems import Problem
from app.settings import Settings
from app.states import JobState
from app.store.database import moment
from app.store.models import Delivery, Job, columns_for, new_id

Uri = Field(None, max_length=2000, pattern=r"^https?://[!-~]+$", examples=["https://hooks.example.org/interloc"])


class Subscriber(BaseModel):
    """Addresses that are called when something happens to the job, as in OGC API - Processes."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    successUri: str | None = Uri
    failedUri: str | None = Uri
    inProgressUri: str | None = Uri


class DeliveryModel(BaseModel):
    """What a subscriber was told, or will be."""

    id: str = Field(description="`webhook-id` of its calls, the same at each try.")
    type: str = Field(examples=["job.successful"])
    uri: str
    state: Literal["waiting", "delivered", "given up"]
    attempts: int
    error: str | None = Field(description="Why the last try failed.")
    next_at: datetime | None = Field(description="When it is tried next.")
    delivered_at: datetime | None


def check_subscriber(settings: Settings, subscriber: Subscriber | None) -> dict[str, Any]:
    """Return the member of a request that is stored, empty where nobody is to be told; a 422 if it is refused."""
    wanted = {} if subscriber is None else subscriber.model_dump(exclude_none=True)
    for name, uri in wanted.items():
        try:
            parts = urlsplit(uri)
            host, _port = parts.hostname or "", parts.port
        except ValueError as error:
            raise Problem(WEBHOOK_REFUSED, f"subscriber.{name}: {uri!r} is not an address ({error}).") from error
        if "@" in parts.netloc:
            raise Problem(
                WEBHOOK_REFUSED,
                f"subscriber.{name}: {uri!r} is not an address as https://hooks.example.org/path, without a user.",
            )
        if host not in settings.listed_webhook_hosts:
            raise Problem(
                WEBHOOK_REFUSED,
                f"subscriber.{name}: {host!r} is none of the hosts that this service may call; its operator lists them "
                "in INTERLOC_WEBHOOK_HOSTS.",
            )
    return {"subscriber": wanted} if wanted else {}


def note(session: Session, job: Job, state: JobState, now: float, **facts: Any) -> None:  # noqa: ANN401
    """Write for a subscriber that a job enters a state, with its outcome, in the transaction in which it does."""
    subscriber = job.request.get("subscriber")
    if not subscriber:
        return
    is_good = state == JobState.SUCCESSFUL and (facts.get("summary") or {}).get("ok", True)
    name = "inProgressUri" if state == JobState.RUNNING else "successUri" if is_good else "failedUri"
    if (uri := subscriber.get(name)) is None:
        return
    data = {
        "job_id": job.id,
        "kind": job.kind,
        "drive_id": job.drive_id,
        "name": job.name,
        "state": state,
        "href": f"/api/v1/jobs/{job.id}",
        **facts,
    }
    type_ = f"job.{state}"
    body = {"type": type_, "timestamp": moment(now).isoformat(), "data": data}
    session.add(
        Delivery(
            id=f"msg_{new_id()}{new_id()}",
            job_id=job.id,
            type=type_,
            uri=uri,
            host=str(urlsplit(uri).hostname),
            body=json.dumps(body),
            next_at=now,
        )
    )


def deliveries_of(session: Session, jobs: Collection[Job]) -> Mapping[str, list[DeliveryModel]]:
    """Return what was and will be told of jobs, by their ids."""
    found: defaultdict[str, list[DeliveryModel]] = defaultdict(list)
    told = [job.id for job in jobs if job.request.get("subscriber")]
    if told:
        for row in session.scalars(select(Delivery).where(Delivery.job_id.in_(told)).order_by(Delivery.number)):
            found[row.job_id].append(_model(row))
    return found


def _model(row: Delivery) -> DeliveryModel:
    state: Literal["waiting", "delivered", "given up"] = "waiting"
    if row.next_at is None:
        state = "given up" if row.delivered_at is None else "delivered"
    return DeliveryModel(**columns_for(DeliveryModel, row), state=state)
