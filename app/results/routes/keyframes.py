"""The steps of the method at one keyframe, as pictures for the map."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field

from app.http.delivery import deliver
from app.http.openapi import BINARY, Responses, get_and_head, problems
from app.results.folder import Results, ResultsDep
from app.results.on_demand import OnDemand, OnDemandDep
from app.results.routes.results import PROBLEMS, JobId, answers
from app.results.work import VIEW

_KEEP = "private, max-age=86400"  # the same request to the same job always gives the same picture

router = APIRouter(tags=["Results"])

Frame = Annotated[int, Path(description="Scan number of a keyframe.", ge=0, le=2**31)]
Layer = Literal["bev", "occupancy", "centerline", "candidates", "branches", "all"]
LonLat = tuple[float, float]


class KeyframeDetection(BaseModel):
    """A detection of the keyframe; further members are those of `interloc explain`."""

    model_config = ConfigDict(extra="allow")

    lonlat: LonLat | None
    x_m: float = Field(description="Metres ahead of the LiDAR.")
    y_m: float = Field(description="Metres to the left of the LiDAR.")
    world_x_m: float
    world_y_m: float
    branch_count: int
    score: float = Field(ge=0, le=1)


class KeyframeCandidate(BaseModel):
    """A candidate, and the decision about it; further members are those of `interloc explain`."""

    model_config = ConfigDict(extra="allow")

    number: int
    lonlat: LonLat | None
    inner_radius_m: float
    branches: int
    kept: bool
    why_not: str | None = Field(description="Why it is not an intersection.", examples=["2 branches, 3 needed"])


class KeyframeView(BaseModel):
    """The corners of the pictures of a keyframe, and the numbers behind them."""

    model_config = ConfigDict(extra="allow")

    frame: int
    time_s: float | None
    size_px: int = Field(
        description="Cells per side; a picture has one pixel per cell, or a whole number of pixels per cell."
    )
    resolution_m: float = Field(description="Side of a cell in metres.")
    corners_lonlat: list[LonLat] | None = Field(
        description="Upper left, upper right, lower right, lower left of the pictures; null without georeference."
    )
    corners_world_m: list[tuple[float, float]] = Field(description="The same corners in W, in metres.")
    layers: list[str]
    outer_radius_m: float = Field(description="Outer radius in metres of the branches around a candidate.")
    relevant_zone_m: float = Field(description="Side in metres of the zone in which a missed node counts.")
    min_points: int = Field(description="Number of points from which a cell was road.")
    candidates: list[KeyframeCandidate]
    detections: list[KeyframeDetection]


_PROBLEMS: Responses = {**PROBLEMS, **problems({503: "Too many pictures are being drawn; try again in a moment."})}


async def _deliver(
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


@get_and_head(
    router,
    "/jobs/{job_id}/keyframes/{frame}/bev.png",
    summary="A step of the method at one keyframe, as a picture",
    operation_id="read_keyframe_picture",
    response_class=Response,
    responses={**answers("image/png", BINARY, "The picture."), **_PROBLEMS},
)
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
    return await _deliver(request, results, on_demand, job_id, frame, f"{layer}.png")


@get_and_head(
    router,
    "/jobs/{job_id}/keyframes/{frame}/bev",
    summary="The corners of the pictures of a keyframe, and the numbers behind them",
    operation_id="read_keyframe_view",
    response_model=KeyframeView,
    responses=_PROBLEMS,
)
async def read_keyframe_view(
    job_id: JobId, frame: Frame, request: Request, results: ResultsDep, on_demand: OnDemandDep
) -> Response:
    """Give corners, candidates and why each was kept or not, detections, the window, the counts of points."""
    return await _deliver(request, results, on_demand, job_id, frame, VIEW)
