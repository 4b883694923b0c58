"""Servers to talk to: a real one of InterLoc, and one that fails in the ways that servers and networks fail."""

import json
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import BaseRequestHandler, ThreadingTCPServer
from typing import Any

import pytest

from interloc.client.connection import Connection
from tests.app.processes import Command, ServerProcess, started
from tests.app.street import write_street
from tests.cli.conftest import Outcome

Reply = Callable[[BaseHTTPRequestHandler], None]


class Faulty:
    """A server that answers its first requests by a script, and all later ones as the last."""

    def __init__(self) -> None:
        self.script: list[Reply] = []
        self.seen: list[tuple[str, str]] = []
        self.bodies: list[bytes] = []
        self.headers: list[dict[str, str]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def answer(self) -> None:
                outer.seen.append((self.command, self.path))
                outer.headers.append(dict(self.headers.items()))
                outer.bodies.append(self.rfile.read(int(self.headers.get("Content-Length", 0))))
                outer.script[min(len(outer.seen), len(outer.script)) - 1](self)

            do_GET = do_PUT = do_POST = do_DELETE = do_HEAD = answer

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class Valve:
    """The way to a server, on which so many bundles of files pass.

    The next one has `reached` it then, and waits until it is `opened`.
    """

    _BUNDLE = b"/scans HTTP/1.1"

    def __init__(self, server: str, bundles: int) -> None:
        self.reached, self.opened = threading.Event(), threading.Event()
        self._left = bundles
        outer, address = self, ("127.0.0.1", int(server.rpartition(":")[2]))

        class Handler(BaseRequestHandler):
            def handle(self) -> None:
                with suppress(OSError), socket.create_connection(address) as there:  # while the server is away, none
                    back = threading.Thread(target=outer._pass_on, args=(there, self.request))
                    back.start()
                    outer._pass_on(self.request, there)
                    back.join()

        self._server = ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        self.opened.set()
        self._server.shutdown()
        self._server.server_close()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        before = b""
        with suppress(OSError):
            while data := source.recv(65536):
                self._left -= (before + data).count(self._BUNDLE)
                before = data[1 - len(self._BUNDLE) :]
                if self._left < 0:
                    self.reached.set()
                    self.opened.wait()
                target.sendall(data)
        for end in (source, target):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


def answer(status: int, body: Any = None, *, kind: str = "application/json", **headers: str) -> Reply:
    """Answer with JSON, or with bytes as they are."""
    data = body if isinstance(body, bytes) else json.dumps(body).encode()

    def reply(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(status)
        handler.send_header("Content-Type", kind)
        handler.send_header("Content-Length", str(len(data)))
        for name, value in headers.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        if handler.command != "HEAD":
            handler.wfile.write(data)

    return reply


def problem(status: int, title: str, detail: str, *, more: dict[str, Any] | None = None, **headers: str) -> Reply:
    document = {"title": title, "status": status, "detail": detail, **(more or {})}
    return answer(status, document, kind="application/problem+json", **headers)


def hang_up(handler: BaseHTTPRequestHandler) -> None:
    """Break the connection off without an answer."""
    handler.connection.shutdown(socket.SHUT_RDWR)
    handler.close_connection = True


@pytest.fixture
def faulty() -> Iterator[Faulty]:
    server = Faulty()
    yield server
    server.close()


@pytest.fixture
def connection(faulty: Faulty) -> Iterator[Connection]:
    with Connection(faulty.address, patience_s=20) as connection:
        yield connection


class Here:
    """The command line in processes of its own, as a user of one server with a cache of his own has it."""

    def __init__(self, server: str, cache: Path, **variables: str) -> None:
        clean = {name: value for name, value in os.environ.items() if not name.startswith("INTERLOC_")}
        own = {"XDG_CACHE_HOME": str(cache), "PYTHONWARNINGS": "error", "INTERLOC_SERVER": server}
        self.environment = {**clean, **own, **variables}
        self._outputs = cache.with_name(f"{cache.name}.written")
        self._outputs.mkdir(exist_ok=True)

    @contextmanager
    def start(self, *arguments: object) -> Iterator[Command]:
        name = f"{len(list(self._outputs.iterdir()))}"
        process = Command(arguments, self.environment, self._outputs / f"{name}.out", self._outputs / f"{name}.err")
        try:
            yield process
        finally:
            process.join(300)

    def __call__(self, *arguments: object) -> Outcome:
        """Run a command to its end."""
        with self.start(*arguments) as process:
            code, out, err = process.ended(300)
        assert "Traceback" not in err
        return Outcome(code, out, err)


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    folder = tmp_path_factory.mktemp("server")
    with started(folder / "data", folder / "log", workers=1) as process:
        yield process


@pytest.fixture
def here(server: ServerProcess, tmp_path: Path) -> Here:
    """The command line, for that server."""
    return Here(server.address, tmp_path / "cache")


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 40 scans, all of them keyframes, with its map.osm. Shared: do not change it."""
    return write_street(tmp_path_factory.mktemp("drives") / "street", 40)
