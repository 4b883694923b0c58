"""The events of a job: each state once, in order, to the end; for many listeners at the price of one."""

import json
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import Engine, event

from app.jobs.queue import submit
from app.store import tokens
from app.store.database import Database
from app.store.models import Job
from tests.app.conftest import Serve, add_drive, bearer, database_of, running_server
from tests.app.processes import API, wait_until

LISTENERS = 60


@pytest.fixture
def database(client: httpx.Client, shared_data: Path) -> Iterator[Database]:
    """The server's, to change jobs by hand."""
    with database_of(shared_data) as database:
        yield database


def add_job(database: Database) -> str:
    """A job that waits for a drive whose check never ends."""
    drive = add_drive(database, "checking")
    with database.writing() as session:
        row, _ = submit(session, database, kind="intersections", drive_id=drive, owner="ann", request={})
        return row.id


@pytest.fixture
def job(database: Database) -> str:
    return add_job(database)


def change(database: Database, job_id: str, **values: Any) -> int:
    with database.writing() as session:
        job = session.get_one(Job, job_id)
        for name, value in values.items():
            setattr(job, name, value)
        job.version += 1
        return job.version


@contextmanager
def events(
    client: httpx.Client, job_id: str, last: str | None = None
) -> Iterator[Iterator[tuple[str, dict[str, Any]]]]:
    headers = {} if last is None else {"Last-Event-ID": last}
    with client.stream("GET", f"{API}/jobs/{job_id}/events", headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield read(answer.iter_lines())


def read(lines: Iterator[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    fields: dict[str, str] = {}
    for line in lines:
        if line and not line.startswith(":"):
            name, _, value = line.partition(": ")
            fields[name] = value
        elif fields:
            assert fields["event"] == "job"
            yield fields["id"], json.loads(fields["data"])
            fields = {}


def test_each_state_comes_in_order_until_the_end(client: httpx.Client, database: Database, job: str) -> None:
    with events(client, job) as stream:
        number, state = next(stream)
        assert (number, state["state"], state["message"]) == ("1", "accepted", "Waiting for the check of its drive.")
        assert state == client.get(f"{API}/jobs/{job}").json()
        held = {"state": "running", "lease_owner": "x", "lease_until": time.time() + 3600.0}
        change(database, job, done=3, total=10, stage="detecting", **held)
        number, state = next(stream)
        assert (number, state["progress"]["done"], state["progress"]["fraction"]) == ("2", 3, 0.3)
        change(database, job, state="failed", error={"title": "No", "status": 500, "detail": "no"})
        number, state = next(stream)
        assert (number, state["state"], state["error"]["detail"]) == ("3", "failed", "no")
        assert next(stream, None) is None


def test_a_listener_that_comes_back_hears_only_what_is_new(client: httpx.Client, database: Database, job: str) -> None:
    change(database, job, message="one")
    with events(client, job, last="1") as stream:
        assert next(stream)[0] == "2"
    with events(client, job, last="2") as stream:
        change(database, job, message="two")
        number, state = next(stream)
        assert (number, state["message"]) == ("3", "two")
    with events(client, job, last="nonsense") as stream:
        assert next(stream)[0] == "3"


def test_the_end_is_told_to_whoever_comes_late(client: httpx.Client, job: str) -> None:
    assert client.delete(f"{API}/jobs/{job}").json()["state"] == "dismissed"
    for last in (None, "1", "2"):
        with events(client, job, last) as stream:
            assert [(number, state["state"]) for number, state in stream] == [("2", "dismissed")]


def test_a_job_that_is_removed_ends_its_events(client: httpx.Client, database: Database, job: str) -> None:
    with events(client, job) as stream:
        next(stream)
        with database.writing() as session:
            session.delete(session.get_one(Job, job))
        assert next(stream, None) is None


def test_a_token_that_is_revoked_ends_its_events(serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tokens, "_BELIEVED_S", 0.0)
    client = serve()
    with database_of(tmp_path / "data") as database:
        job = add_job(database)
        tokens.add_token(database, "other")
        client.headers.update(bearer(tokens.add_token(database, "ann")))
        with events(client, job) as stream:
            next(stream)
            change(database, job, message="one")
            assert next(stream)[1]["message"] == "one"
            tokens.revoke_token(database, "ann")
            change(database, job, message="two")
            assert next(stream, None) is None


def test_a_server_that_stops_ends_its_events(tmp_path: Path) -> None:
    with running_server(tmp_path) as address, httpx.Client(base_url=address, timeout=60) as client:
        with database_of(tmp_path) as database:
            job = add_job(database)
        pool = ThreadPoolExecutor(1)

        def listen() -> list[str]:
            with httpx.Client(base_url=address, timeout=60) as own, events(own, job) as stream:
                return [number for number, _ in stream]

        heard = pool.submit(listen)
        wait_until(lambda: "interloc_event_listeners 1.0" in client.get("/metrics").text, "the listener")
    assert heard.result(30) == ["1"]
    pool.shutdown()


def test_many_listeners_cost_one_question(client: httpx.Client, database: Database, job: str) -> None:
    questions: list[str] = []

    def count(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        if statement.startswith("SELECT jobs.id, jobs.version"):
            questions.append(statement)

    limits = httpx.Limits(max_connections=None)
    with (
        httpx.Client(base_url=client.base_url, timeout=60, limits=limits) as many,
        ThreadPoolExecutor(LISTENERS) as pool,
    ):

        def hear(_: int) -> list[str]:
            with events(many, job) as stream:
                return [number for number, _ in stream]

        heard = [pool.submit(hear, number) for number in range(LISTENERS)]
        all_listen = f"interloc_event_listeners {LISTENERS}.0"
        wait_until(lambda: all_listen in client.get("/metrics").text, "all to listen", every_s=0.1)
        event.listen(Engine, "before_cursor_execute", count)
        try:
            change(database, job, message="one")
            wait_until(lambda: len(questions) >= 4, "the server to look again")
            change(database, job, state="failed", error={"title": "No", "status": 500, "detail": "no"})
            results = [future.result(60) for future in heard]
        finally:
            event.remove(Engine, "before_cursor_execute", count)
    assert all(numbers[-1] == "3" for numbers in results)
    assert len(questions) < LISTENERS  # twice a second for all of them together
