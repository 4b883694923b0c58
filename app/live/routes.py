"""Endpoints: live sessions."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import ExitStack, suppress
from importlib import import_module
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Request, Response, WebSocket
from fastapi.concurrency import run_in_threadpool
from fastapi.sse import EventSourceResponse, ServerSentEvent
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from app.context import Context, ContextDep, part_of_app
from app.http.fields import ID
from app.http.gate import ClientDep
from app.http.parameters import answer_page
from app.http.prices import priced
from app.http.problem_types import TOKEN_MAY_ONLY_READ
from app.http.problems import Problem, respond
from app.http.routing import API, ApiRouter
from app.jobs.submission import config_of
from app.live.sessions import SENT, Begin, Continue, End, Keeper, LiveEntry, LiveList, LiveSessions
from app.states import Scope
from app.store.tokens import ANONYMOUS, Holder
from interloc.errors import ConfigError, InterLocError
from interloc.wording import first_fault

router = ApiRouter(tags=["Live"])
sockets = APIRouter(prefix=API)

_FIRST_WORD_S, _SILENCE_S = 20.0, 5.0
_MAX_REASON_BYTES = 120  # of the 125 of a control frame (RFC 6455, section 5.5)
_MAX_TEXT = 64 * 1024
_REFUSED, _GOING_AWAY, _TOO_LARGE = 1008, 1001, 1009

LiveDep = Annotated[LiveSessions, part_of_app("live")]
SessionId = Annotated[str, Path(pattern=ID, description="Id of the session.")]

_log = logging.getLogger(__name__)


@router.get_and_head("/live", response_model=LiveList, summary="List live sessions")
@priced("cheap", bound="the sessions that may be at once")
async def list_live(request: Request, live: LiveDep) -> Response:
    """List the drives that are under way, or have just ended, the newest first."""
    return answer_page(request, LiveList(sessions=[entry.model() for entry in live.list()]))


@router.delete("/live/{session}", status_code=204)
@priced("cheap")
async def end_live(session: SessionId, live: LiveDep, client: ClientDep) -> None:
    """End a session of this client; its sender is told."""
    live.find(session, client).refuse("it was ended by a request of its owner.")


async def _watched(session: SessionId, live: LiveDep, client: ClientDep) -> LiveEntry:
    return live.watched(session, client)


@router.get("/live/{session}/events", response_class=EventSourceResponse)
@priced("streaming")
async def watch_live(
    entry: Annotated[LiveEntry, Depends(_watched)],
    request: Request,
    context: ContextDep,
    live: LiveDep,
    client: ClientDep,
) -> AsyncIterator[ServerSentEvent]:
    """Send the session as it is now, then what is said to its sender, until it ends (server-sent events).

    Each event is named `live`, its data is JSON. The first has the `type` `state`: `session`, `vehicle`, `track`,
    `intersections` and `roads` so far; those after it are as docs/live.md has them. After a broken connection the
    stream begins with the state again.
    """
    live.watching[client] += 1
    with context.metrics.listeners.track_inprogress(), ExitStack() as stack:
        stack.callback(live.watching.subtract, [client])
        async for text in entry.watch():
            if context.stopping.is_set() or not await _may_go_on(context, request.state.holder):
                return
            if text is not None:
                yield ServerSentEvent(event="live", raw_data=text)


@sockets.websocket("/live")
@priced("streaming")
async def drive_live(socket: WebSocket) -> None:
    """Take the scans of a sender: see the tag Live of the description of the API, and docs/live.md."""
    context: Context = socket.app.state.context
    holder: Holder = socket.state.holder
    if holder.scope != Scope.WRITE:
        problem = Problem(TOKEN_MAY_ONLY_READ, f"The token of {holder.name} may only read; a live session sends scans.")
        await socket.send_denial_response(respond(problem, socket.url.path))
        return
    await socket.accept()
    try:
        entry, answered = await _first_word(socket, socket.app.state.live, holder)
    except (TimeoutError, InterLocError, Problem, ValidationError, WebSocketDisconnect) as error:
        with suppress(WebSocketDisconnect, RuntimeError):
            await socket.send_json({"type": "refused", "frame": None, "reason": _reason_of(error)})
            await _close(socket, _reason_of(error))
        return
    sender = entry.attach(answered)
    _log.info("live session %s of %s", entry.id, holder.name)
    with suppress(WebSocketDisconnect, RuntimeError):  # the sender has gone; it may come back
        await socket.send_json({"type": "session", "id": entry.id, "last_frame": entry.last_frame})
        reading = asyncio.create_task(_read(socket, entry, sender, context, holder))
        try:
            while (text := await _next_of(sender)) is not None:
                if text:
                    await socket.send_text(text)
                elif not await _may_go_on(context, holder):  # one that sends nothing is heard of here
                    entry.refuse("its token was revoked.")
            if entry.refusal is not None:
                await _close(socket, entry.refusal)
            else:
                await socket.close(1000 if entry.is_over else _GOING_AWAY)
        finally:
            reading.cancel()
            entry.detach(sender)


async def _next_of(sender: asyncio.Queue[str | None]) -> str | None:
    """Return what a sender is to be told next; an empty text where there is nothing for a while."""
    with suppress(TimeoutError):
        return await asyncio.wait_for(sender.get(), _SILENCE_S)
    return ""


async def _first_word(socket: WebSocket, live: LiveSessions, holder: Holder) -> tuple[LiveEntry, int]:
    """Begin the session that a sender asks for, or find the one it goes on with; and what it has heard of it."""
    word = SENT.validate_json(await asyncio.wait_for(_text(socket), _FIRST_WORD_S))
    if isinstance(word, Continue):
        return live.find(word.session, holder.name), word.answered
    if not isinstance(word, Begin):
        raise ConfigError('the session has not begun. Expected {"type": "begin", "name": ...} as the first message.')
    config = config_of(word.preset, word.config)
    # the compiler of the method takes 60 MB, so it is loaded for the first session, and beside the loop
    await run_in_threadpool(lambda: import_module("interloc.detection.warm").warm_up(config))
    entry = live.begin(word, holder.name, config)  # its place is taken before a drive is made for it
    if word.keep:
        context: Context = socket.app.state.context
        try:
            entry.keeper = await run_in_threadpool(Keeper, context, holder.name, word, config)
        except BaseException:
            entry.refuse("no drive could be made for it.")
            raise
    return entry, -1


async def _text(socket: WebSocket) -> str:
    """Receive a message that must be a text."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1006))
    text: str | None = message.get("text")
    if text is None or len(text) > _MAX_TEXT:
        raise ConfigError("Expected a short text, as docs/live.md has it, as the first message. Found something else.")
    return text


