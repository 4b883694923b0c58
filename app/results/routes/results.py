"""What a successful job yields: layers, report, files, one archive of all."""

import re
from typing import Annotated, Literal

from fastapi import Path, Query, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from zipstream import ZIP_DEFLATED, ZIP_STORED, ZipStream

from app.context import ContextDep
from app.http.delivery import REVALIDATE, answer_tagged, deliver, disposition, media_type_of, not_modified, tag_of
from app.http.fields import ID
from app.http.openapi import BINARY, Responses
from app.http.prices import priced
from app.http.problem_types import DIFFERENT_DRIVES, REQUEST_NOT_VALID
from app.http.problems import Problem
from app.http.routing import ApiRouter
from app.jobs.models import MAX_COMPARED_JOBS
from app.jobs.view import find_job, job_models, own_settings, title_of
from app.results.folder import (
    FeatureCollection,
    LayerName,
    OnDemand,
    OnDemandDep,
    ResultFile,
    ResultFileList,
    Results,
    ResultsDep,
)
from app.results.work import ROAD_PICTURE, VIEW
from app.states import JobKind, JobState
from interloc.arrays import JsonObject
from interloc.evaluation import compare
from interloc.evaluation.record import REPORT_FILE, Report
from interloc.output.geojson import read_as
from interloc.output.layers import LAYERS
from interloc.output.layout import RUN_FILE, file_names
from interloc.output.qgis import qml
from interloc.results import RunRecord

JobId = Annotated[str, Path(description="Id of a successful job of kind intersections.", pattern=ID)]

_PACKED = frozenset({".png", ".gz", ".zip"})  # they would not become smaller in an archive

_RANGE: Responses = {206: {"description": "The range that was asked for."}}


def answers(media_type: str, schema: JsonObject, description: str) -> Responses:
    """Describe the answers of an address that gives a file."""
    content = {media_type: {"schema": schema}}
    return {200: {"description": description, "content": content}, **_RANGE}


router = ApiRouter(tags=["Results"])


@router.get_and_head(
    "/jobs/{job_id}/layers/{name}",
    summary="A layer as GeoJSON",
    description="The same bytes as the command line writes: RFC 7946, longitude first.\n\n"
    + "\n".join(f"- `{each.name}`: {each.title}. {each.credit([]).attribution}" for each in LAYERS.values()),
    operation_id="read_layer",
    response_class=Response,
    responses={**_RANGE, 200: {"model": FeatureCollection, "description": "The layer."}},
)
@priced("streaming")
def read_layer(
    job_id: JobId, name: Annotated[LayerName, Path(description="Layer.")], request: Request, results: ResultsDep
) -> Response:
    """Give a layer."""
    result = results.open(job_id)
    return deliver(request, result.layer(name), name=f"{result.slug}-{name}.geojson")


@router.get_and_head(
    "/jobs/{job_id}/report",
    summary="The evaluation, for programs or for people",
    operation_id="read_report",
    response_class=Response,
    responses={
        **_RANGE,
        200: {
            "description": "The report: `report.json`, or `report.html` as one file with its figures.",
            "content": {"application/json": {"schema": {}}, "text/html": {"schema": {"type": "string"}}},
        },
    },
)
@priced("cheap")
def read_report(
    job_id: JobId,
    request: Request,
    results: ResultsDep,
    format: Annotated[Literal["html", "json"], Query(description="Format of the report.")] = "json",  # noqa: A002
) -> Response:
    """Score against OpenStreetMap: ACE, precision, recall and F1 over D, per node and on the map."""
    result = results.open(job_id)
    path = result.evaluation_file(f"report.{format}")
    return deliver(request, path, name=f"{result.slug}-{path.name}")


