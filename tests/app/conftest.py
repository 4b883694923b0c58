"""A real server on a free port of this machine, and a client for it."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import unquote_plus

import httpx
import pytest
from starlette.types import ASGIApp, Receive, Scope, Send

import app.jobs.executors
import app.jobs.processes
from app.main import create_app
from app.server import Server
from app.settings import Settings
from tests import forks
from tests.app.postgres import new_database
from tests.app.processes import NO_TLS

API = "/api/v1"


# Workers of servers in this process start at once, and only when there is work for them: most servers need none.
# Servers in processes of their own start theirs as they really do.
app.jobs.processes._context = forks.context
app.jobs.executors.compile_kernels = None  # type: ignore[assignment]


@contextmanager
def running_server(data_dir: Path, *, asked: list[str] | None = None, **settings: Any) -> Iterator[str]:
    """Serve from a thread of this process; yields the address. What is asked for goes to `asked`: path and query."""
    forks.ready()
    options: dict[str, Any] = {"min_free_bytes": 0, "workers": 1, "log_level": "warning", **settings}
    settings_ = Settings(data_dir=data_dir, port=0, **options)
    app = create_app(settings_)
    if asked is not None:
        app.add_middleware(Notes, asked=asked)
    server = Server(app, settings_)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive(), "the server did not start"
        time.sleep(0.02)
    try:
        yield f"http://127.0.0.1:{server.port}"
    finally:
        server.should_exit = True
        thread.join(30)
        assert not thread.is_alive(), "the server did not stop"


@contextmanager
def client_of(data_dir: Path, **settings: Any) -> Iterator[httpx.Client]:
    """Serve as `running_server`; yields a client whose base address is the server's."""
    with (
        running_server(data_dir, **settings) as address,
        httpx.Client(base_url=address, timeout=300, verify=NO_TLS) as client,
    ):
        yield client


class Notes:
    """Notes path and query of each request."""

    def __init__(self, app: ASGIApp, asked: list[str]) -> None:
        self._app = app
        self._asked = asked

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            self._asked.append(unquote_plus(f"{scope['path']}?{scope['query_string'].decode()}"))
        await self._app(scope, receive, send)


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., httpx.Client]]:
    """Start a server with given settings; returns a client whose base address is the server's."""
    with ExitStack() as stack:

        def start(data_dir: Path | None = None, **settings: Any) -> httpx.Client:
            return stack.enter_context(client_of(data_dir or tmp_path / "data", **settings))

        yield start


@pytest.fixture(scope="module")
def serve_all(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., httpx.Client]]:
    """Start a server for all tests of a module, which must not mind what others left there."""
    with ExitStack() as stack:

        def start(**settings: Any) -> httpx.Client:
            data_dir = settings.pop("data_dir", None) or tmp_path_factory.mktemp("shared")
            return stack.enter_context(client_of(data_dir, **settings))

        yield start


@pytest.fixture(scope="session")
def shared_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data folder of the server that the tests share: each looks at what belongs to its own drives."""
    return tmp_path_factory.mktemp("shared")


@pytest.fixture(scope="session")
def client(shared_data: Path) -> Iterator[httpx.Client]:
    """A client of a server with default settings, for all tests that do not mind what others left there."""
    with client_of(shared_data) as client:
        yield client


@pytest.fixture
def postgres_url() -> Iterator[str]:
    """Address of an empty database of PostgreSQL."""
    with new_database() as address:
        yield address


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Address of an empty database of either kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'db.sqlite3'}"
    address: str = request.getfixturevalue("postgres_url")
    return address
