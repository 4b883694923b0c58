"""A real server on a free port of this machine, and a client for it."""

import asyncio
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from functools import wraps
from pathlib import Path
from typing import Any
from urllib.parse import unquote_plus

import httpx
import pytest
from starlette.types import ASGIApp, Receive, Scope, Send

from app.context import Context
from app.drives.models import NewDrive
from app.drives.records import create_drive
from app.drives.upload import keep
from app.http.intake import Intake
from app.jobs import executors, processes
from app.main import create_app
from app.server import Server
from app.settings import Settings
from app.store.database import Database
from app.store.models import Drive, Job
from interloc.output.layout import RUN_FILE, TABLES
from tests import forks
from tests.app.postgres import new_database
from tests.app.processes import API, NO_TLS, ServerProcess, started
from tests.app.street import write_street
from tests.once import once

Serve = Callable[..., httpx.Client]
Start = Callable[..., ServerProcess]


@contextmanager
def running_server(data_dir: Path, *, asked: list[str] | None = None, **settings: Any) -> Iterator[str]:
    """Serve from a thread of this process; yields the address. What is asked for goes to `asked`: path and query."""
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


def make_drive(client: httpx.Client) -> str:
    """Address of a new drive."""
    return str(client.post(f"{API}/drives", json={"name": "town"}).raise_for_status().headers["location"])


def opened(data_dir: Path, **settings: Any) -> closing[Context]:
    """A service without a server."""
    return closing(Context.open(Settings(data_dir=data_dir, min_free_bytes=0, **settings)))


def database_of(data_dir: Path) -> closing[Database]:
    """The database of a server in SQLite, to change by hand."""
    return closing(Database(Settings(data_dir=data_dir).sqlalchemy_url))


def keep_file(context: Context, drive: str, path: str, content: bytes) -> None:
    intake = Intake(context, path, len(content))
    intake.write(content)
    keep(context, drive, [intake.finish()])


def new_drive(context: Context, files: dict[str, bytes], **options: Any) -> str:
    """Make a drive of somebody that takes files, and has these."""
    drive = create_drive(context, "somebody", NewDrive(name="town", **options))[0].id
    for path, content in files.items():
        keep_file(context, drive, path, content)
    return drive


def finished_job(context: Context, drive: str) -> str:
    """Make a successful job with a result."""
    with context.database.writing() as session:
        summary = {"georeferenced": True, "report": {"map_f1": 1.0}}
        values = {"kind": "intersections", "state": "successful", "created_at": 1.0, "finished_at": 2.0}
        job = Job(drive_id=drive, owner="somebody", request={}, summary=summary, **values)
        session.add(job)
    folder = context.storage.folder(f"jobs/{job.id}/result")
    folder.mkdir(parents=True)
    for name in (RUN_FILE, "report.json", *(f"{table}.geojson" for table in TABLES)):
        (folder / name).write_text("{}")
    return job.id


def add_drive(database: Database, state: str = "ready") -> str:
    """Write the row of a drive of Ann's."""
    with database.writing() as session:
        now = database.clock(session)
        row = Drive(name="town", owner="ann", state=state, options={}, created_at=now, touched_at=now)
        session.add(row)
        session.flush()
        return row.id


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def alone(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run a test in a thread of its own: a browser that other tests have open keeps a loop running in this one."""

    @wraps(test)
    def run(**fixtures: Any) -> None:
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, test(**fixtures)).result()

    return run


class Notes:
    def __init__(self, app: ASGIApp, asked: list[str]) -> None:
        self._app = app
        self._asked = asked

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            self._asked.append(unquote_plus(f"{scope['path']}?{scope['query_string'].decode()}"))
        await self._app(scope, receive, send)


@pytest.fixture(scope="session", autouse=True)
def _workers_of_this_process() -> Iterator[None]:
    """Let them start at once, and only when there is work for them: most servers need none.

    Servers in processes of their own start theirs as they really do.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "_context", forks.context)
        patch.setattr(executors, "compile_kernels", None)
        yield


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Start a server with given settings; returns a client whose base address is the server's."""
    with ExitStack() as stack:

        def start(data_dir: Path | None = None, **settings: Any) -> httpx.Client:
            return stack.enter_context(client_of(data_dir or tmp_path / "data", **settings))

        yield start


@pytest.fixture(scope="module")
def serve_all(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serve]:
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
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a server process on the data folder of this test."""
    with ExitStack() as stack:

        def go(data_dir: Path | None = None, **settings: Any) -> ServerProcess:
            return stack.enter_context(started(data_dir or tmp_path / "data", tmp_path / "server.log", **settings))

        yield go


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of 40 scans with its map. Shared: do not change it."""
    return once(tmp_path_factory, "street", lambda root: write_street(root / "street", 40)) / "street"


@pytest.fixture
def drive(client: httpx.Client) -> str:
    """Address of a new drive."""
    return make_drive(client)


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


@pytest.fixture
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """With all tables: of either kind for tests that ask for its `url`, of order, locks, many at once; else SQLite."""
    has_url = "url" in request.fixturenames
    url = request.getfixturevalue("url") if has_url else f"sqlite:///{tmp_path / 'db.sqlite3'}"
    database = Database(url)
    database.upgrade()
    yield database
    database.close()
