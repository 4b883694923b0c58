"""Jobs as clients see them, and their changes: a few queries per second, however many listeners there are."""

import asyncio
import logging
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterable
from functools import cache
from typing import Annotated

from fastapi.concurrency import run_in_threadpool
from sqlalchemy import ColumnElement, Select, and_, bindparam, case, func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.context import Context, part_of_app
from app.http.parameters import newest_first
from app.http.problem_types import JOB_NOT_FOUND
from app.http.problems import Problem, ProblemDocument, stored
from app.jobs.models import JobModel, Progress
from app.jobs.webhooks import deliveries_of
from app.states import FINAL, JobKind, JobState
from app.store.database import Database
from app.store.models import Drive, Job, columns_for
from app.work.requests import StoredRequest
from interloc.arrays import JsonObject
from interloc.config import GONE, PRESETS, flatten
from interloc.output.layers import LAYERS
from interloc.output.layout import BUILDINGS, MAP_LAYERS, PLACES, ROAD_LAYERS

_LAYERS = [layer.name for layer in LAYERS.values() if not layer.is_osm]
_MAP_LAYERS = [layer for layer in MAP_LAYERS if layer not in {BUILDINGS, PLACES}]  # which not all have
_OTHER_KINDS = {JobKind.COMMIT: "check", JobKind.UNPACK: "archive", JobKind.DEMO: "demo drive"}
_STEADY_S, _STEADY_SHARE = 5.0, 0.05  # the beginning tells nothing: drive and map are read first
_POLL_S = 0.5
_FIRST_LOOK_S, _LAST_LOOK_S = 0.05, 0.5
_NO_WORKER = "It waits for a worker: there is none at present. The service keeps trying; /readyz or its log says why."

_log = logging.getLogger(__name__)


def is_alive() -> ColumnElement[bool]:
    """Return the condition that a job is not deleted, nor its drive, joined."""
    return and_(Job.deleted_at.is_(None), Drive.deleted_at.is_(None))


# Made once: that takes as long as the reading.
_JOB = select(Job, Drive.name).join(Drive, Drive.id == Job.drive_id).where(Job.id == bindparam("id"), is_alive())


def find_job(session: Session, job_id: str) -> tuple[Job, str]:
    """Return a job (404 where there is none) and the name of its drive."""
    found = session.execute(_JOB, {"id": job_id}).one_or_none()
    if found is None:
        raise no_job(job_id)
    return found[0], found[1]


def no_job(job_id: str) -> Problem:
    """Return the problem of a job that does not exist."""
    return Problem(JOB_NOT_FOUND, f"There is no job {job_id}. GET /api/v1/jobs lists them.")


def chosen_results(*conditions: ColumnElement[bool]) -> Select[Job]:
    """Return the query for the job that stands for each drive that has a successful one; nothing deleted counts.

    The one that somebody has pinned; else the best by the map: one with the settings of this version before one with
    those of the paper, then the highest F1 of its intersections, then the newest. One that was not scored comes last.
    Conditions on `Drive` and `Job` say which come into question.
    """
    is_pinned = case((Drive.pinned_job == Job.id, 0), else_=1)
    asked = Job.request
    preset = func.coalesce(asked["preset"].as_string(), asked["config"]["preset"].as_string())
    is_paper = case((preset == "paper", 1), else_=0)
    report = Job.summary["report"]
    f1 = func.coalesce(report["map_f1"].as_float(), report["f1_at_5"].as_float(), -1.0)  # older ones have the second
    place = func.row_number().over(
        partition_by=Job.drive_id, order_by=(is_pinned, is_paper, f1.desc(), *newest_first(Job))
    )
    is_result = (Job.kind == JobKind.INTERSECTIONS, Job.state == JobState.SUCCESSFUL, is_alive())
    ranked = select(Job.id, place.label("place")).join(Drive, Drive.id == Job.drive_id).where(*is_result, *conditions)
    found = ranked.subquery()
    return select(Job).join(found, found.c.id == Job.id).where(found.c.place == 1)


def job_models(session: Session, context: Context, rows: Iterable[tuple[Job, str]]) -> list[JobModel]:
    """Return jobs as clients see them, given with the names of their drives."""
    rows = list(rows)
    now = context.database.clock(session)
    no_worker = _NO_WORKER if context.lacks_workers.is_set() else None
    deliveries = deliveries_of(session, [job for job, _ in rows])
    return [
        JobModel(
            **columns_for(JobModel, job, but=("message", "error")),
            drive_name=drive_name,
            own_settings=(own := own_settings(job.request)),
            title=title_of(job, own),
            message=job.message or (no_worker if job.state == JobState.ACCEPTED else None),
            progress=_progress(job, now),
            error=job.error and ProblemDocument.model_validate(job.error | stored(job.error).document()),
            links=_links_of(job, context.settings.root_path),
            deliveries=deliveries.get(job.id, []),
        )
        for job, drive_name in rows
    ]


