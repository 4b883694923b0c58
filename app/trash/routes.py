"""Endpoints: the trash."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, Response

from app.context import ContextDep
from app.http.openapi import PAGED
from app.http.paging import answer_page
from app.http.problems import ProblemDocument
from app.http.security import ClientDep
from app.trash import deletion as trash
from app.trash.models import TrashItem, TrashKind, TrashList

router = APIRouter(prefix="/trash", tags=["Trash"])

Kind = Annotated[TrashKind, Path(description="What it is.")]
Id = Annotated[str, Path(max_length=64, description="Id of the drive or job.")]

NOT_THERE: dict[int | str, dict[str, Any]] = {
    404: {"model": ProblemDocument, "description": "It is not in the trash."},
    409: {"model": ProblemDocument, "description": "The drive of the job is in the trash itself."},
}


@router.get("", response_model=TrashList, summary="List the trash", responses=PAGED)
def list_trash(
    request: Request,
    context: ContextDep,
    _client: ClientDep,
    after: Annotated[str | None, Query(max_length=100, description="`next` of the previous page.")] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> Response:
    """List deleted drives and jobs, the last deleted first. Jobs of a deleted drive come and go with it."""
    page = trash.list_trash(context, after, limit)
    return answer_page(request, page)


@router.delete("", status_code=204, summary="Empty the trash")
def empty_trash(context: ContextDep, _client: ClientDep) -> None:
    """Delete everything in the trash for good, now."""
    trash.empty_trash(context)


@router.post("/{kind}/{item_id}/restore", responses=NOT_THERE, summary="Restore from the trash")
def restore_item(kind: Kind, item_id: Id, context: ContextDep, _client: ClientDep) -> TrashItem:
    """Take a drive with its jobs and their results, or a job with its results, out of the trash."""
    return trash.restore(context, kind, item_id)


@router.delete("/{kind}/{item_id}", status_code=204, responses=NOT_THERE, summary="Delete for good")
def purge_item(kind: Kind, item_id: Id, context: ContextDep, _client: ClientDep) -> None:
    """Delete a drive or a job of the trash for good, now."""
    trash.find_purgeable(context, kind, item_id)
    trash.purge(context, kind, item_id)
