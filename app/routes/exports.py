"""Results for QGIS, Google Earth and other GIS."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.http.delivery import MEDIA_TYPES, deliver
from app.http.openapi import get_and_head
from app.http.problems import ProblemDocument
from app.results.folder import Results, ResultsDep
from app.results.on_demand import OnDemand, OnDemandDep
from app.routes.results import PROBLEMS, JobId, answers
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
    of_all_layers: bool = False  # unless one is named


_EXPORTS = {
    ".gpkg": _Export(
        "Download the result as a GeoPackage",
        "All layers in one file for QGIS: intersections, detections, trajectory, keyframes, OSM nodes, matches. "
        "Also the branches of the intersections as lines, and their uncertainty as circles. EPSG:4326. Lists (bearings "
        "of branches) are JSON text. Fields have titles and descriptions, the metadata hold `run.json`. Layers with "
        "data of OpenStreetMap say so in their description: © OpenStreetMap contributors, ODbL 1.0.",
        of_all_layers=True,
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

    async def export_all(
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
    )(export_all if export.of_all_layers else export_layer)


for _suffix in _EXPORTS:
    _add_export(_suffix)


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