@router.get_and_head("/jobs/{job_id}/view", response_class=Response)
@priced("heavy", bound="the files of one result")
def read_view(job_id: JobId, request: Request, context: ContextDep, results: ResultsDep) -> Response:
    """Give a job and, where it is successful, all that the page shows of its result: one answer, not a dozen."""
    with context.database.reading() as session:
        (job,) = job_models(session, context, [find_job(session, job_id)])
    parts = {"job": job.model_dump_json().encode(), "run": b"null"}
    if job.state == JobState.SUCCESSFUL and job.kind == JobKind.INTERSECTIONS:
        result = results.open(job_id)
        layers = {name: f"{name}.geojson" for name in LAYERS} | file_names(georeferenced=result.is_georeferenced)
        del layers["road_surface"]  # the picture of the road shows more of it, in fewer bytes
        for name, file in {"run": RUN_FILE, "report": "report.json", **layers}.items():
            path = result.folder / file
            parts[name] = path.read_bytes() if path.is_file() else b"null"
    content = b",".join(b'"%s":%s' % (name.encode(), part) for name, part in parts.items())
    return answer_tagged(request, b"{%s}" % content)


@router.get_and_head(
    "/jobs/{job_id}/files",
    summary="List the files of the result",
    operation_id="list_result_files",
    response_model=ResultFileList,
)
@priced("cheap", bound="the files of one result")
def list_result_files(job_id: JobId, results: ResultsDep, context: ContextDep) -> ResultFileList:
    """List the result folder, exactly as the command line writes it."""
    result = results.open(job_id)
    return ResultFileList(
        files=[
            ResultFile(
                name=name.as_posix(),
                size_bytes=(result.folder / name).stat().st_size,
                media_type=media_type_of(name),
                href=f"{context.settings.root_path}{result.address}/files/{name.as_posix()}",
            )
            for name in result.files()
        ]
    )


@router.get_and_head(
    "/jobs/{job_id}/files/{name:path}",
    summary="Read a file of the result",
    operation_id="read_result_file",
    response_class=Response,
    responses=answers("*/*", {}, "The file, in its own media type."),
)
@priced("streaming")
def read_result_file(
    job_id: JobId,
    name: Annotated[
        str, Path(description="Path of the file, as listed.", examples=["figures/map.png"], max_length=512)
    ],
    request: Request,
    results: ResultsDep,
) -> Response:
    """Give any file of the result; without georeference the layers are the files `*.local.json`."""
    result = results.open(job_id)
    path = result.file(name)
    return deliver(request, path, name=f"{result.slug}-{path.name}")


@router.get_and_head(
    "/jobs/{job_id}/archive.zip",
    summary="Download everything as one archive",
    operation_id="download_archive",
    response_class=Response,
    responses=answers("application/zip", BINARY, "The result folder, packed."),
)
@priced("streaming")
def download_archive(job_id: JobId, request: Request, results: ResultsDep) -> Response:
    """Give the whole result folder as a .zip, packed while it is sent; beside each layer its style for QGIS (.qml)."""
    result = results.open(job_id)
    folder = f"{result.slug}-{job_id}"
    archive = ZipStream(compress_type=ZIP_DEFLATED)
    files = []
    for name in result.files():
        path = result.folder / name
        stat = path.stat()
        files.append((name.as_posix(), stat.st_mtime_ns, stat.st_size))
        compress_type = ZIP_STORED if name.suffix in _PACKED else ZIP_DEFLATED
        archive.add_path(path, f"{folder}/{name.as_posix()}", compress_type=compress_type)
        layer = LAYERS.get(name.name.split(".", 1)[0]) if name.suffix in {".geojson", ".json"} else None
        if layer is not None:
            archive.add(qml(layer), f"{folder}/{name.with_suffix('.qml').as_posix()}")
    headers = {
        "etag": tag_of(repr(files).encode()),
        "cache-control": REVALIDATE,
        "content-disposition": disposition(f"{folder}.zip"),
    }
    known = not_modified(request, headers)
    headers["etag"] = f"W/{headers['etag']}"  # the styles have the time of the request
    content = () if request.method == "HEAD" else archive
    return known or StreamingResponse(content, headers=headers, media_type="application/zip")


