"""Routers: what holds for all operations is said here once, so that a feature declares only what is its own."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

from fastapi import APIRouter, Depends
from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import Message, Receive, Scope, Send

from app.http.gate import client_of
from app.http.openapi import PROBLEMS, UNLISTED
from app.http.parameters import refuse_unknown_parameters
from app.http.prices import TURN, Endpoint, price_of

API = "/api/v1"

IDLE_S = 60.0
"""A body that pauses for so long is given up; so is one that kept the server waiting for longer than that, and was
slower on the average than `BYTES_PER_S`."""
BYTES_PER_S = 1024.0


class Operation(APIRoute):
    """An operation; its body comes in time, and is no larger than its price says."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:  # noqa: ANN401 - FastAPI's
        self.price = price_of(endpoint)
        super().__init__(path, endpoint, **options)

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        length = int(Headers(scope=scope).get("content-length", "0"))
        await super().handle(scope, _limited(receive, length, self.price.body_bytes), send)


class Router(APIRouter):
    """Operations that are named like their functions, so that generated clients have good names."""

    def __init__(self, prefix: str = "", **options: Any) -> None:  # noqa: ANN401 - FastAPI's
        super().__init__(
            prefix=prefix,
            responses=PROBLEMS,
            generate_unique_id_function=lambda route: route.name,
            route_class=Operation,
            **options,
        )

    def get_and_head(self, path: str, **options: Any) -> Callable[[Endpoint], Endpoint]:  # noqa: ANN401
        """Register an address for GET, and for HEAD without a second entry in the OpenAPI."""
        unchanged = {304: {"description": "Nothing has changed (If-None-Match)."}}
        options["responses"] = {**unchanged, **options.get("responses", {})}

        def register(endpoint: Endpoint) -> Endpoint:
            self.add_api_route(path, endpoint, methods=["GET"], **options)
            self.add_api_route(path, endpoint, methods=["HEAD"], **{**options, "include_in_schema": False})
            return endpoint

        return register


class ApiRouter(Router):
    """The same for those who have a token, where one is needed; what is heavy waits for its turn."""

    def __init__(self, prefix: str = API, **options: Any) -> None:  # noqa: ANN401
        super().__init__(prefix, dependencies=[Depends(client_of), Depends(refuse_unknown_parameters)], **options)

    def add_api_route(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:  # noqa: ANN401
        """Register an operation."""
        if price_of(endpoint).kind == "heavy":
            options["dependencies"] = [TURN, *(options.get("dependencies") or ())]
        if UNLISTED.fullmatch(self.prefix + path):
            options["include_in_schema"] = False
        super().add_api_route(path, endpoint, **options)


def _limited(receive: Receive, length: int, limit: int | None) -> Receive:
    """Return how a body is received of which so many bytes are announced, and so many may come; None: any number."""
    more = True
    too_large = _refused(413, f"The body is larger than {limit or 0:,} bytes, which no such request needs.")
    waited_s, received_bytes = 0.0, 0  # what the server itself needs to store a piece does not count

    async def receive_in_time() -> Message:
        nonlocal more, waited_s, received_bytes
        if not more:  # waiting for the client to go away, as a stream of events does
            return await receive()
        if limit is not None and length > limit:
            raise too_large
        began = time.monotonic()
        try:
            async with asyncio.timeout(IDLE_S):
                message = await receive()
        except TimeoutError as error:
            raise _refused(408, f"Nothing more of the body came for {IDLE_S:g} seconds.") from error
        waited_s += time.monotonic() - began
        received_bytes += len(message.get("body", b""))
        more = message["type"] == "http.request" and message.get("more_body", False)
        if limit is not None and received_bytes > limit:
            raise too_large
        if more and waited_s > IDLE_S and received_bytes < BYTES_PER_S * waited_s:
            raise _refused(
                408,
                f"{received_bytes:,} bytes of the body came in {waited_s:.0f} seconds; expected "
                f"{BYTES_PER_S:,.0f} per second on the average.",
            )
        return message

    return receive_in_time


def _refused(status: int, detail: str) -> HTTPException:
    return HTTPException(status, detail, headers={"Connection": "close"})
