"""What every request passes, from the outside in: log and headers, faults, gate."""

import logging
import re
import secrets
import time
from asyncio import CancelledError
from urllib.parse import urlsplit

from fastapi import FastAPI
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.cors import CORSMiddleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app import logs
from app.http.delivery import MIN_PACKED_BYTES, PACKING_LEVEL
from app.http.gate import Gate, is_api, path_of
from app.http.problems import problem_of, respond
from app.metrics import Metrics
from app.settings import Settings

DATA_POLICY = "default-src 'none'; frame-ancestors 'none'; base-uri 'none'; sandbox"
"""Policy of what lies below the API, should a browser take it for a document: it may be anything that was uploaded."""

_READABLE = (
    "Accept-Ranges", "Content-Disposition", "Content-Range", "ETag", "Last-Modified", "Location",
    "Preference-Applied", "Retry-After", "WWW-Authenticate", "X-Request-ID",
)  # fmt: skip
"""Headers of answers that pages of other sites may see."""

_PACKED_ALREADY = (
    *DEFAULT_EXCLUDED_CONTENT_TYPES,
    "application/octet-stream",  # files as they were sent keep the ETag of their bytes
    "application/vnd.apache.parquet",
    "application/vnd.google-earth.kmz",
    "application/vnd.pmtiles",
    "application/x-qgis-project-container",
    "image/tiff",
)

_GIVEN_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_ABOUT = re.compile(r"/api/v1/(drive|job)s/([0-9a-f]{16})(?=/|$)")
_QUIET = {"/healthz", "/readyz", "/metrics"}
_FREQUENT = {"put_file", "post_scans", "look_into_folder"}
_GONE = 499  # nginx's status for a client that did not wait for the answer

_log = logging.getLogger("app.access")
_audit = logging.getLogger("app.audit")


def add_middleware(app: FastAPI, settings: Settings) -> None:
    """Put all of it around the application; the last that is added is the outermost."""
    app.add_middleware(Gate, settings=settings)
    app.add_middleware(Faults)
    if settings.cors_origins:
        app.add_middleware(  # pages of other sites read, with a token of their own: browsers add nothing by themselves
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=("GET", "HEAD"),
            allow_headers=("Authorization", "If-None-Match", "If-Modified-Since", "Last-Event-ID", "Range"),
            expose_headers=_READABLE,
        )
    app.add_middleware(
        GZipMiddleware,
        minimum_size=MIN_PACKED_BYTES,
        compresslevel=PACKING_LEVEL,
        exclude_content_types=_PACKED_ALREADY,
    )
    app.add_middleware(Outermost, settings=settings)


class Outermost:
    """Gives each request an id, logs it in one line and counts it; tells browsers what they may do with the answer.

    It sees what all others answer; headers that an endpoint set stay. A reverse proxy that shows the service under its
    root path may take that off or leave it on.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._root_path = settings.root_path
        self._page_policy = page_policy(settings)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Go on, and see how it ends."""
        if scope["type"] in {"http", "websocket"}:
            scope["root_path"] = self._root_path
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope["path"] = _without_slash(scope["path"], path_of(scope))
        started = time.perf_counter()
        status, received_bytes, is_stream, location = _GONE, 0, False, ""
        path = path_of(scope)
        given = Headers(scope=scope).get("x-request-id", "")
        request_id = given if _GIVEN_ID.fullmatch(given) else secrets.token_hex(8)
        about = _ABOUT.match(path)
        logs.reset()
        logs.bind(request=request_id, **({about[1]: about[2]} if about else {}))

        async def receive_and_count() -> Message:
            nonlocal received_bytes
            message = await receive()
            received_bytes += len(message.get("body", b""))
            return message

        async def send_and_note(message: Message) -> None:
            nonlocal status, is_stream, location
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["x-request-id"] = request_id
                _complete(headers, scope, self._page_policy)
                is_stream = headers.get("content-type", "").startswith("text/event-stream")
                location = headers.get("location", "")
            await send(message)

        try:
            await self._app(scope, receive_and_count, send_and_note)
        finally:
            seconds = time.perf_counter() - started
            metrics: Metrics = scope["app"].state.context.metrics
            metrics.count_request(
                scope["method"],
                getattr(scope.get("route"), "path_format", "(none)"),  # addresses themselves are too many
                status,
                seconds=None if is_stream else seconds,
                received_bytes=received_bytes,
            )
            level = logging.ERROR if status >= 500 and status not in {501, 502, 503} else logging.INFO  # not faults
            if path in _QUIET and status < 500:
                level = logging.DEBUG
            fields = {
                "method": scope["method"],
                "path": path,
                "status": status,
                "duration_ms": round(seconds * 1000, 1),
                "received_bytes": received_bytes or None,
            }
            if status < 400:
                _note_change(scope, location)
            _log.log(level, "%s %s %d", scope["method"], path, status, extra=fields)


def _without_slash(path: str, below_root: str) -> str:
    """Return the path of a request as it has a route: of the API without a slash at its end.

    Clients such as OWSLib add one. To send them elsewhere would lose the path that a reverse proxy takes off. What may
    be the name of a file stays as it is.
    """
    is_plain = is_api(below_root) and "/files/" not in below_root
    return path.rstrip("/") if is_plain and path.endswith("/") else path


def _note_change(scope: Scope, location: str) -> None:
    """Log who changed what. Files and looks are left out: the request log has them, thousands for each drive."""
    state = scope.get("state", {})
    action = state.get("action")
    if action is None or action in _FREQUENT:
        return
    made = _ABOUT.search(location)
    about = {made[1]: made[2]} if made else {}
    name = state["holder"].name
    _audit.info("%s: %s", name, action, extra={"client": name, "action": action, **about})


_ALWAYS = {
    "x-content-type-options": "nosniff",
    # Tile servers require a referrer; other sites need not know which drive was looked at.
    "referrer-policy": "strict-origin-when-cross-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
}


def _complete(headers: MutableHeaders, scope: Scope, page_policy: str) -> None:
    """Add to the headers of an answer what browsers go by."""
    of_api = is_api(path_of(scope))
    for name, value in _ALWAYS.items():
        headers.setdefault(name, value)
    headers.setdefault("content-security-policy", DATA_POLICY if of_api else page_policy)
    if of_api:
        headers.setdefault("cache-control", "no-store")
    if "content-encoding" in headers and "etag" in headers:  # other bytes that say the same
        headers["etag"] = f"W/{headers['etag']}"


def page_policy(settings: Settings) -> str:
    """Return the policy of the page: its own files, and images of the tile server."""
    parts = urlsplit((settings.tile_url or "").replace("{s}", "*"))  # {s} stands for any subdomain
    has_tiles = parts.scheme in {"http", "https"} and parts.netloc
    tiles = f" {parts.scheme}://{parts.netloc}" if has_tiles else ""
    return (
        f"default-src 'self'; img-src 'self' data: blob:{tiles}; worker-src 'self'; connect-src 'self'; "
        "object-src 'none'; form-action 'self'; frame-src 'self'; frame-ancestors 'none'; base-uri 'none'"
    )


class Faults:
    """Turns an exception that no handler took into a problem document; its details are logged and not sent."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Go on, and answer in the place of what failed."""
        has_begun = False

        async def send_and_note(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await self._app(scope, receive, send_and_note)
        except (Exception, CancelledError) as error:
            if scope["type"] != "http" or has_begun:  # half an answer was sent: the connection can only be closed
                raise
            await respond(problem_of(error), scope["path"])(scope, receive, send)
