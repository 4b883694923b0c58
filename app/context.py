"""What all parts of the service share: settings, database, storage, tokens, metrics, and signals."""

import os
import secrets
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, Request

from app.metrics import Metrics
from app.settings import SQLITE_FILE, Settings
from app.store.database import Database
from app.store.installation import FILE as INSTALLATION
from app.store.installation import bind, mark_folder, refuse_lost_database
from app.store.storage import Storage
from app.store.tokens import TokenBook
from interloc.errors import ConfigError, OutputError


@dataclass(frozen=True)
class Context:
    """What the parts of a running service share; those that use it (runner, watcher, routes) are made in `app.main`."""

    settings: Settings
    database: Database
    storage: Storage
    tokens: TokenBook
    metrics: Metrics
    stopping: threading.Event = field(default_factory=threading.Event)
    """Set when the server begins to stop: streams and waits that would go on must end."""
    jobs_changed: threading.Event = field(default_factory=threading.Event)
    """Set when a job was submitted, was cancelled or has ended: the runner looks for the next one at once."""
    maps_changed: threading.Event = field(default_factory=threading.Event)
    """Set when a map may have to be brought up to date: it is looked at at once."""
    lacks_workers: threading.Event = field(default_factory=threading.Event)
    """Set while this server takes no job, because it has no worker for it."""

    @classmethod
    def open(cls, settings: Settings) -> "Context":
        """Open database and storage, as `open_database` does."""
        database = open_database(settings)
        storage = Storage(settings.data_dir)
        database.check_place = storage.check
        return cls(settings, database, storage, TokenBook(database, settings), Metrics())

    @classmethod
    def open_existing(cls, settings: Settings) -> "Context":
        """Open a service that is there already: for its operator, whose mistyped folder must not become a new one."""
        if not settings.data_dir.is_dir():
            raise ConfigError(f"there is no data folder {settings.data_dir}; --data-dir (INTERLOC_DATA_DIR) names it.")
        if not any((settings.data_dir / name).exists() for name in (INSTALLATION, SQLITE_FILE, "drives")):
            raise ConfigError(
                f"the folder {settings.data_dir} holds no drives of a service. --data-dir (INTERLOC_DATA_DIR) and "
                "INTERLOC_DATABASE_URL must be those that the service runs with."
            )
        return cls.open(settings)

    def close(self) -> None:
        """Close database and storage."""
        self.database.close()
        self.storage.close()


class Helper:
    """What a server does on the side, in a thread of its own, from `start` to `stop`."""

    def __init__(self, name: str, wake: threading.Event | None = None) -> None:
        self.stopping = threading.Event()
        self._wake = wake
        self._thread = threading.Thread(target=self.run, name=name, daemon=True)

    def start(self) -> None:
        """Begin, in the background."""
        self._thread.start()

    def stop(self) -> None:
        """Let it end soon, and wait for that."""
        self.stopping.set()
        if self._wake is not None:
            self._wake.set()
        if self._thread.is_alive():
            self._thread.join(5)

    def run(self) -> None:
        """Do it until `stopping` is set."""
        raise NotImplementedError


def open_database(settings: Settings) -> Database:
    """Create the data folder where it is missing, bring the database up to date, see that the two belong together.

    An `InstallationError` says that they do not; neither was changed then.
    """
    probe = settings.data_dir / f".probe-{secrets.token_hex(4)}"
    try:
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise OutputError(
            f"the data folder {settings.data_dir} cannot be written: {os.strerror(error.errno or 0).lower()}. "
            "--data-dir (INTERLOC_DATA_DIR) chooses another one."
        ) from error
    folder = Path(os.path.realpath(settings.data_dir))
    database = Database(settings.sqlalchemy_url)
    ids: list[str] = []
    try:
        refuse_lost_database(database, folder)
        database.upgrade(lambda session: ids.append(bind(session, database, folder)))
        mark_folder(folder, ids[0])
    except BaseException:
        database.close()
        raise
    return database


def part_of_app(name: str) -> Any:  # noqa: ANN401 - as FastAPI's Depends
    """Return the dependency on a part of the application, which `app.main` keeps in ``app.state`` under this name."""

    async def part(request: Request) -> Any:  # noqa: ANN401 - async: no trip to the thread pool
        return getattr(request.app.state, name)

    return Depends(part)


ContextDep = Annotated[Context, part_of_app("context")]
