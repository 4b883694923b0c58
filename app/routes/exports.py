"""Results for QGIS, Google Earth and other GIS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.context import Context, ContextDep
from app.http.delivery import MEDIA_TYPES, deliver
from app.http.problems import ProblemDocument
from app.results.exports import Exports
from app.results.folder import open_result
from app.routes.results import PROBLEMS, JobId, answers

Layer = Literal["intersections", "detections", "trajectory", "keyframes", "osm-nodes", "matches", "osm-roads"]
LayerQuery = Annotated[Layer, Query(description="Which layer.")]

router = APIRouter(tags=["Exports"])

_PROBLEMS: dict[int | str, dict[str, Any]] = {
    **PROBLEMS,
    503: {"model": ProblemDocument, "description": "The workers died of it."},
    507: {"model": ProblemDocument, "description": "The disk of the service is full."},
}


def get(suffix: str, summary: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register an export for GET, and for HEAD without a second entry in the OpenAPI."""
    path = f"/jobs/{{job_id}}/export{suffix}"
    binary = {"type": "string"} if suffix == ".kml" else {"type": "string", "format": "binary"}

    def register(endpoint: Callable[..., Any]) -> Callable[..., Any]:
        router.add_api_route(
            path,
            endpoint,
            methods=["GET"],
            summary=summary,
            operation_id=endpoint.__name__,
            response_class=Response,
            responses={**answers(MEDIA_TYPES[suffix], binary, "The file."), **_PROBLEMS},
        )
        router.add_api_route(path, endpoint, methods=["HEAD"], include_in_schema=False, response_class=Response)
        return endpoint

    return register


@get(".gpkg", "Download the result as a GeoPackage")
async def export_gpkg(
    job_id: JobId,
    request: Request,
    context: ContextDep,
    layer: Annotated[Layer | None, Query(description="Only this layer; all by default.")] = None,
) -> Response:
    """Give all layers in one file for QGIS: intersections, detections, trajectory, keyframes, OSM nodes, matches.

    EPSG:4326. Lists (bearings of branches) are JSON text. Layers with data of OpenStreetMap say so in their
    description: © OpenStreetMap contributors, ODbL 1.0.
    """
    return await _export(request, context, job_id, ".gpkg", layer)


@get(".fgb", "Download a layer as FlatGeobuf")
async def export_fgb(
    job_id: JobId, request: Request, context: ContextDep, layer: LayerQuery = "intersections"
) -> Response:
    """Give one layer as FlatGeobuf: compact, with a spatial index."""
    return await _export(request, context, job_id, ".fgb", layer)


@get(".kml", "Download a layer as KML")
async def export_kml(
    job_id: JobId, request: Request, context: ContextDep, layer: LayerQuery = "intersections"
) -> Response:
    """Give one layer as KML, for Google Earth."""
    return await _export(request, context, job_id, ".kml", layer)


async def _export(request: Request, context: Context, job_id: str, suffix: str, layer: Layer | None) -> Response:
    result = await run_in_threadpool(open_result, context, job_id)
    name = layer or "all"
    path = result.cache / "exports" / f"{name}{suffix}"
    if not path.exists():
        if layer is None:
            result.require_georeference(f"Its files are in {result.address}/files")
        else:
            result.layer(layer)
        exports: Exports = request.app.state.exports
        await exports.write(result, path, layer)
    file_name = f"{result.slug}{suffix}" if layer is None else f"{result.slug}-{name}{suffix}"
    return await run_in_threadpool(deliver, request, path, name=file_name, download=True)
