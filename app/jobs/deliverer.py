"""Tells subscribers of jobs: calls what `app.jobs.webhooks` has written, until it succeeds or is given up."""

from __future__ import annotations

import http.client
import logging
import random
import threading
from collections import Counter

from sqlalchemy import select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context
from app.jobs.calls import CALL_S, CONNECT_S, AllowedHosts, CallRefusedError, call, signature
from app.store.models import Delivery

RETRIES_S = (5, 300, 1800, 7200, 18000, 36000, 50400, 72000, 86400)
"""Pauses between the tries, as Standard Webhooks proposes; the last try is some three days after the first."""

_LOOK_S = 1.0
_AT_ONCE = 16
_AT_ONCE_PER_HOST = 4  # a host that answers slowly, or not at all, keeps only itself waiting
_HELD_S = 2 * (
    CONNECT_S + CALL_S
)  # how long a server may take over a call; after that, it is dead, and the call is made again
_GONE = 410

_log = logging.getLogger(__name__)


class Deliverer:
    """Makes the calls, from `start` to `stop`; several servers share them out through the database.

    A call that was made, but whose answer was not written before a kill, is made again with the same `webhook-id`.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        self._allowed = AllowedHosts(context.settings.webhook_hosts)
        self._at_work: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._changed = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="deliverer", daemon=True)

    def start(self) -> None:
        """Begin, in the background, where there are hosts that may be called."""
        if self._context.settings.webhook_hosts:
            self._thread.start()

    def stop(self) -> None:
        """Begin no further call."""
        self._stopping.set()
        self._changed.set()
        if self._thread.is_alive():
            self._thread.join(5)

    def _run(self) -> None:
        while not self._stopping.is_set():
            self._changed.clear()
            try:
                found = self._claim()
            except SQLAlchemyError as error:
                _log.warning("webhooks could not be looked for: %s", error)
                found = []
            for delivery in found:
                threading.Thread(target=self._deliver, args=(delivery,), name=delivery.id, daemon=True).start()
            if not found:
                self._changed.wait(_LOOK_S)

    def _claim(self) -> list[Delivery]:
        """Take calls that are due: they are held back from other servers for as long as one may take."""
        with self._lock:
            busy = Counter(self._at_work)
        room = _AT_ONCE - busy.total()
        full = [host for host, count in busy.items() if count >= _AT_ONCE_PER_HOST]
        query = select(Delivery).where(Delivery.next_at.is_not(None), Delivery.host.not_in(full))
        query = query.order_by(Delivery.next_at).limit(room)
        database = self._context.database
        if room <= 0:
            return []
        with database.reading() as session:
            if session.scalar(query.where(Delivery.next_at <= database.clock(session)).limit(1)) is None:
                return []
        with database.writing(patient=True) as session:
            now = database.clock(session)
            due = query.where(Delivery.next_at <= now)
            rows = session.scalars(due if database.is_sqlite else due.with_for_update(skip_locked=True)).all()
            taken = []
            for row in rows:
                if busy[row.host] < _AT_ONCE_PER_HOST:
                    busy[row.host] += 1
                    row.next_at = now + _HELD_S
                    row.attempts += 1
                    taken.append(row)
        with self._lock:
            self._at_work.update(row.host for row in taken)
        return taken

    def _deliver(self, delivery: Delivery) -> None:
        try:
            error = self._call(delivery)
            with self._context.database.writing(patient=True) as session:
                self._write(session, delivery, error)
            outcome = "delivered" if error is None else "failed"
            self._context.metrics.webhooks.labels(outcome).inc()
            extra = {"job": delivery.job_id}
            _log.info("webhook %s, try %d: %s", delivery.id, delivery.attempts, error or "delivered", extra=extra)
        except SQLAlchemyError as failure:  # it is made again when it is not held back any more
            _log.warning("webhook %s: its outcome could not be written: %s", delivery.id, failure)
        finally:
            with self._lock:
                self._at_work[delivery.host] -= 1
                self._at_work += Counter()
            self._changed.set()

    def _call(self, delivery: Delivery) -> str | None:
        """Make the call; return why it failed."""
        secret = self._context.settings.webhook_key
        with self._context.database.reading() as session:
            seconds = int(self._context.database.clock(session))
        body = delivery.body.encode()
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "InterLoc",
            "webhook-id": delivery.id,
            "webhook-timestamp": str(seconds),
            "webhook-signature": signature(secret, delivery.id, seconds, body),
        }
        try:
            status, told = call(delivery.uri, body, headers, self._allowed)
        except (OSError, http.client.HTTPException, CallRefusedError, UnicodeError) as error:
            return f"{type(error).__name__}: {error}"[:500]
        if 200 <= status < 300:
            return None
        return f"{status} {http.client.responses.get(status, '')}: {told}"[:500]

    def _write(self, session: Session, delivery: Delivery, error: str | None) -> None:
        now = self._context.database.clock(session)
        retries = RETRIES_S[: 0 if error is not None and error.startswith(f"{_GONE} ") else None]
        next_at = None
        if error is not None and delivery.attempts <= len(retries):
            next_at = now + retries[delivery.attempts - 1] * random.uniform(1.0, 1.1)  # noqa: S311 - not all at once
        values = {"next_at": next_at, "error": error, "delivered_at": now if error is None else None}
        session.execute(update(Delivery).where(Delivery.id == delivery.id).values(**values))
