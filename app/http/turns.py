"""Turns at reading that takes longer than a moment: few at a time, shared by the clients, and no thread is held."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Annotated
from weakref import WeakValueDictionary

from fastapi import Depends, Request

from app.context import part_of_app
from app.http.problem_types import BUSY
from app.http.problems import Problem
from app.store.tokens import ANONYMOUS

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


async def _turn(request: Request, turns: TurnsDep) -> AsyncIterator[None]:
    async with turns.of(request):
        yield


IN_TURN = [Depends(_turn, scope="function")]
"""``dependencies`` of an address whose every answer is heavy: its endpoint begins when the client has a turn."""
