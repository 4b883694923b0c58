"""Metrics for Prometheus: requests are counted when they end; jobs and drives are counted in the database on demand."""

from collections.abc import Iterable, Iterator
from functools import partial

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric, SummaryMetricFamily
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.states import JobState
from app.store.database import Database
from app.store.models import Drive, Job
from app.store.storage import Storage

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

_BUCKETS_S = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60, 300)


class Metrics:
    """What one server counts; a registry of its own, so that several can live in one process."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        counter = partial(Counter, registry=self.registry)
        self._requests = counter("interloc_http_requests", "Requests answered.", ("method", "route", "status"))
        self._seconds = Histogram(
            "interloc_http_request_seconds",
            "Time to answer; streams of events are left out.",
            ("method", "route"),
            buckets=_BUCKETS_S,
            registry=self.registry,
        )
        self._received = counter("interloc_received_bytes", "Bodies of requests: uploads.")
        self.listeners = Gauge("interloc_event_listeners", "Streams of events that are open.", registry=self.registry)
        self.worker_restarts = counter("interloc_worker_restarts", "Worker processes that died and were replaced.")
        self.webhooks = counter("interloc_webhooks", "Calls of subscribers, by outcome.", ("outcome",))
        refused = "Requests refused for their token: unknown, expired, read only."
        self.refused_tokens = counter("interloc_refused_tokens", refused, ("reason",))

    def count_request(
        self, method: str, route: str, status: int, *, seconds: float | None, received_bytes: int
    ) -> None:
        """Count a request that has ended."""
        known = method if method in {"GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH"} else "other"
        self._requests.labels(known, route, str(status)).inc()
        if seconds is not None:
            self._seconds.labels(known, route).observe(seconds)
        self._received.inc(received_bytes)

    def render(self, database: Database, storage: Storage) -> bytes:
        """Return all of it in the text format of Prometheus."""
        return generate_latest(self.registry) + generate_latest(_StateRegistry(database, storage))


class _StateRegistry(CollectorRegistry):
    """Metrics of the database and the disk at this moment."""

    def __init__(self, database: Database, storage: Storage) -> None:
        super().__init__()
        self._database = database
        self._storage = storage

    def collect(self) -> Iterable[Metric]:
        """Read it."""
        yield GaugeMetricFamily("interloc_free_bytes", "Space left where drives are kept.", self._storage.free_bytes())
        given_up = CounterMetricFamily("interloc_database_busy", "Writers that did not get their turn in time.")
        given_up.add_metric([], self._database.given_up)
        yield given_up
        with self._database.reading() as session:
            now = self._database.clock(session)
            yield from _drives(session)
            yield from _jobs(session, now)


def _drives(session: Session) -> Iterator[Metric]:
    drives = GaugeMetricFamily("interloc_drives", "Drives by state.", labels=["state"])
    stored = GaugeMetricFamily("interloc_stored_bytes", "Bytes kept on disk of drives, by state.", labels=["state"])
    query = select(Drive.state, func.count(), func.coalesce(func.sum(Drive.stored_bytes), 0)).group_by(Drive.state)
    query = query.where(Drive.deleted_at.is_(None))
    for state, count, size in session.execute(query):
        drives.add_metric([state], count)
        stored.add_metric([state], float(size))
    yield drives
    yield stored
    trash = session.scalar(select(func.coalesce(func.sum(Drive.stored_bytes), 0)).where(Drive.deleted_at.is_not(None)))
    yield GaugeMetricFamily("interloc_trash_bytes", "Bytes kept on disk of drives in the trash.", float(trash or 0))


def _jobs(session: Session, now: float) -> Iterator[Metric]:
    jobs = GaugeMetricFamily("interloc_jobs", "Jobs by kind and state.", labels=["kind", "state"])
    for kind, state, count in session.execute(select(Job.kind, Job.state, func.count()).group_by(Job.kind, Job.state)):
        jobs.add_metric([kind, state], count)
    yield jobs

    oldest = session.scalar(select(func.min(Job.created_at)).where(Job.state == JobState.ACCEPTED))
    yield GaugeMetricFamily(
        "interloc_oldest_waiting_job_seconds", "Age of the job that waits longest.", now - (oldest or now)
    )

    waited = "Time from submission to start, of the jobs that are kept."
    worked = "Time from start to end, of the jobs that are kept."
    for name, text, columns, spent in (
        ("interloc_queue_wait_seconds", waited, [Job.kind], Job.started_at - Job.created_at),
        ("interloc_job_seconds", worked, [Job.kind, Job.state], Job.finished_at - Job.started_at),
    ):
        times = SummaryMetricFamily(name, text, labels=[column.key for column in columns])
        query = select(*columns, func.count(), func.sum(spent)).where(spent.is_not(None)).group_by(*columns)
        for *labels, count, seconds in session.execute(query):
            times.add_metric(labels, count_value=count, sum_value=seconds or 0.0)
        yield times
