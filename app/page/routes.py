"""The page, what it needs to know, and the documentation of the API."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response
from pydantic import BaseModel, ConfigDict, Field

from app.context import ContextDep, part_of_app
from app.http.delivery import answer_tagged, deliver, media_type_of
from app.http.openapi import get_and_head
from app.http.prices import priced
from app.http.problem_types import NOT_FOUND
from app.http.problems import Problem
from app.jobs.models import MAX_COMPARED_JOBS, Near
from app.page.files import (
    DOCS_POLICY,
    INDEX,
    SWAGGER,
    SWAGGER_PAGE,
    SWAGGER_START,
    VERSION_MARK,
    PageFiles,
)
from app.paths import ARCHIVE_ENDINGS
from app.settings import Settings
from interloc.drives.formats import FORMATS, installed_formats
from interloc.drives.labels import SCHEMES
from interloc.drives.layouts import PCD_ENDINGS, RECORDING_ENDINGS, SMALL_ENDINGS, TRACK_ENDINGS
from interloc.drives.options import ReadingOptions
from interloc.osm.container import MAP_ENDINGS, SIMULATOR
from interloc.osm.intersections import DRIVABLE_OR_SERVICE
from interloc.osm.policies import POLICIES
from interloc.output.layers import LAYERS
from interloc.output.vector_files import suffixes_here

# What the page is told about the service: settings, and the words for what a user chooses and sees.


class PolicyModel(BaseModel):
    """A policy: which OSM nodes count as intersections."""

    name: str = Field(examples=["drive"])
    title: str = Field(examples=["Drivable public roads"])
    description: str


class LayerModel(BaseModel):
    """A layer of a result."""

    model_config = ConfigDict(from_attributes=True)

    name: str = Field(description="Name of the layer and of its GeoJSON file.", examples=["osm_nodes"])
    description: str
    is_osm: bool = Field(description="Whether the layer holds data of OpenStreetMap.")


class LabelSchemeModel(BaseModel):
    """Meaning of the label ids of a drive."""

    name: str = Field(examples=["semantickitti"])
    title: str = Field(examples=["SemanticKITTI"])
    road: list[int] = Field(description="Ids of road.")


class FileKinds(BaseModel):
    """Which files of a drive are which, by name."""

    maps: list[str] = Field(description="Endings of OSM files, in lower case.", examples=[[".osm", ".osm.gz"]])
    archives: list[str] = Field(description="Endings of archives that hold a whole drive.", examples=[[".zip"]])
    recordings: list[str] = Field(description="Endings of files that hold many scans.", examples=[[".bag", ".mcap"]])
    scans: list[str] = Field(
        description="Endings of scans that only the service reads: they are sent as they are.", examples=[[".pcd"]]
    )
    small: list[str] = Field(description="Endings of small files, whose contents a look is given.", examples=[[".txt"]])
    beside: list[str] = Field(description="Endings of what may lie beside the scans.", examples=[[".sbet"]])


class RangeModel(BaseModel):
    """Bounds of a number that a user may choose."""

    default: float
    minimum: float
    maximum: float


class PageConfig(BaseModel):
    """What the page needs to know of the service."""

    version: str = Field(examples=["0.1.0"])
    tile_url: str | None = Field(description="Address pattern of map tiles that the page may offer; null: none.")
    tile_attribution: str
    overpass: bool = Field(description="Whether jobs may fetch the map from Overpass.")
    needs_token: bool = Field(description="Whether the API expects `Authorization: Bearer TOKEN`.")
    trash_h: float = Field(description="For how long deleted drives can be restored, hours; 0: not at all.")
    policies: list[PolicyModel] = Field(
        description="Which OSM nodes can count as intersections; the first is the default."
    )
    layers: list[LayerModel] = Field(description="Layers of a result.")
    exports: list[str] = Field(
        description="Endings of the exports that this service writes.", examples=[[".gpkg", ".pmtiles"]]
    )
    label_schemes: list[LabelSchemeModel] = Field(description="Label schemes with a name.")
    file_kinds: FileKinds
    layouts: dict[str, str] = Field(description="Titles of the layouts of drives, by name.")
    reading_schema: dict[str, Any] = Field(description="JSON Schema of how a drive can be read (`options` of a drive).")
    simulator: str = Field(description="`generator` of OSM files that are made up.", examples=["interloc simulate"])
    drivable: list[str] = Field(description="Values of `highway` that are drawn as roads for cars.")
    search_radius_km: RangeModel = Field(description="How far around a place a drive is searched for on the map.")
    max_compared_jobs: int = Field(description="How many jobs can be compared at once.")

    @classmethod
    def of(cls, settings: Settings, *, version: str, needs_token: bool) -> PageConfig:
        """Gather it."""
        return cls(
            version=version,
            tile_url=settings.tile_url or None,
            tile_attribution=settings.tile_attribution,
            overpass=settings.overpass,
            needs_token=needs_token,
            trash_h=settings.trash_h,
            policies=_POLICIES,
            layers=_LAYERS,
            exports=suffixes_here(),
            label_schemes=_LABEL_SCHEMES,
            file_kinds=_FILE_KINDS,
            layouts={each.name: each.title for each in (*FORMATS, *installed_formats())} | {"reduced": "reduced drive"},
            reading_schema=ReadingOptions.model_json_schema(),
            simulator=SIMULATOR,
            drivable=sorted(DRIVABLE_OR_SERVICE),
            search_radius_km=_SEARCH_RADIUS_KM,
            max_compared_jobs=MAX_COMPARED_JOBS,
        )


_SEARCH_RADIUS_KM = RangeModel.model_validate(Near.model_json_schema()["properties"]["radius_km"])
_POLICIES = [
    PolicyModel(name=name, title=wording.title, description=wording.meaning) for name, wording in POLICIES.items()
]
_LAYERS = [LayerModel.model_validate(layer) for layer in LAYERS.values()]
_SCHEME_TITLES = {
    "semantickitti": "SemanticKITTI",
    "learning": "Learning ids 0 to 19",
    "kitti360": "KITTI-360",
    "las": "LAS classification",
}
_LABEL_SCHEMES = [
    LabelSchemeModel(name=scheme.name, title=_SCHEME_TITLES[scheme.name], road=sorted(scheme.road))
    for scheme in SCHEMES.values()
]
_FILE_KINDS = FileKinds(
    maps=list(MAP_ENDINGS),
    archives=list(ARCHIVE_ENDINGS),
    recordings=list(RECORDING_ENDINGS),
    scans=list(PCD_ENDINGS),
    small=list(SMALL_ENDINGS),
    beside=[*TRACK_ENDINGS, ".yaml"],
)


router = APIRouter(tags=["System"])

_ASK = "no-cache"
_KEEP = "public, max-age=31536000, immutable"


PageFilesDep = Annotated[PageFiles, part_of_app("page_files")]


_HIDDEN: dict[str, Any] = {"include_in_schema": False, "response_class": Response}


@get_and_head(router, "/", **_HIDDEN)
@priced("cheap")
def read_index(request: Request, files: PageFilesDep) -> Response:
    """Give the page, or redirect to the documentation where it is not installed."""
    if not files.are_complete():
        return RedirectResponse(f"{request.scope.get('root_path', '')}/docs")
    return answer_tagged(request, files.index(), media_type_of(files.root / INDEX), **{"cache-control": _ASK})


@get_and_head(router, "/static/{path:path}", **_HIDDEN)
@priced("streaming")
def read_asset(path: str, request: Request, files: PageFilesDep) -> Response:
    """Give a file of the page; under the address with its version it stays what it is."""
    cache_control = _ASK
    if path.startswith(VERSION_MARK):
        version, _, path = path.removeprefix(VERSION_MARK).partition("/")
        cache_control = _KEEP if version == files.version() else _ASK
    found = files.find(path)
    if found is None:
        raise Problem(NOT_FOUND, f"The page has no file {path!r}.")
    return deliver(request, found, cache_control=cache_control, policy=None)


@get_and_head(router, "/docs", **_HIDDEN)
@priced("cheap")
def read_docs(request: Request, files: PageFilesDep) -> Response:
    """Give the documentation of the API; where the page is not installed, its description for programs."""
    if files.find(SWAGGER) is None:
        return RedirectResponse(f"{request.scope.get('root_path', '')}/openapi.json")
    return HTMLResponse(SWAGGER_PAGE, headers={"content-security-policy": DOCS_POLICY, "cache-control": _ASK})


@get_and_head(router, "/docs/start.js", **_HIDDEN)
@priced("cheap")
def read_docs_start() -> Response:
    """Give the script that starts Swagger UI: the policy of the service allows none within a page."""
    return Response(SWAGGER_START, media_type="text/javascript", headers={"cache-control": _ASK})


@router.get("/config.json", summary="What the page needs to know", operation_id="read_page_config")
@priced("cheap")
def read_config(request: Request, context: ContextDep) -> PageConfig:
    """Give version, tiles, the words for what a user chooses, and whether a token is needed.

    Open to everybody: it holds no secrets.
    """
    return PageConfig.of(context.settings, version=request.app.version, needs_token=context.tokens.exist())
