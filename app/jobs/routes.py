"""Endpoints: jobs."""

from collections.abc import AsyncIterator
from typing import Annotated, Literal

from fastapi import Depends, Header, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.sse import EventSourceResponse, ServerSentEvent
from sqlalchemy import or_, select

from app.context import ContextDep
from app.http.delivery import answer_tagged, tag_of
from app.http.fields import ID
from app.http.gate import ClientDep
from app.http.headers import IdempotencyKey, WaitIfAsked
from app.http.openapi import Responses
from app.http.parameters import After, NamePart, answer_page, cursor_of, has_part, newest_first, rows_after
from app.http.prices import priced
from app.http.routing import ApiRouter
from app.jobs.models import JobChanges, JobList, JobModel, NewJob, PresetList, PresetModel
from app.jobs.submission import submit_job
from app.jobs.view import WatcherDep, find_job, is_alive, job_models, wait_for_job
from app.states import FINAL, JobKind, JobState
from app.store.models import Drive, Job
from interloc.config import PRESETS, DetectorConfig

router = ApiRouter(tags=["Jobs"])

JobId = Annotated[str, Path(pattern=ID, description="Id of the job, from POST /api/v1/jobs.")]


@router.post(
    "/jobs",
    status_code=202,
    summary="Start a job",
    responses={
        200: {
            "model": JobModel,
            "description": "The job has ended within the time of Prefer; or the job that this key has made before.",
        }
    },
)
@priced("cheap")
async def create_job(
    new: NewJob,
    response: Response,
    context: ContextDep,
    client: ClientDep,
    wait_s: WaitIfAsked,
    key: IdempotencyKey = None,
) -> JobModel:
    """Find the intersections of a drive, and score them where a map is given.

    The job waits in a queue, and survives restarts of the service. Follow its events, ask for it from time to time,
    or wait for its end right here with `Prefer: wait=SECONDS`. A job of a drive whose check still runs waits for it.
    """
    model, is_new = await run_in_threadpool(submit_job, context, client, new, key)
    if wait_s and model.state not in FINAL:
        await wait_for_job(context, model.id, wait_s)
        model = await run_in_threadpool(load_job, model.id, context)
    response.status_code = 202 if is_new and model.state not in FINAL else 200
    response.headers["Location"] = model.links["self"]
    return model


@router.get_and_head("/jobs", response_model=JobList, summary="List jobs")
@priced("cheap")
def list_jobs(
    request: Request,
    context: ContextDep,
    drive: Annotated[str | None, Query(pattern=ID, description="Only those of this drive.")] = None,
    state: Annotated[JobState | None, Query(description="Only those in this state.")] = None,
    kind: Annotated[
        JobKind | Literal["all"],
        Query(description="Only those of this kind; commit and unpack are the checks of uploads."),
    ] = JobKind.INTERSECTIONS,
    name: NamePart = None,
    after: After = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List jobs, the newest first; `name` is looked for in the names of jobs and of their drives."""
    query = select(Job, Drive.name).join(Drive, Drive.id == Job.drive_id).where(is_alive())
    query = query.order_by(*newest_first(Job)).limit(limit + 1)
    if kind != "all":
        query = query.where(Job.kind == kind)
    if drive is not None:
        query = query.where(Job.drive_id == drive)
    if state is not None:
        query = query.where(Job.state == state)
    if name is not None:
        query = query.where(or_(has_part(Drive.name, name), has_part(Job.name, name)))
    if after is not None:
        query = query.where(rows_after(Job, after))
    with context.database.reading() as session:
        rows = [(job, drive_name) for job, drive_name in session.execute(query)]
        jobs = job_models(session, context, rows[:limit])
    page = JobList(jobs=jobs, next=cursor_of(rows[limit - 1][0]) if len(rows) > limit else None)
    return answer_page(request, page)


def load_job(job_id: JobId, context: ContextDep) -> JobModel:
    """Return a job as clients see it."""
    with context.database.reading() as session:
        (model,) = job_models(session, context, [find_job(session, job_id)])
    return model


@router.get_and_head("/jobs/{job_id}", response_model=JobModel, summary="Show a job")
@priced("cheap")
def show_job(request: Request, job: Annotated[JobModel, Depends(load_job)]) -> Response:
    """Show the progress of a job, why it failed, or what it found and the addresses of its results."""
    return answer_tagged(request, job.model_dump_json().encode())


_EXAMPLE = 'event: job\nid: 7\ndata: {"id": "9b1e44f00c7a2d53", "state": "running", "version": 7}\n\n'
_EVENTS: Responses = {
    200: {"description": "The stream of events.", "content": {"text/event-stream": {"schema": {}, "example": _EXAMPLE}}}
}


@router.get("/jobs/{job_id}/events", response_class=EventSourceResponse, responses=_EVENTS, summary="Follow a job")
@priced("streaming")
async def follow_job(
    job: Annotated[JobModel, Depends(load_job)],
    request: Request,
    context: ContextDep,
    watcher: WatcherDep,
    last_event_id: Annotated[
        str | None, Header(max_length=40, description="Id of the last event that arrived; it is not sent again.")
    ] = None,
) -> AsyncIterator[ServerSentEvent]:
    """Send the job as it is now, then after each change, until it has ended (server-sent events).

    Each event is named `job`; its data is the job as JSON, its id the number of changes. Comments keep the connection
    open meanwhile. After a broken connection go on with `Last-Event-ID`, as browsers do. The stream ends when its token
    is revoked.
    """
    with context.metrics.listeners.track_inprogress():
        if job.state in FINAL or last_event_id != str(job.version):
            yield _event(job)
        async for changed in watcher.follow(job):
            if not await run_in_threadpool(context.tokens.still_holds, request.state.holder):
                return
            yield _event(changed)


def _event(job: JobModel) -> ServerSentEvent:
    return ServerSentEvent(event="job", id=str(job.version), raw_data=job.model_dump_json())


@router.patch("/jobs/{job_id}", response_model=JobModel, summary="Rename a job, or note something about it")
@priced("cheap")
def change_job(job_id: JobId, changes: JobChanges, context: ContextDep) -> Response:
    """Change the name or the note of a job, in whatever state it is; what is left out stays as it is.

    Its request keeps the name that it was sent with, so that the same Idempotency-Key still finds it.
    """
    with context.database.writing() as session:
        job, drive_name = find_job(session, job_id)
        session.refresh(job, with_for_update=True)
        values = changes.model_dump(exclude_unset=True)
        if any(getattr(job, name) != value for name, value in values.items()):
            job.version += 1
        for name, value in values.items():
            setattr(job, name, value)
        (model,) = job_models(session, context, [(job, drive_name)])
        content = model.model_dump_json().encode()
    return Response(content, headers={"ETag": tag_of(content)}, media_type="application/json")


_PRESET_MEANINGS = {
    "default": "The best settings of this version.",
    "paper": "Exactly the method of the paper with the parameters of its Table I, as a reference.",
}


@router.get_and_head("/presets", response_model=PresetList, summary="List presets")
@priced("cheap", bound="the presets of the method")
def list_presets(request: Request) -> Response:
    """List the settings to start from, with the JSON schema of all settings, for a form."""
    presets = [
        PresetModel(name=name, description=_PRESET_MEANINGS[name], config=config) for name, config in PRESETS.items()
    ]
    return answer_page(request, PresetList(presets=presets, config_schema=DetectorConfig.model_json_schema()))
