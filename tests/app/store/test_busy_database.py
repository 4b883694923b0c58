"""Somebody else holds the lock of the database: requests are given up soon, and all that only reads goes on."""

import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import psycopg
import pytest
from sqlalchemy.exc import OperationalError

from app.store.database import Database, DatabaseBusyError
from app.store.models import Drive
from tests.app.conftest import Serve

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


def test_work_in_the_background_waits_longer(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.store.database.PATIENCE_S", 0.1)
    with ThreadPoolExecutor(1) as pool:
        with sqlite_held(tmp_path / "db.sqlite3"):
            patient = pool.submit(add_drive, database, patient=True)
            with pytest.raises((DatabaseBusyError, OperationalError)):
                add_drive(database, patient=False)
            assert not patient.done()
        patient.result()


def add_drive(database: Database, *, patient: bool) -> None:
    with database.writing(patient=patient) as session:
        session.add(Drive(name="a", owner="me", created_at=1.0, touched_at=1.0))


def test_the_probe_writes_nothing(database: Database, tmp_path: Path) -> None:
    before = (tmp_path / "db.sqlite3-wal").read_bytes()
    database.check_writable()
    assert (tmp_path / "db.sqlite3-wal").read_bytes() == before
