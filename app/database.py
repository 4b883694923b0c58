"""The database: SQLite in a file, or PostgreSQL by its address; its tables are brought up to date at start."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.orm import Session, sessionmaker

_MIGRATIONS = Path(__file__).parent / "migrations"
_UPGRADE_LOCK = 0x1E7E210C  # any number: PostgreSQL's advisory lock of servers that start together
_BUSY_TIMEOUT_S = 30
_SQLITE_NOW = "SELECT round((julianday('now') - 2440587.5) * 86400.0, 3)"  # unixepoch('subsec') needs SQLite 3.42


class Database:
    """A connection pool and the sessions on it.

    Parameters
    ----------
    url
        SQLAlchemy URL of a SQLite or PostgreSQL database.
    """

    def __init__(self, url: str) -> None:
        self.is_sqlite = url.startswith("sqlite")
        if self.is_sqlite:
            self.engine = create_engine(url, connect_args={"timeout": _BUSY_TIMEOUT_S, "check_same_thread": False})
            event.listen(self.engine, "connect", _set_up_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
        else:
            self.engine = create_engine(url, pool_pre_ping=True, pool_size=10, max_overflow=30)
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

    def upgrade(self) -> None:
        """Bring the tables up to date (Alembic); servers that start together do it one after the other."""
        with self.engine.connect().execution_options(writes=True) as connection, connection.begin():
            if not self.is_sqlite:
                connection.execute(text(f"SELECT pg_advisory_xact_lock({_UPGRADE_LOCK})"))
            config = Config()
            config.set_main_option("script_location", str(_MIGRATIONS))
            config.attributes["connection"] = connection
            command.upgrade(config, "head")

    def close(self) -> None:
        """Close the connections."""
        self.engine.dispose()


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


__all__ = ["Database", "Engine"]