# Results side by side.

_JOBS = rf"^[A-Za-z0-9_-]{{1,64}}( *, *[A-Za-z0-9_-]{{1,64}}){{1,{MAX_COMPARED_JOBS - 1}}}$"


@router.get("/compare")
@priced("heavy", bound="the reports of a few jobs")
def compare_jobs(
    context: ContextDep,
    results: ResultsDep,
    jobs: Annotated[
        str,
        Query(
            description=f"Ids of 2 to {MAX_COMPARED_JOBS} jobs, with commas between.",
            max_length=1000,
            examples=["9b1e,44f0"],
        ),
    ],
) -> JsonObject:
    """Show what differs of inputs and settings, the figures at D = 5 m, and intersections that only one job found.

    A setting `is_own` where a job has another value than its preset; jobs that are called the same are numbered.
    """
    ids = [each.strip() for each in jobs.split(",")]
    if re.fullmatch(_JOBS, jobs) is None or len(set(ids)) < len(ids):
        raise Problem(REQUEST_NOT_VALID, f"jobs: {jobs!r}. Expected two to {MAX_COMPARED_JOBS} different job ids: a,b")
    opened = [results.open(job_id) for job_id in ids]
    drives = dict.fromkeys(result.drive_id for result in opened)
    if len(drives) > 1:
        names = ", ".join(f"{result.job_id} of {result.drive_id}" for result in opened)
        raise Problem(DIFFERENT_DRIVES, f"Jobs of one drive can be compared; these are {names}.")
    with context.database.reading() as session:
        compared_jobs = [find_job(session, job_id)[0] for job_id in ids]
        titles = [title_of(job, own_settings(job.request)) for job in compared_jobs]
    number = [titles[: i + 1].count(title) for i, title in enumerate(titles)]
    numbered = [
        title if titles.count(title) == 1 else f"{title} ({n})" for title, n in zip(titles, number, strict=True)
    ]
    reports = [read_as(Report, result.evaluation_file(REPORT_FILE)) for result in opened]
    runs = [read_as(RunRecord, result.folder / RUN_FILE) for result in opened]
    same = [run | {"drive_name": opened[0].drive_id} for run in runs]  # it may have been renamed between the jobs
    compared = compare.compare_reports(ids, reports, same)
    own = set().union(*(own_settings({"config": run.get("config", {})}) for run in runs))
    settings = [{**dict(each), "is_own": each.name in own} for each in compared.settings]
    return {**dict(compared), "drive_id": opened[0].drive_id, "names": numbered, "settings": settings}


# Pictures that workers draw of a result: the steps of the method at one keyframe, the road seen by LiDAR.

_KEEP = "private, max-age=86400"  # the same request to the same job always gives the same picture


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


@router.get_and_head("/jobs/{job_id}/keyframes/{frame}/bev.png", response_class=Response)
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


@router.get_and_head("/jobs/{job_id}/keyframes/{frame}/bev", response_class=Response)
@priced("cheap")
async def read_keyframe_view(
    job_id: JobId, frame: Frame, request: Request, results: ResultsDep, on_demand: OnDemandDep
) -> Response:
    """Give corners, candidates and why each was kept or not, detections, the window, the counts of points."""
    return await _deliver_keyframe(request, results, on_demand, job_id, frame, VIEW)


@router.get_and_head("/jobs/{job_id}/road.png", response_class=Response)
@priced("cheap")
async def read_road_picture(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give a picture in Web Mercator, or in W without georeference; transparent where no road was seen.

    `GET .../road` says where it lies.
    """
    return await _deliver_road(request, results, on_demand, job_id, ROAD_PICTURE)


@router.get_and_head("/jobs/{job_id}/road", response_class=Response)
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
