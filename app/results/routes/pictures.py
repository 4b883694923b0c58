"""Pictures that workers draw of a result: the steps of the method at one keyframe, the road seen by LiDAR."""

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ConfigDict, Field

from app.http.delivery import MEDIA_TYPES, deliver
from app.http.openapi import BINARY, Responses, get_and_head, problems
from app.http.prices import priced
from app.results.folder import OnDemand, OnDemandDep, Results, ResultsDep
from app.results.routes.results import PROBLEMS, WORKED_OUT, JobId, answers
from app.results.work import ROAD_PICTURE, VIEW
from interloc.output.road import MAX_PICTURE_PX

_KEEP = "private, max-age=86400"  # the same request to the same job always gives the same picture

router = APIRouter(tags=["Results"])

Frame = Annotated[int, Path(description="Scan number of a keyframe.", ge=0, le=2**31)]
Layer = Literal["bev", "occupancy", "centerline", "candidates", "branches", "all"]
Corner = Annotated[list[float], Field(min_length=2, max_length=2)]


class KeyframeView(BaseModel):
    """The corners of the pictures of a keyframe, and the numbers behind them."""

    model_config = ConfigDict(extra="allow")

    frame: int
    time_s: float | None
    size_px: int = Field(
        description="Cells per side; a picture has one pixel per cell, or a whole number of pixels per cell."
    )
    resolution_m: float = Field(description="Side of a cell in metres.")
    corners_lonlat: list[Corner] | None = Field(
        description="Upper left, upper right, lower right, lower left of the pictures; null without georeference."
    )
    corners_world_m: list[Corner] = Field(description="The same corners in W, in metres.")
    layers: list[str]
    outer_radius_m: float = Field(description="Outer radius in metres of the branches around a candidate.")
    relevant_zone_m: float = Field(description="Side in metres of the zone in which a missed node counts.")
    min_points: int = Field(description="Number of points from which a cell was road.")
    candidates: list[dict[str, Any]] = Field(description="Those of `interloc explain`, with the decision about each.")
    detections: list[dict[str, Any]] = Field(description="Likewise.")


_PROBLEMS: Responses = {**PROBLEMS, **problems({503: "Too many pictures are being drawn; try again in a moment."})}


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


@get_and_head(
    router,
    "/jobs/{job_id}/keyframes/{frame}/bev.png",
    summary="A step of the method at one keyframe, as a picture",
    operation_id="read_keyframe_picture",
    response_class=Response,
    responses={**answers("image/png", BINARY, "The picture."), **_PROBLEMS},
)
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


@get_and_head(
    router,
    "/jobs/{job_id}/keyframes/{frame}/bev",
    summary="The corners of the pictures of a keyframe, and the numbers behind them",
    operation_id="read_keyframe_view",
    response_model=KeyframeView,
    responses=_PROBLEMS,
)
@priced("cheap")
async def read_keyframe_view(
    job_id: JobId, frame: Frame, request: Request, results: ResultsDep, on_demand: OnDemandDep
) -> Response:
    """Give corners, candidates and why each was kept or not, detections, the window, the counts of points."""
    return await _deliver_keyframe(request, results, on_demand, job_id, frame, VIEW)


Box = Annotated[list[float], Field(min_length=4, max_length=4)]


class RoadView(BaseModel):
    """Where the picture of the road lies, and what it is made of."""

    bounds_lonlat: Box | None = Field(
        description="West, south, east, north of the picture, degrees; it is in Web Mercator (EPSG:3857). Null without "
        "georeference."
    )
    bounds_world_m: Box | None = Field(
        description="Least x, least y, greatest x, greatest y in W, metres; null with georeference."
    )
    size_px: list[int] = Field(min_length=2, max_length=2, description="Width and height of the picture.")
    picture_resolution_m: float = Field(
        description=f"Side of the cells that the picture is drawn of: larger than `resolution_m` where the drive would "
        f"take more than {MAX_PICTURE_PX} pixels."
    )
    resolution_m: float = Field(description="Side of the cells of the GeoTIFF.")
    crs: str | None = Field(description="Of the GeoTIFF; null in metres of W.", examples=["EPSG:32632"])


@get_and_head(
    router,
    "/jobs/{job_id}/road.tif",
    summary="The road seen by LiDAR, as a GeoTIFF",
    operation_id="read_road_raster",
    response_class=Response,
    responses=answers(MEDIA_TYPES[".tif"], BINARY, "The raster."),
)
@priced("streaming")
def read_road_raster(job_id: JobId, request: Request, results: ResultsDep) -> Response:
    """Give the occupancy of the keyframes as one raster: the surface that the LiDAR saw as road.

    One byte per cell: the number of keyframes, 10 m apart along the drive, from which it was seen as road; 0 is no
    data. Cells of 0.5 m (more on drives of over 60 km across) in the UTM zone of the drive; without georeference in
    metres of W, without a coordinate system. Deflated, tiled; empty tiles take no room.
    """
    result = results.open(job_id)
    return deliver(request, result.road(), name=f"{result.slug}-road.tif")


@get_and_head(
    router,
    "/jobs/{job_id}/road.png",
    summary="The road seen by LiDAR, as a picture for a map",
    operation_id="read_road_picture",
    response_class=Response,
    responses={**answers("image/png", BINARY, "The picture."), **WORKED_OUT},
)
@priced("cheap")
async def read_road_picture(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give a picture in Web Mercator, or in W without georeference; transparent where no road was seen.

    `GET .../road` says where it lies.
    """
    return await _deliver_road(request, results, on_demand, job_id, ROAD_PICTURE)


@get_and_head(
    router,
    "/jobs/{job_id}/road",
    summary="Where the picture of the road lies",
    operation_id="read_road_view",
    response_model=RoadView,
    responses=WORKED_OUT,
)
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
