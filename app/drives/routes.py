"""Endpoints: drives, looks at folders that may become some, and commits."""

from typing import Annotated

from fastapi import Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from sqlalchemy.orm import Session

from app.context import Context, ContextDep
from app.drives import records
from app.drives.commit import begin_commit, committed
from app.drives.models import CommitRequest, DriveChanges, DriveList, DriveModel, LookRequest, NewDrive
from app.drives.work.look import look
from app.http.delivery import WholeFile, answer_tagged, deliver, tag_of
from app.http.fields import ID
from app.http.gate import ClientDep
from app.http.headers import IdempotencyKey, WaitSeconds
from app.http.openapi import CHANGES_NOTHING
from app.http.parameters import After, NamePart, answer_page, has_part
from app.http.prices import priced
from app.http.routing import API, ApiRouter
from app.jobs.runner import RunnerDep
from app.jobs.view import wait_for_job
from app.states import DriveState
from app.store.models import Drive
from app.work.requests import UploadOptions
from app.work.task import WorkSettings

router = ApiRouter(f"{API}/drives")

DriveId = Annotated[str, Path(description="Id of the drive, from POST /api/v1/drives.", pattern=ID)]


@router.post(
    "",
    tags=["Drives"],
    status_code=201,
    summary="Make a drive",
    responses={200: {"model": DriveModel, "description": "The key was sent before: the drive of that request."}},
)
@priced("cheap")
def create_drive(
    new: NewDrive, response: Response, context: ContextDep, client: ClientDep, key: IdempotencyKey = None
) -> DriveModel:
    """Make a drive without files. Send its files next, then commit it."""
    drive, is_new = records.create_drive(context, client, new, key)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = f"{context.settings.root_path}/api/v1/drives/{drive.id}"
    return drive


@router.get_and_head("", tags=["Drives"], response_model=DriveList, summary="List drives")
@priced("cheap")
def list_drives(
    request: Request,
    context: ContextDep,
    state: Annotated[DriveState | None, Query(description="Only those in this state.")] = None,
    name: NamePart = None,
    after: After = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List drives, the newest first, without their reports."""
    conditions = []
    if state is not None:
        conditions.append(Drive.state == state)
    if name is not None:
        conditions.append(has_part(Drive.name, name))
    page = records.list_drives(context, after, limit, conditions)
    return answer_page(request, page)


@router.post(
    "/look",
    tags=["Uploads"],
    response_class=Response,
    responses={200: {"content": {"application/json": {}}, "description": "What is in it; docs/api.md says what."}},
    openapi_extra=CHANGES_NOTHING,
    summary="Look into a folder before it is sent",
)
@priced("heavy", bound="the body: listing and small files", body_bytes=32 * 1024**2)
async def look_into_folder(request: LookRequest, context: ContextDep, runner: RunnerDep, client: ClientDep) -> Response:
    """Tell which drives a folder of yours holds, what is wrong with one of them, where it went, and what to send of it.

    Nothing is made or kept. The folder is judged by the names and sizes of its files and by the contents of the small
    ones; give those that `wanted` names, and what was counted in `frames_to_look_into`, and ask again, to learn all.
    A client that reduces scans itself sends what `plan` says: `ground/...` of these scans and `reduced.json`.
    """
    found = await runner.run_in_worker(
        look,
        request.files,
        request.contents,
        request.name,
        request.root,
        UploadOptions.model_validate(dict(request.options)),
        request.keyframes,
        request.label_counts,
        WorkSettings.model_validate(context.settings),
        await run_in_threadpool(context.storage.incoming),
        client=client,
    )
    return Response(found, media_type="application/json")


@router.get_and_head("/{drive_id}", tags=["Drives"], response_model=DriveModel, summary="Show a drive")
@priced("cheap")
def show_drive(drive_id: DriveId, request: Request, context: ContextDep) -> Response:
    """Show a drive, with the report of its last commit."""
    with context.database.reading() as session:
        content = _shown(session, context, records.find_drive(session, drive_id))
    return answer_tagged(request, content)


def _shown(session: Session, context: Context, drive: Drive) -> bytes:
    return records.whole_drive_model(session, context, drive).model_dump_json().encode()


@router.patch(
    "/{drive_id}",
    tags=["Drives"],
    response_model=DriveModel,
    summary="Rename a drive, note something about it, or pin a result",
)
@priced("cheap")
def change_drive(drive_id: DriveId, changes: DriveChanges, context: ContextDep) -> Response:
    """Change the name, the note or the pinned job of a drive, in whatever state; what is left out stays as it is."""
    with context.database.writing() as session:
        drive = records.find_drive(session, drive_id, lock=True)
        values = changes.model_dump(exclude_unset=True)
        if "pinned_job" in values:
            records.pin_job(session, drive, values.pop("pinned_job"))
        for name, value in values.items():
            setattr(drive, name, value)
        content = _shown(session, context, drive)
    return Response(content, headers={"ETag": tag_of(content)}, media_type="application/json")


@router.post(
    "/{drive_id}/commit",
    tags=["Uploads"],
    responses={202: {"model": DriveModel, "description": "The check goes on; ask for the drive again."}},
    summary="Commit a drive",
)
@priced("cheap")
async def commit_drive(
    drive_id: DriveId,
    response: Response,
    context: ContextDep,
    client: ClientDep,
    wait_s: WaitSeconds,
    request: CommitRequest | None = None,
) -> DriveModel:
    """Check all files, reduce the scans to what the method needs, and make the drive ready for jobs.

    Waits until the check has ended. A drive with errors is a 422 whose `problems` lists all, and open again afterwards:
    correct its files and commit it again. The commit of a drive that is being checked waits for that check; that of a
    ready drive changes nothing. Both are refused where they name other options than those in force.
    """
    job = await run_in_threadpool(begin_commit, context, drive_id, client, request or CommitRequest())
    if job is not None:
        job = await wait_for_job(context, job.id, wait_s)
    drive = await run_in_threadpool(committed, context, drive_id, job)
    if drive.state == DriveState.CHECKING:
        response.status_code = 202
    if drive.state == DriveState.CHECKING or job is not None:
        response.headers["Location"] = f"{context.settings.root_path}/api/v1/drives/{drive_id}"
    return drive


@router.get_and_head("/{drive_id}/trajectory", response_class=WholeFile)
@priced("streaming")
def show_trajectory(drive_id: DriveId, request: Request, context: ContextDep) -> Response:
    """Return the trajectory of a ready drive: longitude and latitude, or metres with `"local": true`."""
    return deliver(request, records.find_trajectory(context, drive_id))
