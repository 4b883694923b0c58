"""Transactions of many threads at once, locks that somebody else holds, and what the database cannot do."""

import sqlite3
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import psycopg
import pytest
from sqlalchemy import Connection, event, text
from sqlalchemy.exc import OperationalError

from app.http.problem_types import STORAGE_READ_ONLY
from app.http.problems import problem_of
from app.store import database as module
from app.store.database import Database, DatabaseBusyError, afterwards
from app.store.models import Drive
from tests.app.conftest import Serve


def add_drive(database: Database, name: str = "a", *, patient: bool = False) -> None:
    with database.writing(patient=patient) as session:
        session.add(Drive(name=name, owner="me", created_at=1.0, touched_at=1.0))


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


FIRST, LATER = 17, 60  # together more than there are threads


@contextmanager
def sqlite_held(path: Path) -> Iterator[None]:
    """Hold the write lock, as another process does."""
    link = sqlite3.connect(path, isolation_level=None)
    link.execute("BEGIN EXCLUSIVE")
    try:
        yield
    finally:
        link.execute("ROLLBACK")
        link.close()


@contextmanager
def postgres_held(url: str) -> Iterator[None]:
    """Hold a lock on the drives that readers do not mind."""
    with psycopg.connect(url.replace("+psycopg", "")) as link:
        link.execute("LOCK TABLE drives IN EXCLUSIVE MODE")
        yield
        link.rollback()


def test_writers_are_given_up_and_readers_go_on(
    serve: Serve, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.store.database._STUCK_S", 0.2)
    monkeypatch.setattr("app.store.database._PROBE_S", 0.5)
    monkeypatch.setattr("app.system._BELIEVED_S", 0.0)
    client = serve(database_url=url)
    drive = client.post("/api/v1/drives", json={"name": "a"}).json()["id"]
    assert client.get("/readyz").status_code == 200
    address = f"/api/v1/drives/{drive}/files/poses.txt"
    held = postgres_held(url) if "postgresql" in url else sqlite_held(tmp_path / "db.sqlite3")
    with ThreadPoolExecutor(FIRST + LATER) as pool:
        with held:
            begun = time.monotonic()
            answers = [pool.submit(client.put, address, content=b"1") for _ in range(FIRST)]
            time.sleep(0.5)  # for all of them to wait; those that come later need not
            late = [pool.submit(client.put, address, content=b"1") for _ in range(LATER)]
            for path in ("/healthz", "/api/v1/drives", f"/api/v1/drives/{drive}/files", "/config.json"):
                assert client.get(path).status_code == 200
            assert not all(answer.done() for answer in answers)  # that was while some waited
            ready = client.get("/readyz")
            assert ready.status_code == 503
            assert "nothing can be written" in ready.json()["reasons"]["database"]
            for answer in answers + late:
                assert answer.result().status_code == 503
                assert answer.result().headers["retry-after"] == "5"
                assert answer.result().json()["title"] == "Database busy"
            assert time.monotonic() - begun < 60  # not one after the other
        assert client.put(address, content=b"1").status_code == 201
    assert client.get("/readyz").json() == {"ready": True, "reasons": {}}
    figures = client.get("/metrics").text
    assert f"interloc_database_busy_total {float(FIRST + LATER)}" in figures


def test_background_work_waits_longer(database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.store.database.PATIENCE_S", 0.1)
    with ThreadPoolExecutor(1) as pool:
        with sqlite_held(tmp_path / "db.sqlite3"):
            patient = pool.submit(add_drive, database, patient=True)
            with pytest.raises((DatabaseBusyError, OperationalError)):
                add_drive(database, patient=False)
            assert not patient.done()
        patient.result()


def test_the_probe_writes_nothing(database: Database, tmp_path: Path) -> None:
    before = (tmp_path / "db.sqlite3-wal").read_bytes()
    database.check_writable()
    assert (tmp_path / "db.sqlite3-wal").read_bytes() == before
