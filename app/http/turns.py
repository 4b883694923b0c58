"""Turns at reading that takes longer than a moment: few at a time, shared by the clients, and no thread is held."""

from __future__ import annotations

import asyncio
from collections import Counter, deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Annotated

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
    """Lets heavy requests begin: the client with the fewest at work first, then the one that has waited longest.

    All of it runs in the event loop of the server. Work that needs a thread takes one when it has its turn: those that
    wait keep none from anybody.
    """

    def __init__(self) -> None:
        self._at_work: Counter[str] = Counter()
        self._waiting: dict[str, deque[asyncio.Future[None]]] = {}

    @asynccontextmanager
    async def of(self, request: Request) -> AsyncIterator[None]:
        """Wait for a turn of the client of a request (503 after too long), and have it in the block."""
        client = _name_of(request)
        await self._wait(client)
        try:
            yield
        finally:
            self._end(client)

    async def _wait(self, client: str) -> None:
        line = self._waiting.setdefault(client, deque())
        if len(line) >= _MAX_WAITING:
            raise _busy()
        turn = asyncio.get_running_loop().create_future()
        line.append(turn)
        self._begin_what_may()
        try:
            async with asyncio.timeout(_PATIENCE_S):
                await turn
        except BaseException as error:
            with suppress(ValueError):
                line.remove(turn)
            if turn.done() and not turn.cancelled():  # it was given at the last moment
                self._end(client)
            if isinstance(error, TimeoutError):
                raise _busy() from None
            raise

    def _end(self, client: str) -> None:
        self._at_work[client] -= 1
        self._at_work += Counter()  # forgets the clients that have none
        self._begin_what_may()

    def _begin_what_may(self) -> None:
        self._waiting = {client: line for client, line in self._waiting.items() if line}
        while self._at_work.total() < _AT_ONCE:
            may = [client for client in self._waiting if self._at_work[client] < _OF_ONE_CLIENT]
            if not may:
                return
            client = min(may, key=lambda client: self._at_work[client])
            line = self._waiting.pop(client)
            turn = line.popleft()
            if line:
                self._waiting[client] = line  # behind the others
            if not turn.done():
                turn.set_result(None)
                self._at_work[client] += 1


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