async def _read(
    socket: WebSocket, entry: LiveEntry, sender: asyncio.Queue[str | None], context: Context, holder: Holder
) -> None:
    """Take what a sender sends, until it has gone or is refused."""
    try:
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            if not await _may_go_on(context, holder):
                entry.refuse("its token was revoked.")
            elif message.get("bytes") is not None:
                entry.take(message["bytes"])
            elif isinstance(SENT.validate_json(message["text"][:_MAX_TEXT]), End):
                entry.finish()
            else:
                raise ConfigError("the session has begun already.")
    except (InterLocError, ValidationError) as error:
        entry.refuse(_reason_of(error))
    else:
        if message.get("code") == _TOO_LARGE:
            entry.refuse("a scan is larger than it takes (8 MB, 700,000 points).")
        sender.put_nowait(None)  # it has gone


async def _may_go_on(context: Context, holder: Holder) -> bool:
    if context.tokens.is_fresh or holder.name == ANONYMOUS:
        return context.tokens.still_holds(holder)
    return await run_in_threadpool(context.tokens.still_holds, holder)


def _reason_of(error: Exception) -> str:
    if isinstance(error, Problem):
        return error.detail
    if isinstance(error, ValidationError):
        return f"a text that is not known: {first_fault(error)}."
    if isinstance(error, TimeoutError):
        return "no first message came."
    return str(error)


async def _close(socket: WebSocket, reason: str) -> None:
    """Close a connection for a reason, as much of it as a control frame holds."""
    await socket.close(_REFUSED, reason.encode()[:_MAX_REASON_BYTES].decode(errors="ignore"))
