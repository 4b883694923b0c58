"""The database: SQLite in a file, or PostgreSQL by its address; its tables are brought up to date at start."""

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import URL, Connection, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError
from sqlalchemy.exc import TimeoutError as WaitedTooLong
from sqlalchemy.orm import Session, sessionmaker

from app.store.models import Base, make_tables
from interloc.arrays import JsonObject
from interloc.errors import ConfigError, InterLocError

_MIGRATIONS = Path(__file__).parent / "migrations"
_UPGRADE_LOCK = 0x1E7E210C  # any number: PostgreSQL's advisory lock of servers that start together
_UPGRADE_PATIENCE_S = 60  # of a server that starts while another one still brings the tables up to date
_CONNECT_TIMEOUT_S = 10
_SILENCE_S = 30.0  # of a statement of PostgreSQL

PATIENCE_S = 5.0
"""Time that a request waits for the database at most, all queues together."""

_LONG_PATIENCE_S = 20.0  # of work that nobody waits for
_PROBE_S = 2.0
_AGAIN_S = 0.01
_STUCK_S = 1.0  # without any progress of the writers, no more than a few may wait
_MAX_STUCK = 16
_AFTERWARDS = "afterwards"

_SQLITE_NOW = "SELECT round((julianday('now') - 2440587.5) * 86400.0, 3)"  # unixepoch('subsec') needs SQLite 3.42


class DatabaseBusyError(WaitedTooLong):
    """The turn to write did not come in time."""


