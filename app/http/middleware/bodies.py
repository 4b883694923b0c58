"""Limits of what a client sends: small JSON, and no body that stops half-way for ever."""

from __future__ import annotations

import asyncio
import re

from starlette._utils import get_route_path
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.http.problems import Problem, respond

MAX_JSON_BYTES = 1024**2

# Uploads stream their body and count it themselves, against limits of their own.
_STREAMS = re.compile(r"/api/v1/drives/[^/]+/(files/.+|scans|archive)")


class Bodies:
    """Reads the body of a request before its endpoint does, except for uploads.

    Parameters
    ----------
    app
        What is inside.
    idle_s
        A body that pauses for so long is given up.
    """

    def __init__(self, app: ASGIApp, idle_s: float) -> None:
        self._app = app
        self._idle_s = idle_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Read or limit the body, then go on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        patient = self._patient(receive)
        if not _STREAMS.fullmatch(get_route_path(scope)):
            try:
                patient = await _read(scope, patient)
            except HTTPException as error:
                problem = Problem(error.status_code, "Body refused", error.detail, headers={"Connection": "close"})
                await respond(problem, scope["path"])(scope, receive, send)
                return
        await self._app(scope, patient, send)

    def _patient(self, receive: Receive) -> Receive:
        """Give up on a body that pauses."""
        more = True

        async def receive_in_time() -> Message:
            nonlocal more
            if not more:  # waiting for the client to go away, as a stream of events does
                return await receive()
            try:
                async with asyncio.timeout(self._idle_s):
                    message = await receive()
            except TimeoutError as error:
                detail = f"Nothing more of the body came for {self._idle_s:g} seconds."
                raise HTTPException(408, detail, headers={"Connection": "close"}) from error
            more = message["type"] == "http.request" and message.get("more_body", False)
            return message

        return receive_in_time


async def _read(scope: Scope, receive: Receive) -> Receive:
    """Read a small body at once; return how it is received again."""
    lengths = [value for name, value in scope["headers"] if name == b"content-length"]
    has_body = bool(lengths) or any(name == b"transfer-encoding" for name, _ in scope["headers"])
    if not has_body:
        return receive
    too_large = HTTPException(413, f"The body is larger than {MAX_JSON_BYTES:,} bytes, which no such request needs.")
    if lengths and int(lengths[0]) > MAX_JSON_BYTES:
        raise too_large
    messages: list[Message] = []
    size = 0
    while True:
        message = await receive()
        messages.append(message)
        size += len(message.get("body", b""))
        if size > MAX_JSON_BYTES:
            raise too_large
        if message["type"] != "http.request" or not message.get("more_body", False):
            break

    async def receive_again() -> Message:
        return messages.pop(0) if messages else await receive()

    return receive_again
