"""Scans sent to a live session of a service, which goes on where it was after a broken connection."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Literal

import httpx

from interloc.arrays import JsonObject
from interloc.client.connection import API, BUSY, Connection, authorization
from interloc.errors import ConfigError, NetworkError, install
from interloc.live.scan import LiveScan
from interloc.live.wire import encode_scan
from interloc.live.worker import Document, RepeatedDocument, SessionDocument

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

_UNANSWERED = 3  # scans under way where nothing may be dropped: fewer than the service lets wait
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.2, 5.0

_log = logging.getLogger(__name__)


Said = Document | RepeatedDocument | SessionDocument


class LiveSender:
    """Sends scans, and hears what the service says.

    A session begins with a `name`, and where wanted `preset`, `config`, `keep`. With `keeps_all` it waits for answers,
    so that the service need not drop a scan. For `patience_s` a service is looked for that has gone.
    """

    def __init__(
        self,
        server: str,
        token: str | None,
        begin: JsonObject,
        hear: Callable[[Said], None],
        *,
        keeps_all: bool = False,
        patience_s: float = 120.0,
    ) -> None:
        self._service = Connection(server, token, patience_s=patience_s)
        self._url = f"ws{self._service.server.removeprefix('http')}{API}/live"
        self._proxy: Literal[True] | None = None if self._service.is_local else True
        self._headers = authorization(token)
        self._begin, self._hear = begin, hear
        self._keeps_all, self._patience_s = keeps_all, patience_s
        self._session: str | None = None
        self._last_frame = self._answered = self._keyframe = -1
        self._is_answered = self._is_sent = self._has_ended = False
        self._failure: Exception | None = None  # of the thread that listens

    def run(self, scans_after: Callable[[int], Iterator[LiveScan]]) -> None:
        """Send scans until there are no more, and wait for the end of the session.

        `scans_after` yields the scans after a number; it is called anew for each connection.
        """
        paused_s, pause_s = 0.0, _FIRST_PAUSE_S
        with self._service:
            while not self._has_ended:
                try:
                    with self._connect() as connection:
                        self._introduce(connection)
                        self._send(connection, scans_after(self._last_frame))
                except _Broken as error:
                    if self._is_answered:
                        paused_s, pause_s, self._is_answered = 0.0, _FIRST_PAUSE_S, False
                    if paused_s > self._patience_s:
                        raise NetworkError(f"{self._url}: no scan is answered ({error}, each time).") from error
                    _log.warning("the connection is broken (%s); trying again", error)
                    time.sleep(pause_s)
                    paused_s, pause_s = paused_s + pause_s, min(2 * pause_s, _LONGEST_PAUSE_S)

    def _connect(self) -> ClientConnection:
        try:
            from websockets.exceptions import InvalidStatus, WebSocketException  # noqa: PLC0415 - few need it
            from websockets.sync.client import connect  # noqa: PLC0415
        except ImportError as error:
            raise ConfigError(f"a live session needs a package that is not installed: {install('live')}") from error
        self._service.check_server("/live")  # what is wrong with the address is said as everywhere
        try:
            return connect(
                self._url, additional_headers=self._headers, max_size=None, compression=None, proxy=self._proxy
            )
        except (OSError, WebSocketException) as error:
            if isinstance(error, InvalidStatus) and (answer := error.response).status_code not in BUSY:
                headers, request = list(answer.headers.raw_items()), httpx.Request("GET", self._url)
                body = bytes(answer.body or b"")
                self._service.check(httpx.Response(answer.status_code, headers=headers, content=body, request=request))
            raise _Broken(str(error)) from error

    def _introduce(self, connection: ClientConnection) -> None:
        """Begin the session, or go on with it."""
        begins = self._session is None
        answered = {"session": self._session, "answered": self._answered}
        word = {"type": "begin", **self._begin} if begins else {"type": "continue", **answered}
        with _broken_where_closed():
            connection.send(json.dumps(word))
            said: Said = json.loads(connection.recv())
        if said["type"] == "refused" and not begins:
            if self._is_sent:
                raise NetworkError(
                    f"{self._url}: all was sent, but the service has forgotten the session ({said['reason']}) What "
                    f"follows scan {self._answered}, and the map, are lost; a drive that was kept is on its page."
                )
            _log.warning("the service has forgotten the session (%s) Another one begins here.", said["reason"])
            self._session = None
            raise _Broken("the session is not known")
        if said["type"] != "session":
            raise NetworkError(f"{self._url}: {said.get('reason', said)}")
        if begins:
            self._hear(said)
        self._session = said["id"]
        self._last_frame = self._answered if begins else said["last_frame"]

    def _send(self, connection: ClientConnection, scans: Iterator[LiveScan]) -> None:
        is_deaf, room = threading.Event(), threading.Semaphore(_UNANSWERED)
        listener = threading.Thread(target=self._listen, args=(connection, is_deaf, room), daemon=True)
        listener.start()
        with suppress(_Broken), _broken_where_closed():  # the listener hears of it, after what was said before
            for scan in scans:
                if self._keeps_all:
                    room.acquire()
                if is_deaf.is_set():
                    break
                connection.send(encode_scan(scan))
            else:
                self._is_sent = True
                connection.send(json.dumps({"type": "end"}))
        listener.join()
        if not self._has_ended:
            raise self._failure or _Broken("the service has gone")

    def _listen(self, connection: ClientConnection, is_deaf: threading.Event, room: threading.Semaphore) -> None:
        try:
            with _broken_where_closed():
                for text in connection:
                    said: Said = json.loads(text)
                    keyframe = said["keyframe"] if said["type"] == "scan" else None
                    if keyframe is not None:
                        if keyframe["frame"] <= self._keyframe:  # of the last ones, which come again in all
                            continue
                        self._keyframe = keyframe["frame"]
                    frame = said["frame"] if said["type"] in ("scan", "dropped", "repeated", "refused") else None
                    if frame is not None:
                        self._answered, self._is_answered = max(self._answered, frame), True
                        if frame > self._last_frame:  # not repeated from before the connection broke
                            room.release()
                    self._hear(said)
                    if frame is None and said["type"] in ("refused", "failed"):
                        self._failure = NetworkError(f"the service has ended the session: {said['reason']}")
                        break
                    self._has_ended |= said["type"] == "end"
        except Exception as error:  # noqa: BLE001 - raised by the thread that sends
            self._failure = error
        finally:
            is_deaf.set()
            room.release()


class _Broken(Exception):  # noqa: N818 - it is mended by another connection
    """The connection is gone, and may come back."""


@contextmanager
def _broken_where_closed() -> Iterator[None]:
    """Turn the end of a connection into `_Broken`, or into a `NetworkError` where another one would end alike."""
    from websockets.exceptions import ConnectionClosed  # noqa: PLC0415
    from websockets.frames import CloseCode  # noqa: PLC0415

    try:
        yield
    except ConnectionClosed as error:
        if error.rcvd is not None and error.rcvd.code == CloseCode.MESSAGE_TOO_BIG:
            raise NetworkError(
                "a scan is larger than it takes (8 MB, 700,000 points). Send the points of the ground only."
            ) from error
        raise _Broken(str(error)) from error
