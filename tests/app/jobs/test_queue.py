"""The queue, on SQLite and on PostgreSQL: fair, fenced, and nobody gets what another one has."""

import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import pytest

from app.http.problems import Problem
from app.jobs.processes import HandOut, Work
from app.jobs.queue import Claim, JobQueue, cancel, submit
from app.store.database import Database
from app.store.models import Drive, Job
from tests import forks
from tests.app.conftest import add_drive


@pytest.fixture
def drive(database: Database) -> str:
    return add_drive(database)


def add_job(database: Database, drive_id: str, owner: str = "ann", kind: str = "intersections", **more: Any) -> str:
    with database.writing() as session:
        request = {"name": owner}
        job, is_new = submit(session, database, kind=kind, drive_id=drive_id, owner=owner, request=request, **more)
        assert is_new
        time.sleep(0.002)  # SQLite's clock counts milliseconds: no two are of the same age
        return job.id


def read_job(database: Database, job_id: str) -> Job:
    with database.reading() as session:
        job = session.get(Job, job_id)
        assert job is not None
        return job


def finish(database: Database, queue: JobQueue, claim: Claim) -> bool:
    with database.writing() as session:
        return queue.finish(session, claim, "successful", summary={"by": claim.lease})


def claimed(queue: JobQueue, **options: bool) -> Claim:
    claim = queue.claim(**options)
    assert claim is not None
    return claim


def taken(queue: JobQueue) -> str | None:
    claim = queue.claim()
    return None if claim is None else claim.job.id


def claim_all(url: str) -> list[str]:
    """Claim until nothing is left: what a server of its own does."""
    database = Database(url)
    queue = JobQueue(database, 60)
    found = []
    for _ in range(5):  # on PostgreSQL a look can miss what another one is just letting go
        while (job_id := taken(queue)) is not None:
            found.append(job_id)
        time.sleep(0.01)
    database.close()
    return found


def test_the_oldest_job_is_first(database: Database, drive: str) -> None:
    jobs = [add_job(database, drive) for _ in range(3)]
    queue = JobQueue(database, 60)
    assert [taken(queue) for _ in range(4)] == [*jobs, None]


@pytest.mark.usefixtures("url")
def test_the_client_with_the_fewest_running_jobs_is_next(database: Database, drive: str) -> None:
    first, second, third = (add_job(database, drive, "ann") for _ in range(3))
    bob = add_job(database, drive, "bob")
    queue = JobQueue(database, 60)
    assert [taken(queue) for _ in range(4)] == [first, bob, second, third]


def test_uploads_go_before_long_work(database: Database, drive: str) -> None:
    long = add_job(database, drive)
    commit = add_job(database, add_drive(database, "checking"), kind="commit")
    unpack = add_job(database, add_drive(database, "uploading"), kind="unpack")
    queue = JobQueue(database, 60)
    assert [taken(queue) for _ in range(3)] == [commit, unpack, long]


@pytest.mark.usefixtures("url")
def test_where_enough_jobs_run_only_quick_ones_are_taken_and_those_of_clients_that_have_none(
    database: Database, drive: str
) -> None:
    queue = JobQueue(database, 60)
    add_job(database, drive, "eve")
    assert queue.claim() is not None
    add_job(database, drive, "eve")
    assert queue.claim(enough_long=True) is None
    newcomer = add_job(database, drive, "ann")
    commits = [add_job(database, add_drive(database, "checking"), "eve", kind="commit") for _ in range(2)]
    taken_jobs = [queue.claim(enough_long=True, enough_urgent=True) for _ in range(3)]
    assert [claim and claim.job.id for claim in taken_jobs] == [commits[0], newcomer, None]
    claim = claimed(queue, enough_long=True)
    assert claim.job.id == commits[1]


