"""Results for QGIS, Google Earth and other GIS."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple
from xml.sax.saxutils import escape

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.http.delivery import MEDIA_TYPES, answer_tagged, deliver
from app.http.openapi import get_and_head
from app.http.problems import ProblemDocument
from app.results.folder import Results, ResultsDep
from app.results.on_demand import OnDemand, OnDemandDep
from app.routes.results import PROBLEMS, JobId, answers
from app.work.on_demand import LIVE
from interloc.output.layers import DERIVED

Layer = Literal[
    "intersections",
    "detections",
    "trajectory",
    "keyframes",
    "osm-nodes",
    "matches",
    "osm-roads",
    "osm-buildings",
    "places",
    "branches",
    "uncertainty",
]
LayerQuery = Annotated[
    Layer,
    Query(description="Layer to export; branches (lines) and uncertainty (circles) are made of the intersections."),
]

router = APIRouter(tags=["Exports"])

_CONTENT = {".kml": {"type": "string"}, ".csv": {"type": "string"}, ".geojson": {"type": "object"}}

_PROBLEMS: dict[int | str, dict[str, Any]] = {
    **PROBLEMS,
    503: {"model": ProblemDocument, "description": "The worker processes died of this request."},
    507: {"model": ProblemDocument, "description": "The disk of the service is full."},
}


class _Export(NamedTuple):
    summary: str
    description: str
    layers: Literal["one", "all", "any"] = "one"  # any: all, unless one is named


_EXPORTS = {
    ".gpkg": _Export(
        "Download the result as a GeoPackage",
        "All layers in one file for QGIS: intersections, detections, trajectory, keyframes, OSM nodes, matches. "
        "Also the branches of the intersections as lines, and their uncertainty as circles. EPSG:4326. Lists (bearings "
        "of branches) are JSON text. Fields have titles and descriptions, the metadata hold `run.json`. Layers with "
        "data of OpenStreetMap say so in their description: © OpenStreetMap contributors, ODbL 1.0. QGIS draws the "
        "layers as the page does: the table `layer_styles` holds QML and SLD.",
        layers="any",
    ),
    ".qgz": _Export(
        "Download the result as a project of QGIS",
        "All layers in groups, drawn as on the page, with the range of the temporal controller, in one file that also "
        "holds the data: for QGIS 3.22 and newer.",
        layers="all",
    ),
    ".kmz": _Export(
        "Download the result as KMZ",
        "All layers in one file for Google Earth, with the signs of the page; keyframes are hidden at first.",
        layers="any",
    ),
    ".fgb": _Export("Download a layer as FlatGeobuf", "One layer as FlatGeobuf: compact, with a spatial index."),
    ".kml": _Export("Download a layer as KML", "One layer as KML, for Google Earth."),
    ".csv": _Export(
        "Download a layer as a table",
        "One layer as CSV (RFC 4180): points with `lon` and `lat`, lines and circles with `wkt`; null is empty. "
        "A text that spreadsheets would run as a formula gets an apostrophe in front.",
    ),
    ".geojson": _Export(
        "Download a layer as GeoJSON",
        "One layer as GeoJSON: also those that are made of the intersections, which have no address of their own.",
    ),
}


def _add_export(suffix: str) -> None:
    async def export_layer(
        job_id: JobId,
        request: Request,
        results: ResultsDep,
        on_demand: OnDemandDep,
        layer: LayerQuery = "intersections",
    ) -> Response:
        return await _deliver(request, results, on_demand, job_id, suffix, layer)

    async def export_all(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
        return await _deliver(request, results, on_demand, job_id, suffix, None)

    async def export_any(
        job_id: JobId,
        request: Request,
        results: ResultsDep,
        on_demand: OnDemandDep,
        layer: Annotated[Layer | None, Query(description="Layer to export; all by default.")] = None,
    ) -> Response:
        return await _deliver(request, results, on_demand, job_id, suffix, layer)

    export = _EXPORTS[suffix]
    content = _CONTENT.get(suffix, {"type": "string", "format": "binary"})
    get_and_head(
        router,
        f"/jobs/{{job_id}}/export{suffix}",
        summary=export.summary,
        description=export.description,
        operation_id=f"export_{suffix[1:]}",
        response_class=Response,
        responses={**answers(MEDIA_TYPES[suffix], content, "The file."), **_PROBLEMS},
    )({"one": export_layer, "all": export_all, "any": export_any}[export.layers])


for _suffix in _EXPORTS:
    _add_export(_suffix)


@get_and_head(
    router,
    "/jobs/{job_id}/export.qgs",
    summary="Download a project of QGIS that reads the layers from here",
    operation_id="export_qgs",
    response_class=Response,
    responses={**answers(MEDIA_TYPES[".qgs"], {"type": "string"}, "The file."), **_PROBLEMS},
)
async def export_live_project(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give the project of `export.qgz` without the data: QGIS reads the layers from the addresses of this service.

    For a service without a token, which QGIS does not send for such layers.
    """
    result = await run_in_threadpool(results.open, job_id)
    path = result.cache / "exports" / "all.qgs"
    if not path.exists():
        result.require_georeference(f"Its files are in {result.address}/files")
        await on_demand.export(result, path, None, request.state.holder.name)
    text = await run_in_threadpool(path.read_text, "utf-8")
    address = escape(f"{str(request.base_url).rstrip('/')}{result.address}", {'"': "&quot;"})
    name = f'attachment; filename="{result.slug}.qgs"'
    content = text.replace(LIVE, address).encode()
    return answer_tagged(request, content, MEDIA_TYPES[".qgs"], **{"content-disposition": name})


async def _deliver(
    request: Request, results: Results, on_demand: OnDemand, job_id: str, suffix: str, layer: Layer | None
) -> Response:
    result = await run_in_threadpool(results.open, job_id)
    name = layer or "all"
    path = result.cache / "exports" / f"{name}{suffix}"
    if not path.exists():
        if layer is None:
            result.require_georeference(f"Its files are in {result.address}/files")
        else:
            result.layer("intersections" if layer in DERIVED else layer)
        await on_demand.export(result, path, layer, request.state.holder.name)
    file_name = f"{result.slug}{suffix}" if layer is None else f"{result.slug}-{name}{suffix}"
    return await run_in_threadpool(deliver, request, path, name=file_name, download=True)
