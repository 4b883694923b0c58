"""A server killed while it unpacks an archive or checks a drive: the next one ends the work, whole and once."""

import hashlib
import io
import os
import signal
import sqlite3
import tarfile
from pathlib import Path

import httpx
import pytest

from app.work.task import LISTING
from tests.app.conftest import Start
from tests.app.processes import (
    API,
    ServerProcess,
    archive_of,
    ended,
    every,
    files_below,
    job_of,
    kill_if_there,
    submit,
    wait_until,
)
from tests.app.street import write_street

ASYNC = {"Prefer": "respond-async"}
MANY = 6_000  # small files: long enough to be caught in the middle of them
SCANS = 210


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of two parts. Shared: do not change it."""
    return write_street(tmp_path_factory.mktemp("drives") / "street", SCANS)


@pytest.fixture(scope="module")
def many() -> dict[str, bytes]:
    """Contents of very many small files by their names."""
    return {f"velodyne/{number:06d}.bin": number.to_bytes(16, "little") for number in range(MANY)}


def pack(files: dict[str, bytes]) -> bytes:
    """Files as a .tar."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(f"drive/{name}")
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return buffer.getvalue()


def new_drive(client: httpx.Client) -> str:
    return str(client.post(f"{API}/drives", json={"name": "street"}).raise_for_status().json()["id"])


def send(client: httpx.Client, drive: str, archive: bytes) -> str:
    """Send an archive, and do not wait for its unpacking; returns the id of the job."""
    answer = client.post(f"{API}/drives/{drive}/archive", content=archive, headers=ASYNC)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["job_id"])


def kill_all(server: ServerProcess) -> None:
    """End server and workers at once, as a power cut would; workers that stand still do not see their server go."""
    workers = server.workers()
    server.kill()
    for worker in workers:
        kill_if_there(worker)
    wait_until(lambda: not any(worker.is_running() for worker in workers), "the workers to end")


def count_files(folder: Path) -> int:
    return len(files_below(folder)) if folder.is_dir() else 0


def assert_unpacked(server: ServerProcess, data: Path, drive: str, job: str, files: dict[str, bytes]) -> None:
    """By a second attempt: all files of an archive are listed, each once; on the disk are these and no others."""
    client = server.client
    end = ended(client, job)
    assert (end["state"], end["attempts"], end["summary"]["files"]) == ("successful", 2, len(files)), end
    found = every(client, f"{API}/drives/{drive}/files", "files", limit=10_000)
    expected = {path: (len(content), hashlib.sha256(content).hexdigest()) for path, content in files.items()}
    assert len(found) == len(expected)
    assert {row["path"]: (row["size_bytes"], row["sha256"]) for row in found} == expected
    root = data / "drives" / drive / "files"
    on_disk = {path.relative_to(root).as_posix(): path.read_bytes() for path in files_below(root)}
    assert on_disk == files
    counted = client.get(f"{API}/drives/{drive}").json()
    assert (counted["files"], counted["size_bytes"]) == (len(files), sum(map(len, files.values())))
    assert_tidy(data, drive, job)


def assert_tidy(data: Path, drive: str, job: str) -> None:
    """Neither archive nor scratch folder is left."""
    assert count_files(data / "drives" / drive / "archives") == 0
    wait_until(lambda: not (data / "jobs" / job / "scratch").exists(), "the scratch folder to go")


@pytest.mark.parametrize("is_unpacked", [False, True], ids=["being unpacked", "taking their places"])
def test_an_archive_is_whole_after_a_kill_while_its_files_are(
    start: Start, many: dict[str, bytes], tmp_path: Path, is_unpacked: bool
) -> None:
    server, data = start(workers=1), tmp_path / "data"
    drive = new_drive(server.client)
    job = send(server.client, drive, pack(many))
    scratch, placed = data / "jobs" / job / "scratch", data / "drives" / drive / "files" / "velodyne"
    if is_unpacked:
        wait_until((placed / f"{100:06d}.bin").exists, "the first files in their places")
    else:
        wait_until(lambda: count_files(scratch) > 100, "the first files to be unpacked")
        for worker in server.workers():
            os.kill(worker.pid, signal.SIGSTOP)  # so that it does not end while the server does
    kill_all(server)
    assert 100 < count_files(placed if is_unpacked else scratch) < MANY
    assert is_unpacked or not (scratch / LISTING).exists()
    with sqlite3.connect(data / "interloc.sqlite3") as database:
        assert database.execute("SELECT count(*) FROM drive_files").fetchone() == (0,)  # files without their rows

    assert_unpacked(start(workers=1), data, drive, job, many)


def test_a_drive_is_ready_after_a_kill_in_the_middle_of_its_commit(start: Start, street: Path, tmp_path: Path) -> None:
    server, data = start(workers=1), tmp_path / "data"
    drive = new_drive(server.client)
    assert ended(server.client, send(server.client, drive, archive_of(street)))["state"] == "successful"
    answer = server.client.post(f"{API}/drives/{drive}/commit", headers=ASYNC)
    assert answer.status_code == 202, answer.text
    (job,) = server.client.get(f"{API}/jobs", params={"drive": drive, "kind": "commit"}).json()["jobs"]
    wait_until(lambda: job_of(server.client, job["id"])["state"] == "running", "the commit to begin", every_s=0.005)
    for worker in server.workers():
        os.kill(worker.pid, signal.SIGSTOP)
    assert job_of(server.client, job["id"])["state"] == "running", "the job ended before it could be disturbed"
    kill_all(server)
    assert not (data / "drives" / drive / "reduced").exists()
    raw = count_files(data / "drives" / drive / "files")

    again = start(workers=1)
    assert again.client.get(f"{API}/drives/{drive}").json()["state"] == "checking"
    assert raw == len(files_below(street))  # nothing went before the drive was ready
    end = ended(again.client, job["id"])
    assert (end["state"], end["attempts"]) == ("successful", 2), end
    known = again.client.get(f"{API}/drives/{drive}").raise_for_status().json()
    assert known["state"] == "ready"
    assert [problem for problem in known["report"]["problems"] if problem["severity"] == "error"] == []
    commits = again.client.get(f"{API}/jobs", params={"drive": drive, "kind": "commit"}).json()["jobs"]
    assert len(commits) == 1
    assert_tidy(data, drive, job["id"])

    untouched = new_drive(again.client)  # the same drive, without a kill
    assert ended(again.client, send(again.client, untouched, archive_of(street)))["state"] == "successful"
    answer = again.client.post(f"{API}/drives/{untouched}/commit", headers={"Prefer": "wait=120"})
    assert answer.json()["state"] == "ready"
    assert reduced(data, drive) == reduced(data, untouched)
    assert again.client.get(f"{API}/drives/{drive}").json()["stored_bytes"] == answer.json()["stored_bytes"]
    result = ended(again.client, submit(again.client, drive))
    assert result["state"] == "successful"
    assert result["summary"]["keyframes"] == SCANS


def reduced(data: Path, drive: str) -> dict[str, str]:
    """What jobs read of a drive: SHA-256 by path."""
    root = data / "drives" / drive / "reduced"
    files = {path.relative_to(root).as_posix(): path for path in files_below(root)}
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
