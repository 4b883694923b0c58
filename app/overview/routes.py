"""The map of all drives."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from app.context import ContextDep
from app.drives import records
from app.http.delivery import answer_tagged
from app.http.openapi import TAGGED, get_and_head
from app.http.paging import After, lies_in, next_link
from app.http.parameters import BoxFilter
from app.http.security import ClientDep
from app.http.turns import IN_TURN
from app.jobs.chosen import chosen_results
from app.overview.features import drive_features
from app.overview.models import Overview
from app.results.models import MEDIA_TYPE
from app.states import DriveState
from app.store.models import Drive
from interloc.output.geojson import encode

router = APIRouter(tags=["Drives"])


@get_and_head(
    router,
    "/overview",
    summary="Show all drives on one map",
    dependencies=IN_TURN,
    response_class=Response,
    responses={
        **TAGGED,
        200: {"model": Overview, "description": "GeoJSON."},
    },
)
def show_overview(
    request: Request,
    context: ContextDep,
    _client: ClientDep,
    box: BoxFilter,
    after: After = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="Maximum number of drives.")] = 100,
) -> Response:
    """Give the track of every ready drive, simplified, and the intersections of the job that stands for it.

    A drive without georeference has no geometry, unless that job has placed it on the map. `bbox` selects drives by
    their own georeference.
    """
    conditions = [Drive.state == DriveState.READY, *([] if box is None else [lies_in(box)])]
    page = records.list_drives(context, after, limit, conditions)
    with context.database.reading() as session:
        jobs = {job.drive_id: job for job in session.scalars(chosen_results(Drive.id.in_([d.id for d in page.drives])))}
    features = [
        feature
        for drive in page.drives
        for feature in drive_features(context.storage, drive.id, drive.name, jobs.get(drive.id), drive.pinned_job)
    ]
    content = encode({"type": "FeatureCollection", "features": features, "next": page.next}).encode()
    return answer_tagged(request, content, MEDIA_TYPE, **next_link(request, page.next))
