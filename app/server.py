"""The process that `interloc serve` runs: it listens, serves, and stops in good order."""

import asyncio
import ctypes
import errno
import logging
import os
import socket
from collections.abc import Callable
from contextlib import suppress

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from app import logs
from app.context import Context
from app.http.gate import check_exposure
from app.main import create_app
from app.settings import Settings
from interloc.errors import ConfigError, InterLocError

_BACKLOG = 2048
_ACCEPTED_AT_ONCE = 100
_KEEP_ALIVE_S = 75  # longer than the 60 s of common reverse proxies: they must be the ones that close
_CONNECTIONS = 4000  # 503 beyond
_SPARE_FILES = 256  # descriptors that are not for connections
_M_MMAP_THRESHOLD = -3  # of malloc.h
_GRACE_S = 4  # for uploads that are under way; `docker stop` kills after ten seconds

_log = logging.getLogger(__name__)


class Protocol(HttpToolsProtocol):
    """Closes connections whose request line and headers do not arrive or do not end, and those that are too many."""

    head_s = 20.0
    max_head_bytes = 64 * 1024
    max_connections = _CONNECTIONS
    """Those beyond are closed at once: descriptors must be left for files, the database and the workers."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # like the base class
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._head_bytes: int | None = 0
        """Bytes of the head that is being received; None while there is none."""
        self._head_timer: asyncio.TimerHandle | None = self.loop.call_later(self.head_s, transport.close)
        if len(self.connections) > self.max_connections:
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        self._end_of_head()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Begin to count the head of a request."""
        self._head_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Count no longer: what follows is the body."""
        self._end_of_head()
        super().on_headers_complete()

    def data_received(self, data: bytes) -> None:
        """Take what arrived; an unfinished head may neither grow without end nor trickle in for ever."""
        super().data_received(data)
        if self._head_bytes is None:
            return
        self._head_bytes += len(data)
        if self._head_bytes > self.max_head_bytes:
            self.transport.close()
        elif self._head_timer is None:
            self._head_timer = self.loop.call_later(self.head_s, self.transport.close)

    def _end_of_head(self) -> None:
        self._head_bytes = None
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


class Server(uvicorn.Server):
    """Serves an application, and signals to its parts as soon as it is to stop.

    `started` is called with the port when requests are answered.
    """

    def __init__(self, app: FastAPI, settings: Settings, started: Callable[[int], None] | None = None) -> None:
        config = uvicorn.Config(
            app,
            host=settings.host,
            port=settings.port,
            http=Protocol,
            lifespan="on",
            ws="websockets-sansio",
            ws_max_size=settings.max_live_message_bytes,
            ws_per_message_deflate=False,  # points hardly become smaller
            log_config=None,
            access_log=False,
            server_header=False,
            forwarded_allow_ips=settings.trusted_proxies,
            backlog=_ACCEPTED_AT_ONCE,  # asyncio takes so many in a row, and fails as often where it cannot
            limit_concurrency=_CONNECTIONS,
            timeout_keep_alive=_KEEP_ALIVE_S,
            timeout_graceful_shutdown=_GRACE_S,
        )
        super().__init__(config)
        self._app = app
        self._report_started = started

    @property
    def port(self) -> int:
        """The port that it listens on."""
        port: int = self.servers[0].sockets[0].getsockname()[1]
        return port

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Open the service, then listen."""
        notes = logging.getLogger("uvicorn.error")
        level = notes.level
        notes.setLevel(logging.CRITICAL)  # why a start failed is reported once, by `serve`
        try:
            await super().startup(sockets)
        except SystemExit as error:
            raise getattr(self._app.state, "start_fault", error) from None
        finally:
            notes.setLevel(level)
        for listener in sockets or ():
            listener.listen(_BACKLOG)
        if self.started and self._report_started is not None:
            self._report_started(self.port)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams that would never end by themselves, wait for the rest, close the service."""
        self._app.state.context.stopping.set()
        await super().shutdown(sockets)


def serve(settings: Settings, started: Callable[[int], None] | None = None) -> None:
    """Serve until SIGINT or SIGTERM; an `InterLocError` says what token, folder or address is in the way."""
    logs.set_up(settings)
    with suppress(OSError, AttributeError):  # glibc, which learns by itself to keep free pieces of up to 32 MB
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 1024**2)  # larger ones go back to the system
    context = Context.open(settings)
    try:
        check_exposure(context)
        listener = listen(settings.host, settings.port)
    except BaseException:
        context.close()
        raise
    Protocol.max_connections = max(64, min(_CONNECTIONS, _allow_open_files(2 * _CONNECTIONS) - _SPARE_FILES))
    server = Server(create_app(settings, context), settings, started)
    with listener:
        try:
            server.run(sockets=[listener])
        except KeyboardInterrupt:  # uvicorn sends the signal again when it has stopped
            if not server.started:
                raise
    _log.info("stopped")


def _allow_open_files(wanted: int) -> int:
    """Raise the limit of open files, 1024 on many systems, as far as the system allows; return it."""
    try:
        import resource  # noqa: PLC0415 - Unix only
    except ImportError:
        return wanted
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        soft = wanted
    return wanted if soft == resource.RLIM_INFINITY else soft


def listen(host: str, port: int) -> socket.socket:
    """Bind the address; where that is not possible, the error says why in one line."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        listener = socket.create_server(
            address, family=family, backlog=_BACKLOG, dualstack_ipv6=host == "::" and socket.has_dualstack_ipv6()
        )
    except socket.gaierror as error:
        raise ConfigError(f"--host {host}: no such address ({error.strerror})") from error
    except OSError as error:
        reason = {
            errno.EADDRINUSE: "something listens there already; --port chooses another port",
            errno.EACCES: "ports below 1024 need privileges; --port chooses another port",
            errno.EADDRNOTAVAIL: "this machine has no such address",
        }.get(error.errno or 0, os.strerror(error.errno or 0))
        raise InterLocError(f"cannot listen on {host} port {port}: {reason}") from error
    # asyncio does this only for sockets that it makes itself; without it every answer but the first waits 40 ms.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    listener.setblocking(False)
    return listener
