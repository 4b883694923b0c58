"""The database: SQLite in a file, or PostgreSQL by its address; its tables are brought up to date at start."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.util.exc import CommandError
from sqlalchemy import URL, Connection, create_engine, event, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError
from sqlalchemy.orm import Session, sessionmaker

from interloc.errors import ConfigError, InterLocError

_MIGRATIONS = Path(__file__).parent / "migrations"
_UPGRADE_LOCK = 0x1E7E210C  # any number: PostgreSQL's advisory lock of servers that start together
_BUSY_TIMEOUT_S = 30
_CONNECT_TIMEOUT_S = 10
_SQLITE_NOW = "SELECT round((julianday('now') - 2440587.5) * 86400.0, 3)"  # unixepoch('subsec') needs SQLite 3.42


class Database:
    """A connection pool and the sessions on it.

    Parameters
    ----------
    url
        SQLAlchemy URL of a SQLite or PostgreSQL database.

    Raises
    ------
    ConfigError
        The URL is of neither.
    """

    def __init__(self, url: str) -> None:
        self.url = _parse(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        if self.is_sqlite:
            options: dict[str, Any] = {"timeout": _BUSY_TIMEOUT_S, "check_same_thread": False}
        else:
            waits = f"-c lock_timeout={_BUSY_TIMEOUT_S}s -c idle_in_transaction_session_timeout={2 * _BUSY_TIMEOUT_S}s"
            options = {"connect_timeout": _CONNECT_TIMEOUT_S, "options": waits}
        # Enough connections for all threads that answer requests and work on jobs; more of them wait.
        self.engine = create_engine(
            self.url, connect_args=options, pool_pre_ping=not self.is_sqlite, pool_size=10, max_overflow=50
        )
        if self.is_sqlite:
            event.listen(self.engine, "connect", _set_up_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
        self._sessions = sessionmaker(self.engine, expire_on_commit=False)
        # SQLite has one writer; threads of this process that queue here do not starve each other.
        self._write_lock = threading.Lock()

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """Open a session that only reads."""
        with self._sessions() as session:
            yield session

    @contextmanager
    def writing(self) -> Iterator[Session]:
        """Open a transaction that is committed when the block ends without error."""
        if not self.is_sqlite:
            with self._sessions.begin() as session:
                yield session
            return
        with self._write_lock, self._sessions() as session:
            session.connection(execution_options={"writes": True})
            yield session
            session.commit()

    def clock(self, session: Session) -> float:
        """Return the time by the clock of the database, seconds since 1970: one clock for all servers."""
        now = _SQLITE_NOW if self.is_sqlite else "SELECT extract(epoch FROM clock_timestamp())"
        return float(session.execute(text(now)).scalar_one())

    def upgrade(self, then: Callable[[Session], None] | None = None) -> None:
        """Bring the tables up to date (Alembic); servers that start together do it one after the other.

        Parameters
        ----------
        then
            Called at the end of the same transaction: where it raises, nothing has changed.

        Raises
        ------
        InterLocError
            The database does not answer, belongs to a newer version, or holds something else.
        """
        shown = self.url.render_as_string(hide_password=True)
        try:
            self._upgrade(then)
        except CommandError as error:
            raise InterLocError(
                f"the database {shown} was made by a newer version of InterLoc ({error}); "
                "install that version, or use another data folder"
            ) from error
        except DBAPIError as error:
            reason = " ".join(str(error.orig).split())
            raise InterLocError(f"the database {shown} cannot be reached or brought up to date: {reason}") from error

    def _upgrade(self, then: Callable[[Session], None] | None) -> None:
        with self.engine.connect().execution_options(writes=True) as connection, connection.begin():
            if not self.is_sqlite:
                connection.execute(text(f"SELECT pg_advisory_xact_lock({_UPGRADE_LOCK})"))
            config = Config()
            config.set_main_option("script_location", str(_MIGRATIONS))
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
            if then is not None:
                with Session(connection) as session:
                    then(session)
                    session.flush()

    def close(self) -> None:
        """Close the connections."""
        self.engine.dispose()


def moment(seconds: float) -> datetime:
    """Return a time of the database as date and time."""
    return datetime.fromtimestamp(seconds, tz=UTC)


def _parse(url: str) -> URL:
    try:
        parsed = make_url(url)
    except ArgumentError:
        parsed = None
    backend = parsed.get_backend_name() if parsed is not None else ""
    if parsed is None or backend not in {"sqlite", "postgresql", "postgres"}:
        raise ConfigError(
            "INTERLOC_DATABASE_URL: SQLite and PostgreSQL can be used, as sqlite:////data/interloc.sqlite3 or "
            "postgresql://user:password@host/database"
        )
    return parsed if backend == "sqlite" else parsed.set(drivername="postgresql+psycopg")


def _set_up_sqlite(connection: Any, _record: object) -> None:  # noqa: ANN401 - a DBAPI connection
    connection.isolation_level = None  # transactions are begun by _begin_sqlite, not by the driver
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    """Take the write lock at once where writing is meant: upgrading a read transaction can fail, waiting cannot."""
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
