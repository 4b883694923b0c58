"""The application: `create_app` puts the parts together, ``uvicorn app.main:create_app --factory`` serves it."""

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Depends, FastAPI
from fastapi.concurrency import run_in_threadpool
from fastapi.routing import APIRoute

from app import system
from app.context import Context
from app.demo import routes as demo
from app.drives import file_routes as files
from app.drives import routes as drives
from app.drives.commit import finish_drive
from app.http.gate import client_of
from app.http.middleware import add_middleware
from app.http.openapi import DESCRIPTION, PROBLEMS, TAGS, UNLISTED, Description, operation_id
from app.http.parameters import refuse_unknown_parameters
from app.http.prices import TURN, Turns
from app.http.problems import add_handlers
from app.jobs import routes as jobs
from app.jobs.runner import Runner
from app.jobs.view import JobWatcher
from app.jobs.webhooks import Deliverer
from app.live import routes as live
from app.live.sessions import LiveSessions
from app.maps import finding_routes as findings
from app.maps import routes as maps
from app.maps.merging import Merger
from app.maps.records import make_server_map
from app.networks import routes as networks
from app.ogc import routes as ogc
from app.ogc.index import index_result
from app.page import routes as page
from app.page.files import PageFiles
from app.results.folder import OnDemand, Results
from app.results.routes import exports, results
from app.settings import Settings
from app.trash import routes as trash
from app.upkeep.cleanup import Sweeper
from interloc.results import versions

API = "/api/v1"

_THREADS = 64  # that answer requests: more than may wait for the database at the same time


def _assemble() -> APIRouter:
    router = APIRouter(generate_unique_id_function=operation_id, responses=PROBLEMS)
    shared = [Depends(client_of), Depends(refuse_unknown_parameters), TURN]

    def include(part: APIRouter, prefix: str = "", *, dependencies: Sequence[Any] = ()) -> None:
        for route in part.routes:
            if isinstance(route, APIRoute) and UNLISTED.fullmatch(prefix + route.path):
                route.include_in_schema = False
        router.include_router(part, prefix=prefix, dependencies=dependencies)

    of_drives = (drives, files, demo, networks)
    of_jobs = (jobs, results, exports)
    for module in (*of_drives, *of_jobs, live, maps, findings, trash):
        include(module.router, API, dependencies=shared)
    for more in (ogc.of_job, ogc.of_map, trash.of_items):
        include(more, API, dependencies=shared)
    include(live.sockets, API)
    include(ogc.of_all, dependencies=shared)
    for module in (system, page):
        include(module.router)
    return router


ROUTES = _assemble().routes
"""Of every application: what FastAPI makes of them, a third of a second of work, is made once in a process."""


def create_app(settings: Settings | None = None, context: Context | None = None) -> FastAPI:
    """Make the application; by default its settings come from the environment (``INTERLOC_*``).

    A context that is not given is opened at the start; it is closed at the end.
    """
    settings = settings or Settings()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        parts = app.state
        to_thread.current_default_thread_limiter().total_tokens = _THREADS
        try:
            opened = context or Context.open(settings)
            parts.context = opened
            await run_in_threadpool(make_server_map, opened)
            parts.runner = runner = Runner(opened, finish_drive=finish_drive, index_result=index_result)
            parts.watcher = JobWatcher(opened)
            parts.results = Results(opened)
            parts.turns = Turns()
            parts.live = LiveSessions(opened)
            parts.on_demand = OnDemand(runner)
            parts.probe = system.Probe(opened, runner)
            runner.start()
        except Exception as error:
            parts.start_fault = error  # uvicorn reports it as text only
            raise
        helpers = (Sweeper(opened), Merger(opened, runner), Deliverer(opened))
        for helper in helpers:
            helper.start()
        try:
            yield
        finally:
            parts.live.stop()
            for helper in helpers:
                await run_in_threadpool(helper.stop)
            await run_in_threadpool(runner.stop)
            opened.close()

    def needs_token() -> bool:
        opened: Context | None = getattr(app.state, "context", None)
        if opened is None:
            return not settings.allow_anonymous and (settings.token is not None or not settings.is_loopback)
        return opened.tokens.are_needed()

    app = FastAPI(
        title="InterLoc",
        version=str(versions()["interloc"]),
        summary="Find road intersections in LiDAR drives, map them, and score them against OpenStreetMap.",
        lifespan=lifespan,
        docs_url=None,  # the defaults ask other hosts for their scripts: see app/page/files.py
        redoc_url=None,
        description=DESCRIPTION,
        openapi_tags=TAGS,
    )
    app.openapi = Description(app, needs_token)  # type: ignore[method-assign] # as FastAPI's documentation has it
    app.state.page_files = PageFiles(settings)
    add_handlers(app)
    add_middleware(app, settings)
    app.router.routes.extend(ROUTES)
    return app
