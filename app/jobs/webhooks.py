"""Webhooks: who is told of a job, kept in the database until it is told.

A request names addresses (the `subscriber` of OGC API - Processes). What happens to the job is written as a row in the
same transaction, so that no kill comes in between; a `Deliverer` makes the calls, as Standard Webhooks says.
"""

import asyncio
import base64
import hashlib
import hmac
import json
import logging
import threading
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping
from datetime import datetime
from typing import Literal, TypedDict
from urllib.parse import urlsplit

import httpx
from pydantic import BaseModel, Field
from sqlalchemy import select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context, Helper
from app.http.problem_types import WEBHOOK_REFUSED
from app.http.problems import Problem
from app.settings import Settings
from app.states import JobState
from app.store.database import moment
from app.store.models import Delivery, Job, columns_for, new_id
from app.work.requests import StoredRequest, StoredSummary
from interloc.arrays import JsonObject

RETRIES_S = (5, 300)
"""Pauses after the first try and the second; the third is the last."""

_LOOK_S = 1.0
_CALL_S = 15.0  # for a call as a whole; after twice that time its server is taken for dead, and it is made again
_AT_ONCE_PER_HOST = 4  # a host that answers slowly, or not at all, keeps only itself waiting
_TOLD_BYTES = 200  # of an answer that is no success: what of it is kept

_log = logging.getLogger(__name__)

Uri = Field(None, max_length=2000, pattern=r"^https?://[!-~]+$", examples=["https://hooks.example.org/interloc"])


class Subscriber(BaseModel, extra="forbid", frozen=True):
    """Addresses that are called when something happens to the job, as in OGC API - Processes."""

    successUri: str | None = Uri
    failedUri: str | None = Uri
    inProgressUri: str | None = Uri


class Told(TypedDict):
    """What came of a job, for its subscriber."""

    summary: StoredSummary | None
    error: JsonObject | None


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


def check_subscriber(settings: Settings, subscriber: Subscriber | None) -> StoredRequest:
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
        if host not in settings.webhook_hosts:
            raise Problem(
                WEBHOOK_REFUSED,
                f"subscriber.{name}: {host!r} is none of the hosts that this service may call; its operator lists them "
                "in INTERLOC_WEBHOOK_HOSTS.",
            )
    return {"subscriber": wanted} if wanted else {}


def note(session: Session, job: Job, state: JobState, now: float, outcome: Told | None = None) -> None:
    """Write for a subscriber that a job enters a state, with its outcome, in the transaction in which it does."""
    subscriber = job.request.get("subscriber")
    if not subscriber:
        return
    is_good = state == JobState.SUCCESSFUL and ((outcome and outcome["summary"]) or {}).get("ok", True)
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
        **(outcome or {}),
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
    awaited = [job.id for job in jobs if job.request.get("subscriber")]
    if awaited:
        for row in session.scalars(select(Delivery).where(Delivery.job_id.in_(awaited)).order_by(Delivery.number)):
            found[row.job_id].append(_model(row))
    return found


def _model(row: Delivery) -> DeliveryModel:
    state: Literal["waiting", "delivered", "given up"] = "waiting"
    if row.next_at is None:
        state = "given up" if row.delivered_at is None else "delivered"
    return DeliveryModel(**columns_for(DeliveryModel, row), state=state)