def test_a_job_waits_for_the_check_of_its_drive(database: Database) -> None:
    drive_id = add_drive(database, "checking")
    job_id = add_job(database, drive_id)
    assert read_job(database, job_id).message == "Waiting for the check of its drive."
    queue = JobQueue(database, 60)
    assert queue.claim() is None
    with database.writing() as session:
        session.get_one(Drive, drive_id).state = "ready"
    claim = claimed(queue)
    assert (claim.job.id, claim.drive_name, claim.drive_state) == (job_id, "town", "ready")
    assert read_job(database, job_id).message is None


def test_processes_never_get_the_same_job(url: str, database: Database, drive: str) -> None:
    jobs = [add_job(database, drive) for _ in range(40)]
    with ProcessPoolExecutor(2, mp_context=forks.context) as pool:
        found = [job_id for some in pool.map(claim_all, [url] * 2) for job_id in some]
    assert Counter(found) == Counter(jobs)


@pytest.mark.usefixtures("url")
def test_a_silent_server_loses_its_job_and_changes_nothing_more(database: Database, drive: str) -> None:
    job_id = add_job(database, drive)
    silent, other = JobQueue(database, 0.05), JobQueue(database, 60)
    old = claimed(silent)
    time.sleep(0.1)
    new = claimed(other)
    assert (new.job.id, new.job.attempts) == (job_id, 2)

    assert silent.heartbeat([old.lease]) == {old.lease: "lost"}
    assert not silent.progress(old, done=99)
    assert not silent.release(old, "It waits.")
    assert not finish(database, silent, old)
    assert finish(database, other, new)
    assert not finish(database, other, new)
    job = read_job(database, job_id)
    assert (job.state, job.done, job.summary) == ("successful", 0, {"by": new.lease})


def test_a_server_that_speaks_up_keeps_its_job(database: Database, drive: str) -> None:
    add_job(database, drive)
    queue, other = JobQueue(database, 0.5), JobQueue(database, 60)
    claim = claimed(queue)
    for _ in range(4):
        time.sleep(0.2)
        assert queue.heartbeat([claim.lease]) == {claim.lease: "held"}
        assert other.claim() is None
    version = read_job(database, claim.job.id).version
    assert version == claim.job.version  # a heartbeat is no change


def test_a_job_that_is_given_back_keeps_its_attempts(database: Database, drive: str) -> None:
    job_id = add_job(database, drive)
    queue = JobQueue(database, 60)
    for _ in range(5):
        claim = claimed(queue)
        assert claim.job.attempts == 1
        assert queue.release(claim, "It waits.")
    job = read_job(database, job_id)
    assert (job.state, job.attempts, job.lease_owner) == ("accepted", 0, None)
    with database.writing() as session:
        session.get_one(Job, job_id).lease_until -= 3660
    assert 3590 < claimed(queue).job.started_at - job.started_at <= 3660  # an hour without a server is no work
    assert queue.claim() is None
    with database.writing() as session:
        session.get_one(Job, job_id).lease_until += 86400  # by a clock that was a day ahead
    assert claimed(queue).job.id == job_id


@pytest.mark.usefixtures("url")
def test_a_waiting_job_is_dismissed_at_once_and_a_running_one_is_told(database: Database, drive: str) -> None:
    waiting, running = add_job(database, drive), add_job(database, drive)
    queue = JobQueue(database, 60)
    first = claimed(queue)
    for job_id in (waiting, running):
        with database.writing() as session:
            cancel(session, database, session.get_one(Job, job_id))
    assert first.job.id == waiting
    assert queue.heartbeat([first.lease]) == {first.lease: "cancelled"}
    assert queue.heartbeat([first.lease]) == {first.lease: "cancelled"}
    with database.writing() as session:
        assert queue.is_cancelled(session, first)
    assert read_job(database, running).state == "dismissed"
    assert queue.claim() is None


@pytest.mark.usefixtures("url")
def test_a_deleted_job_is_lost(database: Database, drive: str) -> None:
    job_id = add_job(database, drive)
    queue = JobQueue(database, 60)
    claim = claimed(queue)
    with database.writing() as session:
        session.delete(session.get_one(Job, job_id))
    assert queue.heartbeat([claim.lease]) == {claim.lease: "lost"}
    assert not finish(database, queue, claim)