def title_of(job: Job, own: JsonObject) -> str:
    """Return what a job is called: by its name, else by its preset, what it was scored against, its own settings."""
    if job.kind != JobKind.INTERSECTIONS:
        return job.name or _OTHER_KINDS.get(JobKind(job.kind), job.kind)
    against = job.request.get("policy", "drive") if job.request.get("osm") else "no map"
    changed = f", {len(own)} changed" if own else ""
    return job.name or f"{_preset_of(job.request)}, {against}{changed}"


def own_settings(request: StoredRequest) -> JsonObject:
    """Return the settings of a request that differ from its preset, by their dotted names."""
    usual = _settings_of(_preset_of(request))
    own = [each for each in flatten(request.get("config") or {}) if each[0] != "preset" and each[0] not in GONE]
    return {name: value for name, value in own if name not in usual or usual[name] != value}


def _preset_of(request: StoredRequest) -> str:
    return str(request.get("preset") or (request.get("config") or {}).get("preset") or "default")


@cache
def _settings_of(preset: str) -> JsonObject:
    return dict(flatten(PRESETS[preset].model_dump(mode="json"))) if preset in PRESETS else {}


def _progress(job: Job, now: float) -> Progress:
    fraction = 1.0 if job.state == JobState.SUCCESSFUL else min(1.0, job.done / job.total) if job.total else 0.0
    left = None
    if job.state == JobState.RUNNING and job.started_at is not None and fraction < 1.0:
        spent_s = max(0.0, now - job.started_at)
        if spent_s >= _STEADY_S and fraction >= _STEADY_SHARE:
            left = round(spent_s * (1 / fraction - 1), 1)
    return Progress(done=job.done, total=job.total, fraction=round(fraction, 4), seconds_left=left)


def _links_of(job: Job, root_path: str) -> dict[str, str]:
    """Return the addresses of a job and of the parts of its result by name, below the path of the service."""
    address = f"{root_path}/api/v1/jobs/{job.id}"
    links = {"self": address, "events": f"{address}/events"}
    summary = job.summary
    if job.state != JobState.SUCCESSFUL or job.kind != JobKind.INTERSECTIONS or summary is None:
        return links
    links["run"] = f"{address}/files/run.json"
    names = ["files", "archive.zip", "export"]
    layers = [name for name in _LAYERS if summary.get("has_roads") or name not in ROAD_LAYERS]
    if not summary["georeferenced"]:
        links |= {layer: f"{address}/files/{layer}.local.json" for layer in layers}
        layers = []
    if summary["report"] is not None:
        names.append("report")
        layers += _MAP_LAYERS
    if summary.get("location") is not None:
        layers.append(PLACES)
    links |= {layer: f"{address}/layers/{layer}" for layer in layers}
    return links | {name: f"{address}/{name}" for name in names}


class JobWatcher:
    """Reports the changes of jobs; to be used in the event loop. All who follow jobs share one look at the database."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._followed: Counter[str] = Counter()
        self._latest: dict[str, JobModel | None] = {}
        """Of the jobs that are followed; None: it was removed."""
        self._look: asyncio.Task[None] | None = None

    async def follow(self, last: JobModel) -> AsyncIterator[JobModel]:
        """Yield a job after each further change, until it has ended, is deleted, or the server stops."""
        job_id = last.id
        self._followed[job_id] += 1
        try:
            while not (last.state in FINAL or self._context.stopping.is_set()):
                if self._look is None or self._look.done():
                    self._look = asyncio.create_task(self._look_again())
                await asyncio.shield(self._look)
                job = self._latest.get(job_id, last)
                if job is None:
                    return
                if job.version >= last.version and (job.version, job.message) != (last.version, last.message):
                    last = job  # its message changes without itself where all workers are lost
                    yield job
        finally:
            self._followed[job_id] -= 1
            if not self._followed[job_id]:
                del self._followed[job_id]
                self._latest.pop(job_id, None)

    async def _look_again(self) -> None:
        """Take note of what has changed after a moment."""
        await asyncio.sleep(_POLL_S)
        latest = {job_id: self._latest.get(job_id) for job_id in self._followed}
        known = {job_id: None if job is None else job.version for job_id, job in latest.items()}
        try:
            changes = await run_in_threadpool(_changes, self._context, known)
        except SQLAlchemyError as error:  # the next look finds them all
            _log.warning("changes of jobs could not be read: %s", error)
            return
        self._latest |= {job_id: job for job_id, job in changes.items() if job_id in self._followed}


def _changes(context: Context, followed: dict[str, int | None]) -> dict[str, JobModel | None]:
    """Return the jobs whose version is another one, and those that wait; None for those that were removed."""
    alive = select(Job, Drive.name).join(Drive, Drive.id == Job.drive_id).where(is_alive())
    with context.database.reading() as session:
        rows = session.execute(
            alive.with_only_columns(Job.id, Job.version, Job.state).where(Job.id.in_(list(followed)))
        ).all()
        changed = [row.id for row in rows if row.version != followed[row.id] or row.state == JobState.ACCEPTED]
        found = session.execute(alive.where(Job.id.in_(changed))).all() if changed else []
        models = job_models(session, context, [(job, name) for job, name in found])
    gone: dict[str, JobModel | None] = dict.fromkeys(followed.keys() - {row.id for row in rows})
    return gone | {model.id: model for model in models}


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
