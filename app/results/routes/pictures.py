"""Pictures that workers draw of a result: the steps of the method at one keyframe, the road seen by LiDAR."""

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.http.delivery import deliver
from app.http.openapi import get_and_head
from app.http.prices import priced
from app.results.folder import OnDemand, OnDemandDep, Results, ResultsDep
from app.results.routes.results import JobId
from app.results.work import ROAD_PICTURE, VIEW

_KEEP = "private, max-age=86400"  # the same request to the same job always gives the same picture

router = APIRouter(tags=["Results"])

Frame = Annotated[int, Path(description="Scan number of a keyframe.", ge=0, le=2**31)]
Layer = Literal["bev", "occupancy", "centerline", "candidates", "branches", "all"]


async def _deliver_keyframe(
    request: Request, results: Results, on_demand: OnDemand, job_id: str, frame: int, file: str
) -> Response:
    for attempt in (1, 2):
        result = await run_in_threadpool(results.open, job_id)
        folder = await on_demand.keyframe(result, frame, request.state.holder.name)
        try:
            return await run_in_threadpool(
                deliver, request, folder / file, name=f"{result.slug}-{frame}-{file}", cache_control=_KEEP
            )
        except FileNotFoundError:  # just removed in favour of newer ones
            if attempt == 2:
                raise
    raise AssertionError


@get_and_head(router, "/jobs/{job_id}/keyframes/{frame}/bev.png", response_class=Response)
@priced("cheap")
async def read_keyframe_picture(
    job_id: JobId,
    frame: Frame,
    request: Request,
    results: ResultsDep,
    on_demand: OnDemandDep,
    layer: Annotated[Layer, Query(description="Step to show; `all` shows several in one opaque picture.")] = "bev",
) -> Response:
    """Show the region of interest, aligned with W: +x to the right, +y up. Transparent where there is nothing.

    `GET .../keyframes/{frame}/bev` has the corners, to place the picture on a map. The picture is drawn when it is
    first requested, which takes some tenths of a second.
    """
    return await _deliver_keyframe(request, results, on_demand, job_id, frame, f"{layer}.png")


@get_and_head(router, "/jobs/{job_id}/keyframes/{frame}/bev", response_class=Response)
@priced("cheap")
async def read_keyframe_view(
    job_id: JobId, frame: Frame, request: Request, results: ResultsDep, on_demand: OnDemandDep
) -> Response:
    """Give corners, candidates and why each was kept or not, detections, the window, the counts of points."""
    return await _deliver_keyframe(request, results, on_demand, job_id, frame, VIEW)


@get_and_head(router, "/jobs/{job_id}/road.png", response_class=Response)
@priced("cheap")
async def read_road_picture(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give a picture in Web Mercator, or in W without georeference; transparent where no road was seen.

    `GET .../road` says where it lies.
    """
    return await _deliver_road(request, results, on_demand, job_id, ROAD_PICTURE)


@get_and_head(router, "/jobs/{job_id}/road", response_class=Response)
@priced("cheap")
async def read_road_view(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give the bounds of the picture, and the size of the cells."""
    return await _deliver_road(request, results, on_demand, job_id, VIEW)


async def _deliver_road(request: Request, results: Results, on_demand: OnDemand, job_id: str, file: str) -> Response:
    result = await run_in_threadpool(results.open, job_id)
    result.road()
    folder = await on_demand.road(result, request.state.holder.name)
    name = ROAD_PICTURE if file == ROAD_PICTURE else "road.json"
    return await run_in_threadpool(deliver, request, folder / file, name=f"{result.slug}-{name}")