class Database:
    """A connection pool, and the sessions on it, by the SQLAlchemy URL of a SQLite or PostgreSQL database."""

    def __init__(self, url: str) -> None:
        self.url = _parse(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        if self.is_sqlite:
            options: JsonObject = {"timeout": PATIENCE_S, "check_same_thread": False}
        else:
            waits = {
                "lock_timeout": PATIENCE_S,
                "statement_timeout": _SILENCE_S,
                "idle_in_transaction_session_timeout": 60,
            }
            options = {
                "connect_timeout": _CONNECT_TIMEOUT_S,
                "options": " ".join(f"-c {name}={seconds:g}s" for name, seconds in waits.items()),
                "tcp_user_timeout": round(1000 * _SILENCE_S),  # a machine that is gone closes nothing
            }
        # Enough connections for all threads that answer requests and work on jobs; more of them wait.
        self.engine = create_engine(
            self.url,
            connect_args=options,
            pool_pre_ping=not self.is_sqlite,
            pool_size=10,
            max_overflow=60,
            pool_timeout=PATIENCE_S,
        )
        self._was_there = False
        if self.is_sqlite:
            event.listen(self.engine, "do_connect", self._open_sqlite)
            event.listen(self.engine, "connect", _set_up_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
        self._sessions = sessionmaker(self.engine, expire_on_commit=False)
        self.writes = 0
        """Number of transactions that changed something here; other servers have their own."""
        self.given_up = 0
        """Number of writers that did not get their turn in time."""
        self._turn = threading.Lock()  # of SQLite, which has one writer
        self._lock = threading.Lock()
        self._writers = 0
        """Number of those that wait, or write."""
        self._moved = 0.0
        """When one of them got on last."""
        self.check_place: Callable[[], None] = lambda: None
        """Called before a transaction that writes, and before its commit: where it raises, nothing is acknowledged."""

    def reading(self) -> Session:
        """Open a session that only reads."""
        return self._sessions()

    @contextmanager
    def writing(self, *, patient: bool = False) -> Iterator[Session]:
        """Open a transaction that is committed when the block ends without error; see also `afterwards`.

        Work in the background is patient, and waits longer for its turn to write. A `DatabaseBusyError` says that the
        turn did not come in time, or that many wait and none gets on; an `OperationalError` that another process holds
        the lock.
        """
        arrived = time.monotonic()
        until = arrived + (_LONG_PATIENCE_S if patient else PATIENCE_S)
        with self._waiting(arrived, until, patient=patient), self._sessions() as session:
            left_s = max(0.0, until - time.monotonic())
            if self.is_sqlite:
                session.connection(execution_options={"writes": True, "patience_s": left_s})
            elif patient:
                session.execute(text(f"SET LOCAL lock_timeout = {round(1000 * left_s) or 1}"))
            self.check_place()
            yield session
            self.check_place()
            session.commit()
        self.writes += 1
        for call in session.info.get(_AFTERWARDS, ()):
            call()

    @contextmanager
    def _waiting(self, arrived: float, until: float, *, patient: bool) -> Iterator[None]:
        """Wait for the turn to write, of which SQLite gives one at a time.

        Where something holds all writers up, more and more requests would wait, until no thread is left that could
        answer anything else: once nothing moves, only a few may wait.
        """
        with self._lock:
            self._moved = self._moved if self._writers else arrived
            self._writers += 1
            is_stuck = self._writers > _MAX_STUCK and arrived > self._moved + _STUCK_S
        try:
            if is_stuck and not patient:
                raise DatabaseBusyError("many writers wait for the database, and none gets on")
            if self.is_sqlite and not self._turn.acquire(timeout=max(0.0, until - time.monotonic())):
                raise DatabaseBusyError("others wrote to the database all the time")
            try:
                yield
            finally:
                if self.is_sqlite:
                    self._turn.release()
            self._moved = time.monotonic()
        except (WaitedTooLong, OperationalError):
            with self._lock:
                self.given_up += 1
            raise
        finally:
            with self._lock:
                self._writers -= 1

    @contextmanager
    def snapshot(self) -> Iterator[Connection]:
        """Open a connection that reads everything as of one moment, while others write."""
        with self.engine.connect() as connection:
            if not self.is_sqlite:  # which does so by itself
                connection.execution_options(isolation_level="REPEATABLE READ")
            with connection.begin():
                yield connection

    def check_writable(self) -> None:
        """Write something that changes nothing, and take it back; SQLAlchemy's error where that takes long."""
        options = {"writes": True, "patience_s": _PROBE_S}
        with self.engine.connect().execution_options(**options) as connection, connection.begin() as transaction:
            if not self.is_sqlite:
                connection.execute(text(f"SET LOCAL lock_timeout = {round(1000 * _PROBE_S)}"))
            connection.execute(text("UPDATE drives SET name = name WHERE id = ''"))
            transaction.rollback()

    def clock(self, session: Session) -> float:
        """Return the time by the clock of the database, seconds since 1970: one clock for all servers."""
        now = _SQLITE_NOW if self.is_sqlite else "SELECT extract(epoch FROM clock_timestamp())"
        return float(session.execute(text(now)).scalar_one())

    def lock_owner(self, session: Session, owner: str) -> None:
        """Let one transaction of a client go on at a time, so that its keys and limits hold; SQLite does so anyway."""
        if not self.is_sqlite:
            session.execute(text("SELECT pg_advisory_xact_lock(hashtext(:owner))"), {"owner": owner})

    def upgrade(self, then: Callable[[Session], None] | None = None) -> None:
        """Bring the tables up to date (Alembic); servers that start together do it one after the other.

        `then` is called at the end of the same transaction: where it raises, nothing has changed. An `InterLocError`
        says that the database does not answer, belongs to a newer version or to one before 0.2.0, or holds something
        else.
        """
        shown = self.url.render_as_string(hide_password=True)
        try:
            self._upgrade(then)
        except DBAPIError as error:
            reason = " ".join(str(error.orig).split())
            raise InterLocError(f"the database {shown} cannot be reached or brought up to date: {reason}") from error

    def _upgrade(self, then: Callable[[Session], None] | None) -> None:
        with self.engine.connect().execution_options(writes=True) as connection, connection.begin():
            if not self.is_sqlite:
                connection.execute(text("SET LOCAL statement_timeout = 0"))
                connection.execute(text(f"SET LOCAL lock_timeout = '{_UPGRADE_PATIENCE_S}s'"))
                connection.execute(text(f"SELECT pg_advisory_xact_lock({_UPGRADE_LOCK})"))
            config = Config()
            config.set_main_option("script_location", str(_MIGRATIONS))
            config.attributes["connection"] = connection
            if set(inspect(connection).get_table_names()).isdisjoint(Base.metadata.tables):
                Base.metadata.create_all(connection)  # what the migrations end at, in a quarter of the time
                command.stamp(config, "head")
            else:
                self._refuse_unknown(MigrationContext.configure(connection).get_current_revision(), config)
                command.upgrade(config, "head")
                make_tables(connection)
            if then is not None:
                with Session(connection) as session:
                    then(session)
                    session.flush()

    def _refuse_unknown(self, found: str | None, config: Config) -> None:
        known = [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()]
        if found in known:
            return
        shown = self.url.render_as_string(hide_password=True)
        if found is None:
            raise InterLocError(
                f"the database {shown} holds tables of the same names that InterLoc has not made. Give it one of its "
                "own, INTERLOC_DATABASE_URL"
            )
        if found > known[0]:
            raise InterLocError(
                f"the database {shown} was made by a newer version of InterLoc (its tables are at {found!r}, this "
                f"version ends at {known[0]!r}); install that version, or use another data folder"
            )
        raise InterLocError(
            f"the database {shown} was made by a version of InterLoc that is too old (its tables are at {found!r}, "
            f"this version begins at {known[-1]!r}, which is 0.2.0); start version 0.2.0 with it once, then this one"
        )

    def close(self) -> None:
        """Close the connections."""
        self.engine.dispose()

    def _open_sqlite(self, _dialect: object, _record: object, arguments: list[Any], options: JsonObject) -> None:
        """Let SQLite make no new file in the place of one that was there."""
        path = self.url.database
        if self._was_there and path and path != ":memory:" and not path.startswith("file:"):
            arguments[0] = f"{Path(path).absolute().as_uri()}?mode=rw"
            options["uri"] = True
        self._was_there = True


def afterwards(session: Session, call: Callable[[], None]) -> None:
    """Have something done when the transaction of `Database.writing` is committed, and others may write again."""
    session.info.setdefault(_AFTERWARDS, []).append(call)


def is_disk_full(error: BaseException | None) -> bool:
    """Tell whether a database could not write for lack of space."""
    return "disk is full" in str(error) or "No space left" in str(error)


def is_read_only(error: BaseException | None) -> bool:
    """Tell whether a database could not write since its disk fails or was made read-only."""
    return any(sign in str(error) for sign in ("disk I/O error", "readonly database", "Read-only file system"))


def moment(seconds: float) -> datetime:
    """Return a time of the database as date and time."""
    return datetime.fromtimestamp(seconds, tz=UTC)


def _parse(url: str) -> URL:
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):  # the latter of a port
        parsed = None
    backend = parsed.get_backend_name() if parsed is not None else ""
    is_file = parsed is not None and parsed.database not in {None, "", ":memory:"}
    if parsed is None or backend not in {"sqlite", "postgresql", "postgres"} or (backend == "sqlite" and not is_file):
        raise ConfigError(
            "INTERLOC_DATABASE_URL: SQLite and PostgreSQL can be used, as sqlite:////data/interloc.sqlite3 or "
            "postgresql://user:password@host/database"
        )
    return parsed if backend == "sqlite" else parsed.set(drivername="postgresql+psycopg")


def _set_up_sqlite(connection: Any, _record: object) -> None:  # noqa: ANN401 - a DBAPI connection
    connection.isolation_level = None  # transactions are begun by _begin_sqlite, not by the driver
    # SQLite's own knows ASCII only.
    connection.create_function("lower", 1, lambda it: it.lower() if isinstance(it, str) else it, deterministic=True)
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode=WAL")
            break
        except sqlite3.OperationalError as error:  # others open a new database too: for that SQLite does not wait
            if "locked" not in str(error) or time.monotonic() > deadline:
                raise
            time.sleep(_AGAIN_S)
    for pragma in ("synchronous=NORMAL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _begin_sqlite(connection: Connection) -> None:
    """Take the write lock at once where writing is meant: upgrading a read transaction can fail, waiting cannot."""
    options = connection.get_execution_options()
    writes = options.get("writes", False)
    patience_s = options.get("patience_s", _LONG_PATIENCE_S if writes else PATIENCE_S)
    driver: Any = connection.connection.dbapi_connection
    driver.execute(f"PRAGMA busy_timeout = {round(1000 * patience_s)}")
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
