"""The trash: what is deleted is absent everywhere, comes back whole, or goes for good, whatever is killed meanwhile."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import update

from app.context import Context
from app.http.problems import Problem
from app.store.models import Drive, Job
from app.trash import deletion as trash
from app.upkeep.cleanup import sweep
from tests.app import kills
from tests.app.conftest import Serve, finished_job, new_drive, opened
from tests.app.processes import API, Gate, ended, every, job_of, submit, upload, wait_until

MIDDLE = 25


def items(client: httpx.Client, id_: str) -> list[dict[str, Any]]:
    """What the trash says of a drive or job."""
    found = client.get(f"{API}/trash", params={"limit": 1000}).raise_for_status().json()["items"]
    return [item for item in found if item["id"] == id_]


def result_of(client: httpx.Client, job: str) -> bytes:
    return client.get(f"{API}/jobs/{job}/layers/keyframes").raise_for_status().content


def test_a_deleted_drive_is_absent_and_comes_back_with_its_jobs(
    client: httpx.Client, street: Path, shared_data: Path
) -> None:
    drive = upload(client, street)
    job = submit(client, drive)
    assert ended(client, job)["state"] == "successful"
    before = {
        address: client.get(f"{API}{address}").json() for address in (f"/drives/{drive}", f"/drives/{drive}/files")
    }
    result = result_of(client, job)

    assert client.delete(f"{API}/drives/{drive}").status_code == 204
    for method, address in (
        ("GET", f"/drives/{drive}"),
        ("DELETE", f"/drives/{drive}"),
        ("GET", f"/drives/{drive}/files"),
        ("GET", f"/drives/{drive}/files/map.osm"),
        ("GET", f"/drives/{drive}/trajectory"),
        ("POST", f"/drives/{drive}/commit"),
        ("PUT", f"/drives/{drive}/files/other.osm"),
        ("DELETE", f"/drives/{drive}/files/map.osm"),
        ("GET", f"/jobs/{job}"),
        ("GET", f"/jobs/{job}/layers/keyframes"),
        ("GET", f"/jobs/{job}/events"),
        ("DELETE", f"/jobs/{job}"),
        ("DELETE", f"/jobs/{job}?purge=true"),
    ):
        assert client.request(method, f"{API}{address}").status_code == 404, (method, address)
    assert client.post(f"{API}/jobs", json={"drive_id": drive}).status_code == 404
    assert drive not in client.get(f"{API}/drives?limit=1000").text
    assert job not in client.get(f"{API}/jobs?kind=all&limit=1000").text
    (item,) = items(client, drive)
    assert (item["name"], item["owner"], item["deleted_by"]) == ("street", *["anonymous"] * 2)
    assert item["size_bytes"] == before[f"/drives/{drive}"]["stored_bytes"]
    assert item["purged_at"] > item["deleted_at"]
    assert items(client, job) == []  # it comes and goes with its drive

    assert client.post(f"{API}/trash/drives/{drive}/restore").json() == item
    assert {address: client.get(f"{API}{address}").json() for address in before} == before
    assert result_of(client, job) == result
    assert items(client, drive) == []
    assert (shared_data / f"drives/{drive}/reduced").is_dir()
    assert client.delete(f"{API}/drives/{drive}?purge=true").status_code == 204
    assert not list(shared_data.rglob(drive)) + list(shared_data.rglob(job))
    assert items(client, drive) == []


def test_jobs_of_a_deleted_drive_end(client: httpx.Client, street: Path, shared_data: Path) -> None:
    drive = upload(client, street)
    gate = Gate(shared_data, drive, MIDDLE)
    running = submit(client, drive)
    wait_until(lambda: job_of(client, running)["state"] == "running", "the job to begin")
    assert client.delete(f"{API}/drives/{drive}").status_code == 204
    assert client.post(f"{API}/trash/drives/{drive}/restore").status_code == 200
    assert ended(client, running)["state"] == "dismissed"
    gate.open()
    assert ended(client, submit(client, drive))["state"] == "successful"


def test_a_deleted_job_is_gone_for_good(client: httpx.Client, street: Path, shared_data: Path) -> None:
    drive = upload(client, street)
    key = {"Idempotency-Key": f"trash {drive}"}
    job = client.post(f"{API}/jobs", json={"drive_id": drive}, headers=key).json()["id"]
    assert ended(client, job)["state"] == "successful"
    assert client.delete(f"{API}/jobs/{job}?purge=true").status_code == 204
    for method, address in (("GET", f"/jobs/{job}/layers/keyframes"), ("DELETE", f"/jobs/{job}?purge=true")):
        assert client.request(method, f"{API}{address}").status_code == 404
    assert items(client, job) == []
    assert not (shared_data / f"jobs/{job}").exists()

    again = client.post(f"{API}/jobs", json={"drive_id": drive}, headers=key)
    assert again.status_code == 202  # the key means another job now
    other = again.json()["id"]
    assert other != job
    assert ended(client, other)["state"] == "successful"
    assert client.delete(f"{API}/drives/{drive}").status_code == 204
    assert client.post(f"{API}/trash/drives/{drive}/restore").status_code == 200
    assert client.post(f"{API}/jobs", json={"drive_id": drive}, headers=key).json()["id"] == other  # it kept its key


def test_only_what_is_in_the_trash_is_restored(client: httpx.Client) -> None:
    drive = client.post(f"{API}/drives", json={"name": "alive"}).json()["id"]
    answer = client.post(f"{API}/trash/drives/{drive}/restore")
    assert (answer.status_code, answer.json()["title"]) == (404, "Not in the trash")


def test_the_trash_is_listed_in_pages_and_emptied(serve: Serve, tmp_path: Path) -> None:
    client = serve()
    drives = [client.post(f"{API}/drives", json={"name": f"drive {number}"}).json()["id"] for number in range(5)]
    for drive in drives:
        client.put(f"{API}/drives/{drive}/files/poses.txt", content=b"1")
        client.delete(f"{API}/drives/{drive}")
    assert [item["id"] for item in every(client, f"{API}/trash", "items", limit=2)] == drives[::-1]
    assert client.get(f"{API}/trash", params={"after": "x"}).status_code == 422
    assert "interloc_trash_bytes 5.0" in client.get("/metrics").text
    assert client.delete(f"{API}/trash").status_code == 204
    assert client.get(f"{API}/trash").json() == {"items": [], "next": None}
    assert list((tmp_path / "data/drives").iterdir()) == []


def test_without_a_trash_all_is_gone_at_once(serve: Serve, tmp_path: Path) -> None:
    client = serve(trash_h=0)
    drive = client.post(f"{API}/drives", json={"name": "town"}).json()["id"]
    client.put(f"{API}/drives/{drive}/files/poses.txt", content=b"1")
    assert client.delete(f"{API}/drives/{drive}").status_code == 204
    assert client.get(f"{API}/trash").json()["items"] == []
    assert not list((tmp_path / "data").rglob(drive))


@pytest.fixture
def context(url: str, tmp_path: Path) -> Iterator[Context]:
    """A service that is not running, whose trash keeps for 2 hours."""
    with opened(tmp_path / "data", database_url=url, trash_h=2) as context:
        yield context


def make_drive(context: Context, *, deleted_h: float | None = None) -> tuple[str, str]:
    """Make a drive with a file and a successful job, perhaps deleted some hours ago; returns their ids."""
    drive = new_drive(context, {"poses.txt": b"1"})
    job = finished_job(context, drive)
    if deleted_h is not None:
        trash.delete_drive(context, drive, "somebody")
        with context.database.writing() as session:
            then = context.database.clock(session) - 3600 * deleted_h
            session.execute(update(Drive).where(Drive.id == drive).values(deleted_at=then))
    return drive, job


def kept(context: Context, drive: str, job: str) -> bool:
    """Whether a drive is whole; otherwise nothing at all may be left of it."""
    files = [
        context.storage.folder(f"drives/{drive}/files/poses.txt"),
        context.storage.folder(f"jobs/{job}/result/run.json"),
    ]
    with context.database.reading() as session:
        rows = [session.get(Drive, drive), session.get(Job, job)]
    if all(path.is_file() for path in files) and all(rows):
        return True
    root = context.storage.root
    assert rows == [None, None]
    assert not [path for id_ in (drive, job) for path in root.rglob(f"*{id_}*")]
    return False


def test_the_trash_is_emptied_when_its_time_has_come(context: Context) -> None:
    fresh, old, alive = (make_drive(context, deleted_h=hours) for hours in (1.9, 2.1, None))
    assert sweep(context)["purged"] == 1
    assert [kept(context, *each) for each in (fresh, old, alive)] == [True, False, True]
    assert [each.id for each in trash.empty_trash(context)] == [fresh[0]]
    assert [kept(context, *each) for each in (fresh, alive)] == [False, True]


def test_a_purge_that_was_killed_is_completed_and_cannot_be_taken_back(tmp_path: Path) -> None:
    with opened(tmp_path / "data") as context:
        drive, other = make_drive(context, deleted_h=0), make_drive(context)
        kills.killed(kills.purge, tmp_path / "data", drive[0])
        with pytest.raises(Problem, match="in the trash; it may have been restored"):
            trash.restore(context, drive[0])
        assert trash.list_trash(context, None, 10).items == []
        sweep(context)
        assert [kept(context, *each) for each in (drive, other)] == [False, True]


def test_a_job_that_has_not_ended_stays(context: Context) -> None:
    drive, _ = make_drive(context)
    with context.database.writing() as session:
        job = Job(drive_id=drive, owner="somebody", request={}, kind="intersections", created_at=1.0)
        session.add(job)
    with pytest.raises(Problem, match="Cancel it first"):
        trash.delete_job(context, job.id, "somebody")
    trash.delete_drive(context, drive, "somebody")
    with context.database.reading() as session:
        assert session.get_one(Job, job.id).state == "dismissed"
