"""A server killed while it unpacks, checks or stores: work is ended whole and once, what was acknowledged stays."""

import hashlib
import os
import signal
import sqlite3
from pathlib import Path

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from app.drives.records import files_key
from app.http.intake import Intake, Placement
from app.work.task import LISTING
from interloc.reduction.reduce import reduce_drive
from tests.app import kills
from tests.app.conftest import Serve, Start, make_drive, new_drive, opened
from tests.app.drives.test_archives import in_folder, tarred
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
MANY = 2_000  # small files: long enough to be caught in the middle of them
SCANS = 210


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of two parts. Shared: do not change it."""
    return write_street(tmp_path_factory.mktemp("drives") / "street", SCANS)


@pytest.fixture(scope="module")
def many() -> dict[str, bytes]:
    """Contents of very many small files by their names."""
    return {f"velodyne/{number:06d}.bin": number.to_bytes(16, "little") for number in range(MANY)}


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
    drive = make_drive(server.client).rpartition("/")[2]
    job = send(server.client, drive, tarred(in_folder("drive", many)))
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
    drive = make_drive(server.client).rpartition("/")[2]
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

    reduce_drive(street, tmp_path / "street", keyframes=None)  # without a kill
    kept, expected = data / "drives" / drive / "reduced", tmp_path / "street"
    names = {path.relative_to(expected) for path in files_below(expected)}
    assert {path.relative_to(kept) for path in files_below(kept)} == names
    for name in names - {Path("reduced.json")}:
        assert (kept / name).read_bytes() == (expected / name).read_bytes(), name
    result = ended(again.client, submit(again.client, drive))
    assert result["state"] == "successful"
    assert result["summary"]["keyframes"] == SCANS


OLD, NEW = b"of before", b"of afterwards, and longer"


def shown(client: httpx.Client, drive: str) -> dict[str, bytes]:
    """The files of a drive as clients see them; what is listed can be fetched, and is what the list says."""
    found = {}
    for row in client.get(f"{API}/drives/{drive}/files").raise_for_status().json()["files"]:
        got = client.get(f"{API}/drives/{drive}/files/{row['path']}").raise_for_status()
        assert (row["size_bytes"], row["sha256"]) == (len(got.content), hashlib.sha256(got.content).hexdigest())
        found[row["path"]] = got.content
    told = client.get(f"{API}/drives/{drive}").json()
    assert (told["files"], told["size_bytes"]) == (len(found), sum(map(len, found.values())))
    return found


@pytest.fixture
def begun(tmp_path: Path) -> tuple[Path, str]:
    """A data folder with a drive of one file, and the id of the drive; no server runs."""
    with opened(tmp_path / "data") as context:
        return tmp_path / "data", new_drive(context, {"poses.txt": OLD})


def test_a_new_file_that_was_not_acknowledged_goes_with_the_commit(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    files = data / f"drives/{drive}/files"
    kills.killed(kills.put, data, drive, "velodyne/000000.bin", NEW)
    assert (files / "velodyne/000000.bin").read_bytes() == NEW
    client = serve(data)
    assert shown(client, drive) == {"poses.txt": OLD}
    assert client.put(f"{API}/drives/{drive}/files/velodyne/000001.bin", content=NEW).status_code == 201
    assert client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=60"}).status_code == 422
    assert shown(client, drive) == {"poses.txt": OLD, "velodyne/000001.bin": NEW}
    assert not (files / "velodyne/000000.bin").exists()


@pytest.mark.parametrize("new", [NEW, OLD[::-1]], ids=["of another size", "of the same size"])
def test_a_file_that_was_being_replaced_is_to_be_sent_again(begun: tuple[Path, str], serve: Serve, new: bytes) -> None:
    data, drive = begun
    kills.killed(kills.put, data, drive, "poses.txt", new)
    client = serve(data)
    (listed,) = client.get(f"{API}/drives/{drive}/files").json()["files"]
    assert listed["sha256"] == hashlib.sha256(OLD).hexdigest()  # by which whoever resumes sends it again
    assert client.put(f"{API}/drives/{drive}/files/poses.txt", content=new).status_code == 200
    assert shown(client, drive) == {"poses.txt": new}


def test_a_file_that_was_being_deleted_is_still_there(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    kills.killed(kills.remove_file, data, drive, "poses.txt")
    client = serve(data)
    assert shown(client, drive) == {"poses.txt": OLD}
    assert client.delete(f"{API}/drives/{drive}/files/poses.txt").status_code == 204
    assert shown(client, drive) == {}


def test_a_database_that_goes_away_at_the_end_leaves_no_row_without_its_file(begun: tuple[Path, str]) -> None:
    """Whether it has committed is not known: the file stays."""
    data, drive = begun
    with opened(data) as context:
        place = context.storage.folder(f"drives/{drive}/files/a.txt")

        def place_and_fail(*, is_gone: bool) -> None:
            with Placement(context.storage, files_key(drive)) as placement:
                placement.move([Intake(context, "a.txt", 1000).finish()])
                raise OperationalError("COMMIT", {}, Exception("closed"), connection_invalidated=is_gone)

        for is_gone in (True, False):
            with pytest.raises(OperationalError):
                place_and_fail(is_gone=is_gone)
            assert place.exists() is is_gone
            place.unlink(missing_ok=True)


def test_a_file_that_is_missing_is_told_where_it_is_asked_for(begun: tuple[Path, str], serve: Serve) -> None:
    data, drive = begun
    client = serve(data)
    (data / f"drives/{drive}/files/poses.txt").unlink()
    answer = client.get(f"{API}/drives/{drive}/files/poses.txt")
    assert (answer.status_code, answer.json()["title"]) == (410, "File missing")
    assert "interloc admin check" in answer.json()["detail"]
    answer = client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=60"})
    assert (answer.status_code, answer.json()["detail"].split(":")[0]) == (422, "poses.txt")
    assert client.delete(f"{API}/drives/{drive}/files/poses.txt").status_code == 204
