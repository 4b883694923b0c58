"""The page, what it needs to know, and the documentation of the API."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response

from app.context import Context, ContextDep, part_of_app
from app.http.delivery import deliver
from app.http.page import DOCS_POLICY, INDEX, SWAGGER, SWAGGER_PAGE, SWAGGER_START, PageFiles, list_addresses
from app.http.problems import Problem
from app.schemas.page import PageConfig

router = APIRouter(tags=["System"])


PageFilesDep = Annotated[PageFiles, part_of_app("page_files")]


def _add(path: str, endpoint: Any) -> None:  # noqa: ANN401 - any endpoint
    for method in ("GET", "HEAD"):
        router.add_api_route(path, endpoint, methods=[method], include_in_schema=False, response_class=Response)


def read_index(request: Request, files: PageFilesDep, context: ContextDep) -> Response:
    """Give the page, or redirect to the documentation where it is not installed."""
    if not files.are_complete():
        return RedirectResponse(f"{request.scope.get('root_path', '')}/docs")
    return _give(request, files, context, INDEX)


def read_asset(path: str, request: Request, files: PageFilesDep, context: ContextDep) -> Response:
    """Give a file of the page."""
    return _give(request, files, context, path)


def read_docs(request: Request, files: PageFilesDep) -> Response:
    """Give the documentation of the API."""
    headers = {"content-security-policy": DOCS_POLICY, "cache-control": "no-cache"}
    if files.find(SWAGGER) is not None:
        return HTMLResponse(SWAGGER_PAGE, headers=headers)
    return HTMLResponse(list_addresses(request.app.openapi()), headers=headers)


def read_docs_start() -> Response:
    """Give the script that starts Swagger UI: the policy of the service allows none within a page."""
    return Response(SWAGGER_START, media_type="text/javascript", headers={"cache-control": "no-cache"})


@router.get("/config.json", summary="What the page needs to know", operation_id="read_page_config")
def read_config(request: Request, context: ContextDep) -> PageConfig:
    """Give version, tiles, limits, the words for what a user chooses, and whether a token is needed.

    Open to everybody: it holds no secrets.
    """
    return PageConfig.of(context.settings, version=request.app.version, needs_token=context.tokens.exist())


def _give(request: Request, files: PageFiles, context: Context, name: str) -> Response:
    path = files.find(name)
    if path is None:
        raise Problem(404, "Not found", f"The page has no file {name!r}.")
    copies = context.storage.folder("cache/page")
    return deliver(request, path, gzip_copies=copies, cache_control="no-cache", policy=None)


_add("/", read_index)
_add("/static/{path:path}", read_asset)
_add("/docs", read_docs)
_add("/docs/start.js", read_docs_start)
