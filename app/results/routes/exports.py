"""Results for GIS, web maps and other programs."""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple
from xml.sax.saxutils import escape

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.http.delivery import MEDIA_TYPES, answer_tagged, deliver, service_address
from app.http.openapi import BINARY, get_and_head, problems
from app.http.problem_types import FORMAT_NOT_INSTALLED
from app.http.problems import Problem
from app.results.folder import Results, ResultsDep
from app.results.on_demand import OnDemand, OnDemandDep
from app.results.routes.results import WORKED_OUT, JobId, answers
from app.results.work import LIVE, export_path
from interloc.errors import install
from interloc.output.geoparquet import has_parquet
from interloc.output.layers import DERIVED
from interloc.output.vector_files import FORMATS

Layer = Literal[
    "intersections",
    "detections",
    "trajectory",
    "keyframes",
    "roads",
    "junctions",
    "road-surface",
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
    Query(description="Layer to export; branches (lines) and uncertainty (ellipses) are made of the intersections."),
]

router = APIRouter(tags=["Exports"])

_CONTENT = {
    ".kml": {"type": "string"},
    ".csv": {"type": "string"},
    ".geojson": {"type": "object"},
}

_MAY_BE_MISSING = problems({501: "The service lacks the package that writes this format."})


class _Export(NamedTuple):
    summary: str
    description: str


_EXPORTS = {
    ".gpkg": _Export(
        "Download the result as a GeoPackage",
        "All layers in one file for QGIS: intersections, detections, trajectory, keyframes, OSM nodes, matches. "
        "Also the branches of the intersections as lines, and their uncertainty as ellipses. EPSG:4326. Lists (such as "
        "bearings) are JSON text. Fields have titles and descriptions, the metadata hold `run.json`. Layers with data "
        "of OpenStreetMap say so in their description: © OpenStreetMap contributors, ODbL 1.0. QGIS draws the layers "
        "as the page does: the table `layer_styles` holds QML.",
    ),
    ".qgz": _Export(
        "Download the result as a project of QGIS",
        "All layers in groups, drawn as on the page, with the range of the temporal controller, in one file that also "
        "holds the data: for QGIS 3.22 and newer.",
    ),
    ".kmz": _Export(
        "Download the result as KMZ",
        "All layers in one file for Google Earth, with the signs of the page; keyframes are hidden at first.",
    ),
    ".fgb": _Export("Download a layer as FlatGeobuf", "One layer as FlatGeobuf: compact, with a spatial index."),
    ".kml": _Export("Download a layer as KML", "One layer as KML, for Google Earth."),
    ".csv": _Export(
        "Download a layer as a table",
        "One layer as CSV (RFC 4180): points with `lon` and `lat`, lines and ellipses with `wkt`; null is empty. "
        "A text that spreadsheets would run as a formula gets an apostrophe in front.",
    ),
    ".geojson": _Export(
        "Download a layer as GeoJSON",
        "One layer as GeoJSON: also those that are made of the intersections, which have no address of their own.",
    ),
    ".parquet": _Export(
        "Download a layer as GeoParquet",
        "One layer as GeoParquet 1.1, for DuckDB, GeoPandas and others; where the extra `parquet` is installed.",
    ),
    ".pmtiles": _Export(
        "Read the result as vector tiles",
        "All layers as Mapbox Vector Tiles in one PMTiles archive (version 3), which web maps read by byte ranges: "
        "zooms 0 to 15; what is more than intersections and trajectory begins at zoom 13. Its metadata name layers, "
        "fields, attribution and licence.",
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
    content = _CONTENT.get(suffix, BINARY)
    get_and_head(
        router,
        f"/jobs/{{job_id}}/export{suffix}",
        summary=export.summary,
        description=export.description,
        operation_id=f"export_{suffix[1:]}",
        response_class=Response,
        responses={
            **answers(MEDIA_TYPES[suffix], content, "The file."),
            **WORKED_OUT,
            **(_MAY_BE_MISSING if suffix == ".parquet" else {}),
        },
    )({"one": export_layer, "all": export_all, "any": export_any}[FORMATS[suffix].layers])


for _suffix in _EXPORTS:
    _add_export(_suffix)


@get_and_head(
    router,
    "/jobs/{job_id}/export.qgs",
    summary="Download a project of QGIS that reads the layers from here",
    operation_id="export_qgs",
    response_class=Response,
    responses={**answers(MEDIA_TYPES[".qgs"], {"type": "string"}, "The file."), **WORKED_OUT},
)
async def export_live_project(job_id: JobId, request: Request, results: ResultsDep, on_demand: OnDemandDep) -> Response:
    """Give the project of `export.qgz` without the data: QGIS reads the layers from the service (OGC API - Features).

    Where the service needs a token, QGIS asks for a user name, which may be any, and a password, which is the token.
    """
    result = await run_in_threadpool(results.open, job_id)
    path = export_path(result.cache, "all.qgs")
    if not path.exists():
        result.require_georeference(f"Its files are in {result.address}/files")
        await on_demand.export(result, path, None, request.state.holder.name)
    text = await run_in_threadpool(path.read_text, "utf-8")
    address = escape(f"{service_address(request)}{result.address}", {'"': "&quot;"})
    name = f'attachment; filename="{result.slug}.qgs"'
    content = text.replace(LIVE, address).encode()
    return answer_tagged(request, content, MEDIA_TYPES[".qgs"], **{"content-disposition": name})


async def _deliver(
    request: Request, results: Results, on_demand: OnDemand, job_id: str, suffix: str, layer: Layer | None
) -> Response:
    result = await run_in_threadpool(results.open, job_id)
    if suffix == ".parquet" and not has_parquet():
        detail = f"GeoParquet needs pyarrow, which the operator installs: {install('parquet')}"
        raise Problem(FORMAT_NOT_INSTALLED, detail)
    name = layer or "all"
    path = export_path(result.cache, f"{name}{suffix}")
    if not path.exists():
        if on_earth := FORMATS[suffix].only_on_earth or (layer in DERIVED and "Shapes made of the intersections"):
            result.require_georeference(f"{on_earth} needs them; export.gpkg and .qgz are in metres of its own frame")
        if layer is not None:
            result.layer_file("intersections" if layer in DERIVED else layer)
        await on_demand.export(result, path, layer, request.state.holder.name)
    file_name = f"{result.slug}{suffix}" if layer is None else f"{result.slug}-{name}{suffix}"
    return await run_in_threadpool(deliver, request, path, name=file_name, download=True)
