"""Results for GIS, web maps and other programs."""

from typing import Annotated, Literal

from fastapi import Query, Request, Response
from fastapi.concurrency import run_in_threadpool

from app.http.delivery import MEDIA_TYPES, deliver
from app.http.openapi import BINARY
from app.http.prices import priced
from app.http.problem_types import FORMAT_NOT_INSTALLED
from app.http.problems import Problem
from app.http.routing import ApiRouter
from app.results.folder import LayerName, OnDemandDep, ResultsDep
from app.results.routes.results import JobId, answers
from app.results.work import export_path
from interloc.errors import ConfigError, install
from interloc.output.layers import DERIVED
from interloc.output.vector_files import ALL, FORMATS, has_parquet

_FORMATS = {
    ".gpkg": "layers as a GeoPackage, EPSG:4326, lists (such as bearings) as JSON text; QGIS draws them as the page "
    "does (QML in `layer_styles`).",
    ".qgz": "all layers as a project of QGIS 3.22 and newer that holds the data: in groups, drawn as on the page.",
    ".kmz": "layers for Google Earth.",
    ".pmtiles": "one layer as Mapbox Vector Tiles (zooms 0 to 15) in a PMTiles archive (version 3), which web maps "
    "read by byte ranges.",
    ".fgb": "one layer as FlatGeobuf: compact, with a spatial index.",
    ".kml": "one layer as KML, for Google Earth.",
    ".csv": "one layer as a table (RFC 4180): points with `lon` and `lat`, lines and areas with `wkt`; null is empty. "
    "A text that spreadsheets would run as a formula gets an apostrophe in front.",
    ".geojson": "one layer as GeoJSON, also those that are made of the intersections.",
    ".parquet": "one layer as GeoParquet 1.1, where the service has the extra `parquet`.",
}

_DESCRIPTION = (
    "By format:\n\n"
    + "\n".join(f"- `{suffix[1:]}`: {text}" for suffix, text in _FORMATS.items())
    + "\n\nLayers with data of OpenStreetMap say so in their description: © OpenStreetMap contributors, ODbL 1.0."
)

_MEDIA_TYPES = [MEDIA_TYPES[suffix] for suffix in _FORMATS]
_FILE = answers("*/*", BINARY, "The file.")
# The first is for clients that are generated: they know this media type, and that it is no text.
_FILE[200]["content"] = {
    each: {"schema": {} if each.endswith("json") else BINARY} for each in ("application/octet-stream", *_MEDIA_TYPES)
}

router = ApiRouter(tags=["Exports"])


@router.get_and_head(
    "/jobs/{job_id}/export",
    summary="Download the result for other programs",
    description=_DESCRIPTION,
    operation_id="read_export",
    response_class=Response,
    responses=_FILE,
)
@priced("cheap")
async def export(
    job_id: JobId,
    request: Request,
    results: ResultsDep,
    on_demand: OnDemandDep,
    f: Annotated[
        Literal["gpkg", "qgz", "kmz", "pmtiles", "fgb", "kml", "csv", "geojson", "parquet"],
        Query(description="Format, as in names of files."),
    ] = "gpkg",
    layer: Annotated[
        Literal[LayerName, "branches", "uncertainty", "all"] | None,
        Query(
            description="Layer to export, or `all`: by default intersections, roads, trajectory and osm_nodes, or the "
            "intersections where a format holds one; `qgz` holds all. Branches (lines) and uncertainty "
            "(ellipses) are made of the intersections."
        ),
    ] = None,
) -> Response:
    """Give a file of a result, which workers make when it is asked for first."""
    suffix = f".{f}"
    result = await run_in_threadpool(results.open, job_id)
    if suffix == ".parquet" and not has_parquet():
        detail = f"GeoParquet needs pyarrow, which the operator installs: {install('parquet')}"
        raise Problem(FORMAT_NOT_INSTALLED, detail)
    holds = FORMATS[suffix].layers
    if layer is not None and holds == "all":
        raise ConfigError(f"A {suffix} file holds all layers; leave layer out, or ask for f=gpkg.")
    if layer is None and holds == "one":
        layer = "intersections"
    if layer == ALL and holds == "one":
        raise ConfigError(f"A {suffix} file holds one layer: name it, or ask for f=gpkg.")
    name = layer or "layers"
    path = export_path(result.cache, f"{name}{suffix}", result.drive_name)
    if not path.exists():
        if on_earth := FORMATS[suffix].only_on_earth or (layer in DERIVED and "Shapes made of the intersections"):
            result.require_georeference(f"{on_earth} needs them; f=gpkg and f=qgz are in metres of its own frame")
        if layer not in {None, ALL}:
            result.layer_file("intersections" if layer in DERIVED else layer)
        await on_demand.export(result, path, layer, request.state.holder.name)
    file_name = f"{result.slug}{suffix}" if layer is None else f"{result.slug}-{name}{suffix}"
    return await run_in_threadpool(deliver, request, path, name=file_name, download=True)
