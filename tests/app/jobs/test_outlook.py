"""What jobs that wait are told: their place in the order of the queue, and when they may start."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.jobs.outlook import outlook, seconds_left
from app.jobs.queue import JobQueue
from app.store.database import Database
from app.store.models import Drive, Job

NOW = 1_000_000.0


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(f"sqlite:///{tmp_path / 'jobs.sqlite3'}")
    database.upgrade()
    with database.writing() as session:
        for state in ("ready", "checking"):
            session.add(
                Drive(id=state, name="town", owner="ann", state=state, options={}, created_at=NOW, touched_at=NOW)
            )
    yield database
    database.close()


def add(database: Database, name: str, owner: str = "ann", state: str = "accepted", **more: Any) -> None:
    values = {"kind": "intersections", "drive_id": "ready", "request": {}, "created_at": NOW - 500, **more}
    with database.writing() as session:
        session.add(Job(id=name, owner=owner, state=state, **values))


def told(database: Database, jobs_at_once: int = 2) -> dict[str, str]:
    with database.reading() as session:
        return outlook(session, NOW, jobs_at_once)


def add_history(database: Database, *seconds: float, kind: str = "intersections") -> None:
    for number, each in enumerate(seconds):
        add(
            database,
            f"old {kind} {number}",
            state="successful",
            kind=kind,
            started_at=NOW - 9000,
            finished_at=NOW - 9000 + each,
        )


def test_places_without_a_guess_where_nothing_is_known(database: Database) -> None:
    for number in range(2):
        add(database, f"running {number}", state="running", started_at=NOW - 10)
    for number in range(3):
        add(database, f"waiting {number}", created_at=NOW - 100 + number)
    assert told(database) == {
        "waiting 0": "It is the next one.",
        "waiting 1": "1 job is before it.",
        "waiting 2": "2 jobs are before it.",
    }


def test_the_start_follows_from_recent_jobs_and_from_how_far_the_running_ones_are(database: Database) -> None:
    add_history(database, 100, 300)  # 200 s on average
    add(database, "half", state="running", started_at=NOW - 60, done=50, total=100)  # 60 s left
    add(database, "young", state="running", started_at=NOW - 20)  # 180 s left
    for number in range(3):
        add(database, f"waiting {number}", created_at=NOW - 100 + number)
    assert told(database) == {
        "waiting 0": "It is the next one; it should start in about 60 seconds.",
        "waiting 1": "1 job is before it; it should start in about 3 minutes.",
        "waiting 2": "2 jobs are before it; it should start in about 4 minutes.",
    }


def test_the_places_are_those_of_the_queue(database: Database) -> None:
    add(database, "running", "eve", state="running", started_at=NOW, lease_until=NOW + 9e9)
    for number, owner in enumerate(["eve", "eve", "ann", "bob", "ann"]):
        add(database, f"{owner} {number}", owner, created_at=NOW - 100 + number)
    expected = ["ann 2", "bob 3", "eve 0", "ann 4", "eve 1"]
    places = told(database)
    assert list(places) == expected
    queue = JobQueue(database, 9e9)
    claims = [queue.claim() for _ in expected]
    assert [claim and claim.job.id for claim in claims] == expected


def test_what_has_a_free_place_starts_at_once(database: Database) -> None:
    add(database, "waiting")
    assert told(database) == {"waiting": "It is the next one; it should start in a few seconds."}


def test_quick_jobs_have_a_line_of_their_own(database: Database) -> None:
    add_history(database, 4000)
    for number in range(2):
        add(database, f"long {number}", state="running", started_at=NOW)
    add(database, "long", created_at=NOW - 100)
    add(database, "commit", kind="commit", drive_id="checking")
    assert told(database) == {
        "commit": "It is the next one; it should start in a few seconds.",
        "long": "It is the next one; it should start in about 67 minutes.",
    }


def test_a_job_that_waits_for_its_drive_has_no_place(database: Database) -> None:
    add(database, "waiting", drive_id="checking")
    assert told(database) == {}


def test_the_time_left_is_told_once_it_is_known() -> None:
    assert seconds_left(60.0, 50, 200) == 180.0
    assert seconds_left(4.9, 50, 200) is None  # the reading of the map is most of it
    assert seconds_left(60.0, 9, 200) is None
    assert seconds_left(60.0, 0, 200) is None
    assert seconds_left(60.0, 5, None) is None
