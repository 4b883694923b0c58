"""How a request is received: uvicorn's protocol, with limits of the head and of connections that it does not have."""

from __future__ import annotations

import asyncio
import json
from urllib.parse import urlsplit

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from app.http.problem_types import HEAD_TOO_LARGE, REQUEST_MALFORMED, TOO_MANY_CONNECTIONS
from app.http.problems import MEDIA_TYPE, Problem

MAX_HEAD_BYTES = 64 * 1024
HEAD_S = 20.0


class _RefusedError(Exception):
    """A head that is not to be answered; the parser passes it on as its own error."""


class Protocol(HttpToolsProtocol):
    """Closes connections whose request line and headers do not arrive, or do not end; and those that are too many."""

    head_s = HEAD_S
    max_connections = 4000
    """Those beyond are closed at once: descriptors must be left for files, the database and the workers."""

    _complaint = ""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # like the base class
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._in_head = False
        self._head_bytes = 0
        self._head_timer: asyncio.TimerHandle | None = self._start_timer()
        if len(self.connections) > self.max_connections:
            self._answer(Problem(TOO_MANY_CONNECTIONS, "Try again in a moment."))

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        self._stop_timer()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Begin to count the head of a request."""
        self._in_head = True
        self._head_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Count no longer: what follows is the body."""
        self._in_head = False
        self._stop_timer()
        self._check_target()
        super().on_headers_complete()

    def data_received(self, data: bytes) -> None:
        """Take what arrived; an unfinished head may neither grow without end nor trickle in for ever."""
        super().data_received(data)
        if not self._in_head or self.transport.is_closing():
            return
        self._head_bytes += len(data)
        if self._head_bytes > MAX_HEAD_BYTES:
            self._answer(Problem(HEAD_TOO_LARGE, f"The headers of a request may have {MAX_HEAD_BYTES // 1024} kB."))
        elif self._head_timer is None:
            self._head_timer = self._start_timer()

    def send_400_response(self, msg: str) -> None:
        """Refuse what is not HTTP, by a problem document as everywhere else."""
        what = self._complaint or f"{msg.rstrip('.')}: it does not keep to HTTP/1.1."
        self._answer(Problem(REQUEST_MALFORMED, what))

    def _check_target(self) -> None:
        """Refuse a target that names another host than the header Host: which one is meant is not clear."""
        if self.url.startswith((b"/", b"*")):
            return
        try:
            target = urlsplit(self.url.decode("ascii"))
        except ValueError:
            target = urlsplit("")
        hosts = [value.decode("latin-1").lower() for name, value in self.headers if name == b"host"]
        if target.scheme not in {"http", "https"} or hosts != [target.netloc.lower()]:
            self._complaint = "The target of the request names another host than its header Host, or none."
            raise _RefusedError

    def _start_timer(self) -> asyncio.TimerHandle:
        return self.loop.call_later(self.head_s, self.transport.close)

    def _stop_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _answer(self, problem: Problem) -> None:
        content = json.dumps(problem.document()).encode()
        head = f"content-type: {MEDIA_TYPE}\r\ncontent-length: {len(content)}\r\nconnection: close\r\n\r\n"
        self.transport.write(STATUS_LINE[problem.status] + head.encode() + content)
        self.transport.close()
