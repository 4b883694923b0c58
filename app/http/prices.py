"""What operations cost: each declares it where it is declared, and its limits follow from that.

A cheap one takes less than 50 ms of CPU time, whatever is stored. A heavy one begins when its client has a turn: few
are at work at a time, shared by the clients, and no thread is held by those that wait; it gives pages, or says what
bounds it. A streaming one gives or takes bytes for as long as its client does, and limits what it takes itself.
"""

import asyncio
import inspect
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar
from weakref import WeakValueDictionary

from fastapi import Depends, Request

from app.context import part_of_app
from app.http.problem_types import BUSY
from app.http.problems import Problem
from app.store.tokens import ANONYMOUS

MAX_JSON_BYTES = 1024**2
_AT_ONCE = 3  # each may take a hundred megabytes, and all share one interpreter with everything else
_OF_ONE_CLIENT = _AT_ONCE - 1  # whatever one client asks for, another has a turn at once
_PATIENCE_S = 10.0
_MAX_WAITING = 64  # of one client

_RETRY_S = 5


class Turns:
    """Lets heavy requests begin, in the order in which they came: but only two of each client are in that line.

    All of it runs in the event loop of the server. Work that needs a thread takes one when it has its turn: those that
    wait keep none from anybody.
    """

    def __init__(self) -> None:
        self._all = asyncio.Semaphore(_AT_ONCE)
        self._clients: WeakValueDictionary[str, asyncio.Semaphore] = WeakValueDictionary()
        self._asked: Counter[str] = Counter()

    @asynccontextmanager
    async def of(self, request: Request) -> AsyncIterator[None]:
        """Wait for a turn of the client of a request (503 after too long), and have it in the block."""
        client = _name_of(request)
        own = self._clients.setdefault(client, asyncio.Semaphore(_OF_ONE_CLIENT))
        if self._asked[client] >= _OF_ONE_CLIENT + _MAX_WAITING:
            raise _busy()
        self._asked[client] += 1
        try:
            async with AsyncExitStack() as turn:
                try:
                    async with asyncio.timeout(_PATIENCE_S):
                        await turn.enter_async_context(own)
                        await turn.enter_async_context(self._all)
                except TimeoutError:
                    raise _busy() from None
                yield
        finally:
            self._asked[client] -= 1
            self._asked += Counter()  # forgets the clients that have none


def _name_of(request: Request) -> str:
    """Return who asks: clients without a token are told apart by their address."""
    name: str = request.state.holder.name
    return f"{name} {request.client.host}" if name == ANONYMOUS and request.client is not None else name


def _busy() -> Problem:
    detail = "Earlier requests of this client for features or layers are still being answered. Send fewer at a time."
    return Problem(BUSY, detail, headers={"Retry-After": str(_RETRY_S)})


TurnsDep = Annotated[Turns, part_of_app("turns")]


@dataclass(frozen=True)
class Price:
    """What an operation takes of the server."""

    kind: Literal["cheap", "heavy", "streaming"]
    bound: str | None = None
    """What bounds it, where it does not give pages."""
    body_bytes: int | None = MAX_JSON_BYTES
    """What its body may have, which is read before it begins; None: the operation itself counts what it receives."""


Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])


def priced(
    kind: Literal["cheap", "heavy", "streaming"], *, bound: str | None = None, body_bytes: int = MAX_JSON_BYTES
) -> Callable[[Endpoint], Endpoint]:
    """Declare what an operation costs."""

    def declare(endpoint: Endpoint) -> Endpoint:
        endpoint.price = Price(kind, bound, None if kind == "streaming" else body_bytes)  # type: ignore[attr-defined]
        return endpoint

    return declare


def price_of(endpoint: Callable[..., Any]) -> Price:
    """Return what an operation costs; a TypeError if it does not say so.

    One that is heavy or lists something has pages (`limit`) or says its bound.
    """
    price: Price | None = getattr(endpoint, "price", None)
    if price is None:
        raise TypeError(f"{endpoint.__name__} does not say what it costs")
    gives_much = price.kind == "heavy" or endpoint.__name__.startswith("list_")
    if gives_much and price.bound is None and "limit" not in inspect.signature(endpoint).parameters:
        raise TypeError(f"{endpoint.__name__} gives no pages, and does not say what bounds it")
    return price


async def _in_turn(request: Request, turns: TurnsDep) -> AsyncIterator[None]:
    async with turns.of(request):
        yield


TURN = Depends(_in_turn, scope="function")
"""The dependency of a heavy operation."""
