"""Jobs as clients see them."""

from __future__ import annotations

from collections.abc import Iterable

from sqlalchemy import ColumnElement, and_, select
from sqlalchemy.orm import Session

from app.context import Context
from app.http.problem_types import JOB_NOT_FOUND
from app.http.problems import Problem, ProblemDocument, stored
from app.jobs.models import JobModel, Progress
from app.jobs.outlook import outlook, seconds_left
from app.jobs.titles import own_settings, title_of
from app.jobs.webhooks import deliveries_of
from app.states import JobKind, JobState
from app.store.models import Drive, Job, columns_for
from interloc.output.layers import LAYERS, PLACES
from interloc.output.layout import ROAD_LAYERS
from interloc.output.vector_files import suffixes_here

_LAYERS = [layer.address for layer in LAYERS.values() if not layer.is_osm]
_ROADS = tuple(LAYERS[name].address for name in ROAD_LAYERS)
_MAP_LAYERS = [layer.address for layer in LAYERS.values() if layer.is_osm and layer.name != PLACES]
_NO_WORKER = "It waits for a worker: none can be started at present. The service keeps trying; its log says why."


def find_job(session: Session, job_id: str) -> tuple[Job, str]:
    """Return a job (404 where there is none) and the name of its drive."""
    found = session.execute(
        select(Job, Drive.name).join(Drive, Drive.id == Job.drive_id).where(Job.id == job_id, is_alive())
    ).one_or_none()
    if found is None:
        raise no_job(job_id)
    return found[0], found[1]


def is_alive() -> ColumnElement[bool]:
    """Return the condition that neither a job nor its drive, joined, is in the trash."""
    return and_(Job.deleted_at.is_(None), Drive.deleted_at.is_(None))


def no_job(job_id: str) -> Problem:
    """Return the problem of a job that does not exist."""
    return Problem(JOB_NOT_FOUND, f"There is no job {job_id}. GET /api/v1/jobs lists them.")


def job_models(session: Session, context: Context, rows: Iterable[tuple[Job, str]]) -> list[JobModel]:
    """Return jobs as clients see them, given with the names of their drives."""
    rows = list(rows)
    now = context.database.clock(session)
    waiting = [job for job, _ in rows if job.state == JobState.ACCEPTED and job.message is None]
    if context.lacks_workers.is_set():
        told = dict.fromkeys((job.id for job in waiting), _NO_WORKER)
    else:
        told = outlook(session, now, context.settings.jobs_at_once) if waiting else {}
    links = _Links(context.settings.root_path)
    deliveries = deliveries_of(session, [job for job, _ in rows])
    models = [_job_model(job, name, links, now, job.message or told.get(job.id)) for job, name in rows]
    return [model.model_copy(update={"deliveries": deliveries.get(model.id, [])}) for model in models]


def _job_model(job: Job, drive_name: str, links: _Links, now: float, message: str | None) -> JobModel:
    error = None if job.error is None else ProblemDocument.model_validate(job.error | stored(job.error).document())
    return JobModel(
        **columns_for(JobModel, job, but=("message", "error")),
        drive_name=drive_name,
        title=title_of(job),
        own_settings=own_settings(job.request),
        message=message,
        progress=_progress(job, now),
        error=error,
        links=links.of(job),
    )


def _progress(job: Job, now: float) -> Progress:
    fraction = 1.0 if job.state == JobState.SUCCESSFUL else min(1.0, job.done / job.total) if job.total else 0.0
    left = None
    if job.state == JobState.RUNNING and job.started_at is not None and fraction < 1.0:
        left = seconds_left(now - job.started_at, job.done, job.total)
    left = None if left is None else round(left, 1)
    return Progress(done=job.done, total=job.total, fraction=round(fraction, 4), seconds_left=left)


class _Links:
    """Addresses of jobs and of the parts of their results, below the path under which the service is shown."""

    def __init__(self, root_path: str) -> None:
        self._jobs = f"{root_path}/api/v1/jobs"
        self._georeferenced = [*_LAYERS, *(f"export{suffix}" for suffix in (*suffixes_here(), ".qgs"))]

    def of(self, job: Job) -> dict[str, str]:
        """Return the addresses of a job by name."""
        address = f"{self._jobs}/{job.id}"
        links = {"self": address, "events": f"{address}/events"}
        summary = job.summary
        if job.state != JobState.SUCCESSFUL or job.kind != JobKind.INTERSECTIONS or summary is None:
            return links
        names = ["run", "files", "archive.zip"]
        left_out = () if summary.get("has_roads") else _ROADS
        if summary["georeferenced"]:
            names += [name for name in self._georeferenced if name not in left_out]
        else:
            links |= {layer: f"{address}/files/{layer}.local.json" for layer in _LAYERS if layer not in left_out}
        if summary["report"] is not None:
            names += ["report", *_MAP_LAYERS]
        if summary.get("location") is not None:
            names += [PLACES]
        return links | {name: f"{address}/{name}" for name in names}