class Deliverer(Helper):
    """Makes the calls; several servers share them out through the database.

    A call that was made, but whose answer was not written before a kill, is made again with the same `webhook-id`.
    """

    def __init__(self, context: Context) -> None:
        super().__init__("deliverer")
        self._context = context
        self._at_work: Counter[str] = Counter()
        """Number of calls under way by host."""
        self._lock = threading.Lock()

    def run(self) -> None:
        """Do so where there are hosts that may be called."""
        while self._context.settings.webhook_hosts and not self.stopping.is_set():
            try:
                delivery = self._claim()
            except SQLAlchemyError as error:
                _log.warning("webhooks could not be looked for: %s", error)
                delivery = None
            if delivery is None:
                self.stopping.wait(_LOOK_S)
            else:
                threading.Thread(target=self._deliver, args=(delivery,), name=delivery.id, daemon=True).start()

    def _claim(self) -> Delivery | None:
        """Take a call that is due: it is held back from other servers for as long as it may take."""
        database = self._context.database
        with self._lock:
            full = [host for host, count in self._at_work.items() if count >= _AT_ONCE_PER_HOST]
        due = select(Delivery).where(Delivery.host.not_in(full)).order_by(Delivery.next_at).limit(1)
        with database.reading() as session:
            if session.scalar(due.where(Delivery.next_at <= database.clock(session))) is None:
                return None
        with database.writing(patient=True) as session:
            now = database.clock(session)
            due = due.where(Delivery.next_at <= now)
            row = session.scalar(due if database.is_sqlite else due.with_for_update(skip_locked=True))
            if row is not None:
                row.next_at = now + 2 * _CALL_S
                with self._lock:
                    self._at_work[row.host] += 1
        return row

    def _deliver(self, delivery: Delivery) -> None:
        database = self._context.database
        try:
            with database.reading() as session:
                seconds = int(database.clock(session))
            error = asyncio.run(_call(delivery, self._context.settings, seconds))
            with database.writing(patient=True) as session:
                now = database.clock(session)
                is_last = error is None or delivery.attempts == len(RETRIES_S)
                next_at = None if is_last else now + RETRIES_S[delivery.attempts]
                attempts = delivery.attempts + 1  # one that a kill cut off is none: its outcome is not known
                values = {"next_at": next_at, "error": error, "delivered_at": now if error is None else None}
                session.execute(update(Delivery).where(Delivery.id == delivery.id).values(attempts=attempts, **values))
            self._context.metrics.webhooks.labels("delivered" if error is None else "failed").inc()
            extra = {"job": delivery.job_id}
            _log.info("webhook %s, try %d: %s", delivery.id, attempts, error or "delivered", extra=extra)
        except SQLAlchemyError as failure:  # it is made again when it is not held back any more
            _log.warning("webhook %s: its outcome could not be written: %s", delivery.id, failure)
        finally:
            with self._lock:
                self._at_work[delivery.host] -= 1


async def _call(delivery: Delivery, settings: Settings, seconds: int) -> str | None:
    """Send a message by POST, without redirects and proxies; return why that failed."""
    root = settings.public_url or settings.root_path
    body = delivery.body.replace('"href": "/', f'"href": "{root}/', 1).encode()
    headers = {
        "Content-Type": "application/json",
        "User-Agent": "InterLoc",
        "Accept-Encoding": "identity",
        "webhook-id": delivery.id,
        "webhook-timestamp": str(seconds),
        "webhook-signature": signature(settings.webhook_key, delivery.id, seconds, body),
    }
    try:
        async with (
            asyncio.timeout(_CALL_S),  # httpx limits each step alone: of a host that drips there are many
            httpx.AsyncClient(trust_env=False, timeout=None, headers=headers) as client,  # noqa: S113
            client.stream("POST", delivery.uri, content=body) as answer,
        ):
            if answer.is_success:
                return None
            body = await anext(answer.aiter_raw(_TOLD_BYTES), b"")  # as it came: what is packed may unpack to any size
            return f"{answer.status_code} {answer.reason_phrase}: {body.decode(errors='replace')}"[:500]
    except TimeoutError:
        return f"There was no answer within {_CALL_S:g} s."
    except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError) as error:
        return f"{type(error).__name__}: {error}"[:500]


def signature(secret: bytes, id_: str, seconds: int, body: bytes) -> str:
    """Return the header `webhook-signature` of Standard Webhooks."""
    signed = hmac.digest(secret, f"{id_}.{seconds}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(signed).decode()}"