@pytest.mark.usefixtures("url")
def test_the_same_key_is_the_same_job(database: Database, drive: str) -> None:
    job_id = add_job(database, drive, key="k")
    with database.writing() as session:
        job, is_new = submit(
            session, database, kind="intersections", drive_id=drive, owner="ann", request={"name": "ann"}, key="k"
        )
    assert (job.id, is_new) == (job_id, False)
    assert add_job(database, drive, "bob", key="k") != job_id  # another client's key
    with pytest.raises(Problem, match="another request") as caught, database.writing() as session:
        submit(session, database, kind="intersections", drive_id=drive, owner="ann", request={}, key="k")
    assert caught.value.status == 422


def test_one_key_sent_many_times_at_once_is_one_job(url: str, database: Database, drive: str) -> None:
    def send(_: int) -> str:
        own = Database(url)
        with own.writing() as session:
            job, _new = submit(session, own, kind="intersections", drive_id=drive, owner="ann", request={}, key="k")
        own.close()
        return job.id

    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(send, range(16)))) == 1


def test_a_client_can_have_so_many_jobs_and_no_more(database: Database, drive: str) -> None:
    for _ in range(2):
        add_job(database, drive, limit=2)
    with pytest.raises(Problem, match="2 jobs of ann") as caught:
        add_job(database, drive, limit=2)
    assert caught.value.status == 429
    assert caught.value.headers == {"Retry-After": "30"}
    add_job(database, drive, "bob", limit=2)


def test_a_drive_that_takes_files_still_takes_no_jobs(database: Database) -> None:
    with pytest.raises(Problem, match="Commit it first") as caught:
        add_job(database, add_drive(database, "uploading"))
    assert caught.value.status == 409
    with pytest.raises(Problem, match="no drive nowhere"):
        add_job(database, "nowhere")


def add(hand_out: HandOut, words: str) -> None:
    """Let pieces of work of some clients wait; those with an exclamation mark are urgent."""
    for word in words.split():
        hand_out.add(Work((print, ()), word.rstrip("!"), urgent=word.endswith("!")))


def begun(hand_out: HandOut) -> list[Work]:
    """All that may begin now."""
    found = []
    while (taken := hand_out.take()) is not None:
        found.append(taken)
    return found


@pytest.mark.parametrize(("slots", "at_work", "waiting", "ended", "expected"), [
    (2, "", "ann ann ann", [], "ann ann"),
    (2, "ann ann", "ann", [1], "ann"),
    (2, "eve eve", "eve! eve!", [], "eve!"),  # beside long work, but not in the last place
    (2, "eve eve", "eve! ann", [], "eve! ann"),
    (1, "eve", "eve eve ann ann", [], "ann"),  # who has nothing at work never waits for the many of another
    (2, "eve eve ann", "eve ann", [0], ""),  # as many are at work as there are slots
    (2, "eve eve ann", "eve ann", [0, 2], "ann"),  # the client with the fewest is next
    (1, "eve", "eve eve!", [0], "eve!"),
])  # fmt: skip
def test_what_begins_next(slots: int, at_work: str, waiting: str, ended: list[int], expected: str) -> None:
    hand_out = HandOut(slots)
    earlier: list[Work] = []
    for word in at_work.split():
        add(hand_out, word)
        earlier += begun(hand_out)
    add(hand_out, waiting)
    for number in ended:
        hand_out.done(earlier[number])
    assert " ".join(f"{each.client}{'!' * each.urgent}" for each in begun(hand_out)) == expected


def test_cancelled_work_is_passed_over_and_the_rest_is_done_in_its_order() -> None:
    hand_out = HandOut(1)
    pieces = [Work((print, ()), "ann") for _ in range(3)]
    for piece in pieces:
        hand_out.add(piece)
    pieces[0].future.cancel()
    assert begun(hand_out) == [pieces[1]]
