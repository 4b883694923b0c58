"""Transactions of many threads at once, and what the database cannot do."""

import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import pytest
from sqlalchemy import Connection, event, text
from sqlalchemy.exc import OperationalError

from app.http.problem_types import STORAGE_READ_ONLY
from app.http.problems import problem_of
from app.store import database as module
from app.store.database import Database, afterwards
from app.store.models import Drive


def add_drive(database: Database, name: str) -> None:
    with database.writing() as session:
        now = database.clock(session)
        session.add(Drive(name=name, owner="me", created_at=now, touched_at=now))


def names(database: Database) -> set[str]:
    with database.reading() as session:
        return set(session.scalars(text("SELECT name FROM drives")))


def test_what_comes_afterwards_keeps_nobody_from_writing(database: Database) -> None:
    with database.writing() as session:
        afterwards(session, lambda: add_drive(database, "later"))
        assert names(database) == set()
    assert names(database) == {"later"}
    with suppress(ZeroDivisionError), database.writing() as session:
        afterwards(session, lambda: add_drive(database, "never"))
        _ = 1 / 0
    assert names(database) == {"later"}


def test_writers_of_sqlite_wait_for_each_other(tmp_path: Path) -> None:
    """Also those of other processes, which the lock of this one does not see: two engines stand for them."""
    databases = [Database(f"sqlite:///{tmp_path / 'db.sqlite3'}") for _ in range(2)]
    databases[0].upgrade()

    def write(number: int) -> None:
        database = databases[number % 2]
        with database.writing() as session:
            count = session.scalar(text("SELECT count(*) FROM drives"))
            now = database.clock(session)
            session.add(Drive(name=f"{count}", owner="me", created_at=now, touched_at=now))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(100)))
    assert names(databases[0]) == {str(number) for number in range(100)}
    for database in databases:
        database.close()


@pytest.mark.usefixtures("url")
def test_readers_see_whole_transactions_and_wait_for_nobody(database: Database) -> None:
    began, go_on = threading.Event(), threading.Event()

    def write() -> None:
        with database.writing() as session:
            for name in ("a", "b"):
                session.add(Drive(name=name, owner="me", created_at=1.0, touched_at=1.0))
                session.flush()
                began.set()
                assert go_on.wait(20)

    thread = threading.Thread(target=write)
    thread.start()
    assert began.wait(20)
    assert names(database) == set()
    go_on.set()
    thread.join()
    assert names(database) == {"a", "b"}


def test_a_statement_that_is_not_answered_is_given_up(postgres_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_SILENCE_S", 1.5)
    database = Database(postgres_url)
    database.upgrade()
    with database.reading() as session, pytest.raises(OperationalError, match="statement timeout") as failure:
        session.execute(text("SELECT pg_sleep(60)"))
    assert problem_of(failure.value).status == 503
    add_drive(database, "a")
    assert names(database) == {"a"}
    database.close()


def test_a_database_that_cannot_be_written_is_told(database: Database) -> None:
    @event.listens_for(database.engine, "begin")
    def only_read(connection: Connection) -> None:
        connection.exec_driver_sql("PRAGMA query_only = 1")

    with pytest.raises(OperationalError) as failure:
        add_drive(database, "a")
    assert problem_of(failure.value).status == 503
    assert problem_of(failure.value).kind == STORAGE_READ_ONLY


def test_a_full_disk_is_told(database: Database) -> None:
    @event.listens_for(database.engine, "begin")
    def stay_small(connection: Connection) -> None:
        connection.exec_driver_sql("PRAGMA max_page_count = 1")  # no smaller than it is

    def fill() -> None:
        for _ in range(1000):
            add_drive(database, "x" * 255)

    with pytest.raises(OperationalError) as failure:
        fill()
    assert problem_of(failure.value).status == 507
