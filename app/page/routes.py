"""The page, what it needs to know, and the documentation of the API."""

from typing import Annotated, Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from app.context import ContextDep, part_of_app
from app.http.delivery import answer_tagged, deliver, media_type_of
from app.http.openapi import get_and_head
from app.http.prices import priced
from app.http.problem_types import NOT_FOUND
from app.http.problems import Problem
from app.page.files import (
    DOCS_POLICY,
    INDEX,
    SWAGGER,
    SWAGGER_PAGE,
    SWAGGER_START,
    VERSION_MARK,
    PageFiles,
)
from app.page.models import PageConfig

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
    """Give version, tiles, limits, the words for what a user chooses, and whether a token is needed.

    Open to everybody: it holds no secrets.
    """
    return PageConfig.of(context.settings, version=request.app.version, needs_token=context.tokens.exist())
