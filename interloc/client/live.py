"""Scans sent to a live session of a service, which goes on where it was after a broken connection."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal
from urllib.parse import urlsplit

from interloc.arrays import JsonObject
from interloc.client.connection import authorization, is_loopback
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
        if not server.startswith(("http://", "https://")):
            raise ConfigError(f"--server {server}: expected an address such as http://127.0.0.1:8000")
        self._url = f"ws{server.removeprefix('http').rstrip('/')}/api/v1/live"
        self._proxy: Literal[True] | None = None if is_loopback(urlsplit(server).hostname or "") else True
        self._headers = authorization(token)
        self._begin, self._hear = begin, hear
        self._keeps_all, self._patience_s = keeps_all, patience_s
        self._session: str | None = None
        self._last_frame = self._answered = -1
        self._has_ended = False
        self._refusal: str | None = None

    def run(self, scans_after: Callable[[int], Iterator[LiveScan]]) -> None:
        """Send scans until there are no more, and wait for the end of the session.

        `scans_after` yields the scans after a number; it is called anew for each connection.
        """
        silent_since, pause_s = time.monotonic(), _FIRST_PAUSE_S
        while not self._has_ended:
            try:
                with self._connect() as connection:
                    self._introduce(connection)
                    pause_s = _FIRST_PAUSE_S
                    try:
                        self._send(connection, scans_after(self._last_frame))
                    finally:
                        silent_since = time.monotonic()
            except (OSError, _Broken) as error:
                if time.monotonic() > silent_since + self._patience_s:
                    raise NetworkError(f"{self._url}: no service answers ({error}).") from error
                _log.warning("the connection is broken (%s); trying again", error)
                time.sleep(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _connect(self) -> ClientConnection:
        try:
            from websockets.exceptions import InvalidHandshake, InvalidStatus  # noqa: PLC0415 - few need it
            from websockets.sync.client import connect  # noqa: PLC0415
        except ImportError as error:
            raise ConfigError(f"a live session needs a package that is not installed: {install('live')}") from error
        try:
            return connect(
                self._url, additional_headers=self._headers, max_size=None, compression=None, proxy=self._proxy
            )
        except InvalidStatus as error:
            if error.response.status_code in {502, 503, 504}:
                raise _Broken(str(error)) from error
            detail = _detail(error.response.body)
            raise NetworkError(f"{self._url}: {detail or f'the answer is {error.response.status_code}'}") from error
        except InvalidHandshake as error:
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
        with _broken_where_closed():
            for scan in scans:
                if self._keeps_all:
                    room.acquire()
                if is_deaf.is_set():
                    break
                connection.send(encode_scan(scan))
            else:
                connection.send(json.dumps({"type": "end"}))
        listener.join()
        if self._refusal is not None:
            raise NetworkError(f"the service has ended the session: {self._refusal}")
        if not self._has_ended:
            raise _Broken("the service has gone")

    def _listen(self, connection: ClientConnection, is_deaf: threading.Event, room: threading.Semaphore) -> None:
        try:
            with _broken_where_closed():
                for text in connection:
                    said: Said = json.loads(text)
                    frame = said["frame"] if said["type"] in ("scan", "dropped", "repeated", "refused") else None
                    if frame is not None:
                        self._answered = max(self._answered, frame)
                        if frame > self._last_frame:  # not repeated from before the connection broke
                            room.release()
                    elif said["type"] in ("refused", "failed"):
                        self._refusal = said["reason"]
                    self._hear(said)
                    self._has_ended |= said["type"] == "end"
        except _Broken:
            pass  # seen by the thread that sends
        except NetworkError as error:
            self._refusal = str(error)
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


def _detail(body: bytes | bytearray | None) -> str:
    try:
        return str(json.loads(body or b"")["detail"])
    except (ValueError, KeyError, TypeError):
        return ""
