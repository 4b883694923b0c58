"""The page, what it needs to know, and the documentation of the API."""

from typing import Annotated

from fastapi import Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from app.context import ContextDep, part_of_app
from app.http.delivery import answer_tagged, deliver, media_type_of
from app.http.prices import priced
from app.http.problem_types import NOT_FOUND
from app.http.problems import Problem
from app.http.routing import Router
from app.jobs.models import MAX_COMPARED_JOBS, Near
from app.page.files import DOCS_POLICY, INDEX, SWAGGER, SWAGGER_PAGE, SWAGGER_START, VERSION_MARK, PageFiles
from app.paths import ARCHIVE_ENDINGS
from app.settings import Settings
from interloc.drives.formats import FORMATS, installed_formats
from interloc.drives.labels import SCHEMES
from interloc.drives.layouts import PCD_ENDINGS, RECORDING_ENDINGS, SMALL_ENDINGS, TRACK_ENDINGS
from interloc.drives.options import ReadingOptions
from interloc.osm.intersections import DRIVABLE_OR_SERVICE
from interloc.osm.policies import POLICIES
from interloc.osm.untrusted import MAP_ENDINGS, SIMULATOR
from interloc.output.layers import LAYERS
from interloc.output.vector_files import suffixes_here

# What the page is told about the service: settings, and the words for what a user chooses and sees.


_SCHEME_TITLES = {
    "semantickitti": "SemanticKITTI",
    "learning": "Learning ids 0 to 19",
    "kitti360": "KITTI-360",
    "las": "LAS classification",
}


def page_config(settings: Settings, *, version: str, needs_token: bool) -> dict[str, object]:
    """Return what the page must know of the service; the first policy is the default."""
    radius = Near.model_json_schema()["properties"]["radius_km"]
    return {
        "version": version,
        "tile_url": settings.tile_url or None,
        "tile_attribution": settings.tile_attribution,
        "overpass": bool(settings.overpass_url),
        "needs_token": needs_token,
        "trash_h": settings.trash_h,
        "policies": [
            {"name": name, "title": wording.title, "description": wording.meaning} for name, wording in POLICIES.items()
        ],
        "layers": [
            {"name": each.name, "description": each.description, "is_osm": each.is_osm} for each in LAYERS.values()
        ],
        "exports": suffixes_here(),
        "label_schemes": [
            {"name": each.name, "title": _SCHEME_TITLES[each.name], "road": sorted(each.road)}
            for each in SCHEMES.values()
        ],
        "file_kinds": {  # endings of files, in lower case
            "maps": MAP_ENDINGS,
            "archives": ARCHIVE_ENDINGS,
            "recordings": RECORDING_ENDINGS,
            "scans": PCD_ENDINGS,  # which only the service reads: they are sent as they are
            "small": SMALL_ENDINGS,  # whose contents a look is given
            "beside": (*TRACK_ENDINGS, ".yaml"),
        },
        "layouts": {each.name: each.title for each in (*FORMATS, *installed_formats())} | {"reduced": "reduced drive"},
        "reading_schema": ReadingOptions.model_json_schema(),
        "simulator": SIMULATOR,
        "drivable": sorted(DRIVABLE_OR_SERVICE),
        "search_radius_km": {name: radius[name] for name in ("default", "minimum", "maximum")},
        "max_compared_jobs": MAX_COMPARED_JOBS,
    }


router = Router(include_in_schema=False)

_ASK = "no-cache"
_KEEP = "public, max-age=31536000, immutable"


PageFilesDep = Annotated[PageFiles, part_of_app("page_files")]


@router.get_and_head("/", response_class=Response)
@priced("cheap")
def read_index(request: Request, files: PageFilesDep) -> Response:
    """Give the page, or redirect to the documentation where it is not installed."""
    if not files.are_complete():
        return RedirectResponse(f"{request.scope.get('root_path', '')}/docs")
    return answer_tagged(request, files.index(), media_type_of(files.root / INDEX), **{"cache-control": _ASK})


@router.get_and_head("/static/{path:path}", response_class=Response)
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


@router.get_and_head("/docs", response_class=Response)
@priced("cheap")
def read_docs(request: Request, files: PageFilesDep) -> Response:
    """Give the documentation of the API; where the page is not installed, its description for programs."""
    if files.find(SWAGGER) is None:
        return RedirectResponse(f"{request.scope.get('root_path', '')}/openapi.json")
    return HTMLResponse(SWAGGER_PAGE, headers={"content-security-policy": DOCS_POLICY, "cache-control": _ASK})


@router.get_and_head("/docs/start.js", response_class=Response)
@priced("cheap")
def read_docs_start() -> Response:
    """Give the script that starts Swagger UI: the policy of the service allows none within a page."""
    return Response(SWAGGER_START, media_type="text/javascript", headers={"cache-control": _ASK})


@router.get("/config.json")
@priced("cheap")
def read_config(request: Request, context: ContextDep) -> dict[str, object]:
    """Give what the page needs to know, and whether a token is needed; open to everybody, as it holds no secrets."""
    return page_config(context.settings, version=request.app.version, needs_token=context.tokens.exist())
