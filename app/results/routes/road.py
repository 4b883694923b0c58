"""The road seen by LiDAR: a base map of the drive's own."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Request, Response
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, Field

from app.http.delivery import MEDIA_TYPES, deliver
from app.http.openapi import BINARY, get_and_head
from app.results.folder import Results, ResultsDep
from app.results.on_demand import OnDemand, OnDemandDep
from app.results.routes.results import WORKED_OUT, JobId, answers
from app.results.work import ROAD_PICTURE, VIEW
from interloc.output.road import MAX_PICTURE_PX

router = APIRouter(tags=["Results"])

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
async def read_road_picture(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give a picture in Web Mercator, or in W without georeference; transparent where no road was seen.

    `GET .../road` says where it lies.
    """
    return await _deliver(request, results, on_demand, job_id, ROAD_PICTURE)


@get_and_head(
    router,
    "/jobs/{job_id}/road",
    summary="Where the picture of the road lies",
    operation_id="read_road_view",
    response_model=RoadView,
    responses=WORKED_OUT,
)
async def read_road_view(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give the bounds of the picture, and the size of the cells."""
    return await _deliver(request, results, on_demand, job_id, VIEW)


async def _deliver(request: Request, results: Results, on_demand: OnDemand, job_id: str, file: str) -> Response:
    result = await run_in_threadpool(results.open, job_id)
    result.road()
    folder = await on_demand.road(result, request.state.holder.name)
    name = ROAD_PICTURE if file == ROAD_PICTURE else "road.json"
    return await run_in_threadpool(deliver, request, folder / file, name=f"{result.slug}-{name}")
