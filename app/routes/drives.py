"""Endpoints: drives."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Response

from app.context import ContextDep
from app.drives import records, trash
from app.drives.plan import judge_label_counts
from app.http.openapi import CHANGES_NOTHING
from app.http.paging import After
from app.http.problems import ProblemDocument
from app.results.folder import ResultsDep
from app.schemas.drives import DriveList, DriveModel, LabelsAnswer, LabelsRequest, NewDrive
from app.schemas.strict import ID_PATTERN
from app.security import ClientDep

router = APIRouter(prefix="/drives", tags=["Drives"])

DriveId = Annotated[str, Path(description="Id of the drive, from POST /api/v1/drives.", pattern=ID_PATTERN)]
NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ProblemDocument, "description": "There is no such drive."}}


@router.post("", status_code=201, summary="Make a drive")
def create_drive(new: NewDrive, response: Response, context: ContextDep, client: ClientDep) -> DriveModel:
    """Make a drive without files. Send its files next, then commit it."""
    drive = records.create_drive(context, client, new)
    response.headers["Location"] = f"{context.settings.root_path}/api/v1/drives/{drive.id}"
    return drive


@router.get("", summary="List drives")
def list_drives(
    context: ContextDep,
    _client: ClientDep,
    after: After = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> DriveList:
    """List drives, the newest first, without their reports."""
    return records.list_drives(context, after, limit)


@router.post("/labels", summary="Tell what label ids mean", openapi_extra=CHANGES_NOTHING)
def judge_labels(request: LabelsRequest, _client: ClientDep) -> LabelsAnswer:
    """Tell the label scheme from counts of label ids, and what is wrong with them.

    For clients that choose how to read a drive before they send it; the plan of a drive answers the same.
    """
    return judge_label_counts(request)


@router.get("/{drive_id}", responses=NOT_FOUND, summary="Show a drive")
def show_drive(drive_id: DriveId, context: ContextDep, _client: ClientDep) -> DriveModel:
    """Show a drive, with the report of its last commit."""
    with context.database.reading() as session:
        return records.drive_model(records.find_drive(session, drive_id), context.settings)


@router.delete("/{drive_id}", status_code=204, responses=NOT_FOUND, summary="Delete a drive")
def delete_drive(
    drive_id: DriveId,
    context: ContextDep,
    results: ResultsDep,
    client: ClientDep,
    purge: Annotated[bool, Query(description="Delete it for good, instead of moving it to the trash.")] = False,
) -> None:
    """Move a drive to the trash, with its files, its jobs and their results. Jobs that run are dismissed.

    It can be restored from there for some days (POST /api/v1/trash/drives/{id}/restore).
    """
    trash.delete_drive(context, drive_id, client, at_once=purge)
    results.forget()
