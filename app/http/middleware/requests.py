"""One line of log and one count of metrics a request, and an id for it."""

from __future__ import annotations

import logging
import re
import secrets
import time

from starlette._utils import get_route_path
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app import logs
from app.metrics import Metrics

_GIVEN_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
_ABOUT = re.compile(r"/api/v1/(drive|job)s/([0-9a-f]{16})(?=/|$)")
_API = "/api/v1"
_QUIET = {"/healthz", "/readyz", "/metrics"}
_GONE = 499  # nginx's status for a client that did not wait for the answer

_log = logging.getLogger("app.access")


class RequestLog:
    """The outermost one: it sees what all others answer.

    Parameters
    ----------
    app
        What is inside.
    root_path
        Path under which a reverse proxy shows the service; the proxy may take it off or leave it on.
    """

    def __init__(self, app: ASGIApp, root_path: str = "") -> None:
        self._app = app
        self._root_path = root_path

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Go on, and see how it ends."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope["root_path"] = self._root_path
        request = _Request(scope)
        logs.reset()
        logs.bind(request=request.id, **request.about)

        async def receive_and_count() -> Message:
            message = await receive()
            request.received_bytes += len(message.get("body", b""))
            return message

        async def send_and_note(message: Message) -> None:
            request.note(message)
            await send(message)

        try:
            await self._app(scope, receive_and_count, send_and_note)
        finally:
            request.end()


class _Request:
    def __init__(self, scope: Scope) -> None:
        self._scope = scope
        self._started = time.perf_counter()
        self._metrics: Metrics = scope["app"].state.context.metrics
        self._path = get_route_path(scope)
        self._is_stream = False
        given = Headers(scope=scope).get("x-request-id", "")
        self.id = given if _GIVEN_ID.fullmatch(given) else secrets.token_hex(8)
        about = _ABOUT.match(self._path)
        self.about = {about[1]: about[2]} if about else {}
        self.status = _GONE
        self.received_bytes = 0

    def note(self, message: Message) -> None:
        """See the beginning of the answer."""
        if message["type"] != "http.response.start":
            return
        self.status = message["status"]
        headers = MutableHeaders(scope=message)
        headers["x-request-id"] = self.id
        self._is_stream = headers.get("content-type", "").startswith("text/event-stream")

    def end(self) -> None:
        """Log and count it."""
        seconds = time.perf_counter() - self._started
        self._metrics.count_request(
            self._scope["method"],
            self._route(),
            self.status,
            seconds=None if self._is_stream else seconds,
            received_bytes=self.received_bytes,
        )
        level = logging.ERROR if self.status >= 500 and self.status != 503 else logging.INFO
        if self._path in _QUIET and self.status < 500:
            level = logging.DEBUG
        _log.log(
            level,
            "%s %s %d",
            self._scope["method"],
            self._path,
            self.status,
            extra={
                "method": self._scope["method"],
                "path": self._path,
                "status": self.status,
                "duration_ms": round(seconds * 1000, 1),
                "received_bytes": self.received_bytes or None,
            },
        )

    def _route(self) -> str:
        """Return the template of the address: addresses themselves are too many for a label."""
        template: str | None = getattr(self._scope.get("route"), "path_format", None)
        if template is None:
            return "(none)"
        is_below = self._path.startswith(f"{_API}/") and not template.startswith(_API)  # templates lack the prefix
        return _API + template if is_below else template
