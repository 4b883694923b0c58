"""What is killed, cut off or filled up half-way: nothing is lost, and nothing is done twice."""

import json
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.http.problem_types import STORAGE_READ_ONLY
from app.http.problems import problem_of
from app.store.storage import Storage
from interloc.cli.main import run
from interloc.reduction.reduce import reduce_drive
from tests.app.conftest import Start
from tests.app.processes import (
    API,
    FINAL,
    Gate,
    ServerProcess,
    archive_of,
    as_by_command,
    connected,
    ended,
    files_below,
    half_way,
    job_of,
    kill_if_there,
    submit,
    upload,
    wait_until,
)
from tests.app.street import write_street
from tests.once import once

LAYERS = ("detections", "intersections", "keyframes", "trajectory")
SCANS = 40
MIDDLE = 25


@dataclass(frozen=True)
class Drive:
    """A reduced drive with its map, and what the command line finds on it: the features of each layer."""

    folder: Path
    expected: dict[str, Any]


def make_drive(root: Path, scans: int, *, scored: bool = False) -> None:
    street, small, out = write_street(root / "raw" / "street", scans), root / "street", root / "result"
    reduce_drive(street, small, keyframes=None)
    shutil.copy(street / "map.osm", small)
    command = ["run", "--osm", str(small / "map.osm")] if scored else ["run"]
    assert run([*command, str(small), "-o", str(out), "--quiet"]) == 0


def read_drive(root: Path) -> Drive:
    found = {layer: json.loads((root / f"result/{layer}.geojson").read_text())["features"] for layer in LAYERS}
    return Drive(root / "street", found)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """A drive of which all keyframes are one range. Shared: do not change it."""
    return read_drive(once(tmp_path_factory, "reduced street", lambda root: make_drive(root, SCANS)))


def assert_result(client: httpx.Client, job: dict[str, Any], drive: Drive) -> None:
    assert job["state"] == "successful", job
    for layer, features in drive.expected.items():
        answer = client.get(f"{API}/jobs/{job['id']}/layers/{layer}")
        assert answer.status_code == 200, answer.text
        assert json.dumps(json.loads(as_by_command(answer))["features"]) == json.dumps(features), layer


def standing_job(
    server: ServerProcess, data_dir: Path, drive: Drive, frame: int = MIDDLE, **request: Any
) -> tuple[str, Gate]:
    """Submit a job that stands still half-way; returns its id and what it stands at."""
    drive_id = upload(server.client, drive.folder)
    gate = Gate(data_dir, drive_id, frame)
    job = submit(server.client, drive_id, **request)
    half_way(server.client, job)
    return job, gate


def test_a_killed_worker_is_replaced_and_its_part_done_again(start: Start, drive: Drive, tmp_path: Path) -> None:
    server = start(workers=2)
    job, gate = standing_job(server, tmp_path / "data", drive)
    before = {worker.pid for worker in server.workers()}
    assert before
    for worker in server.workers():
        kill_if_there(worker)
    gate.open()
    assert_result(server.client, ended(server.client, job), drive)
    assert before.isdisjoint(worker.pid for worker in server.workers())


def test_a_job_goes_on_where_the_killed_server_left_it(start: Start, tmp_path: Path) -> None:
    make_drive(tmp_path / "long", 362, scored=True)  # two ranges
    long = read_drive(tmp_path / "long")
    server = start(workers=1)
    job, gate = standing_job(server, tmp_path / "data", long, frame=300, osm={"file": "map.osm"})
    scratch = tmp_path / "data" / "jobs" / job / "scratch"

    def checkpoints() -> dict[str, int]:
        return {path.name: path.stat().st_mtime_ns for path in files_below(scratch) if path.name.startswith("range-")}

    wait_until(checkpoints, "the first finished range")
    workers = server.workers()
    server.kill()
    wait_until(lambda: not any(worker.is_running() for worker in workers), "the workers to end with their server")
    done = checkpoints()

    again = start(workers=1)
    wait_until(lambda: job_of(again.client, job)["attempts"] == 2, "the lease to run out", every_s=0.1)
    half_way(again.client, job)
    assert checkpoints() == done  # not done twice
    gate.open()
    assert_result(again.client, ended(again.client, job), long)
    assert not scratch.exists()


def test_a_stopped_server_gives_its_job_back(start: Start, drive: Drive, tmp_path: Path) -> None:
    server = start(workers=1)
    job, gate = standing_job(server, tmp_path / "data", drive)
    assert server.stop() == 0

    gate.open()
    again = start(workers=1)
    job_again = ended(again.client, job)
    assert job_again["attempts"] == 1  # an orderly stop is no failed attempt
    assert_result(again.client, job_again, drive)


def test_an_upload_goes_on_after_the_server_was_killed(start: Start, tmp_path: Path) -> None:
    street = write_street(tmp_path / "street", scans=20)
    server = start()
    drive = server.client.post(f"{API}/drives", json={"name": "street"}).json()["id"]
    names = ["poses.txt", "velodyne/000000.bin", "labels/000000.label"]
    for name in names:
        answer = server.client.put(f"{API}/drives/{drive}/files/{name}", content=(street / name).read_bytes())
        assert answer.status_code == 201
    size = 16 * 1024**2
    with connected(server.client) as connection:
        head = f"PUT {API}/drives/{drive}/files/velodyne/000001.bin HTTP/1.1\r\nHost: localhost\r\n"
        connection.sendall(f"{head}Content-Length: {size}\r\n\r\n".encode() + bytes(size // 2))
        incoming = tmp_path / "data" / "incoming"
        wait_until(lambda: files_below(incoming), "the beginning of the file")
        server.kill()

    again = start()
    listed = again.client.get(f"{API}/drives/{drive}/files").json()["files"]
    assert sorted(file["path"] for file in listed) == sorted(names)
    answer = again.client.post(
        f"{API}/drives/{drive}/archive", content=archive_of(street), headers={"Prefer": "wait=120"}
    )
    assert answer.status_code == 200, answer.text
    answer = again.client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=120"})
    assert answer.status_code == 200, answer.text
    assert answer.json()["state"] == "ready"


def test_a_job_that_kills_every_worker_fails_with_the_reason(start: Start, drive: Drive, tmp_path: Path) -> None:
    server = start(workers=1, max_attempts=2)
    job, gate = standing_job(server, tmp_path / "data", drive)

    def look() -> dict[str, Any] | None:
        for worker in server.workers():
            kill_if_there(worker)
        state = job_of(server.client, job)
        return state if state["state"] in FINAL else None

    end = wait_until(look, "the end of the job")
    assert end["state"] == "failed", end
    assert "worker" in end["error"]["detail"]
    assert "memory" in end["error"]["detail"]
    assert end["attempts"] <= 2
    gate.open()
    good = submit(server.client, end["drive_id"])  # others are not harmed
    assert ended(server.client, good)["state"] == "successful"


def test_two_servers_share_the_work_on_one_database(start: Start, drive: Drive, postgres_url: str) -> None:
    first, second = (start(workers=1, jobs_at_once=1, database_url=postgres_url) for _ in range(2))
    drive_id = upload(first.client, drive.folder)
    jobs = [submit((first, second)[i % 2].client, drive_id) for i in range(4)]
    for job in jobs:
        end = ended(second.client, job)
        assert end["attempts"] == 1  # nothing twice
        assert_result(first.client, end, drive)


def test_a_server_takes_over_from_one_that_was_killed(
    start: Start, drive: Drive, tmp_path: Path, postgres_url: str
) -> None:
    first = start(workers=1, database_url=postgres_url)
    job, gate = standing_job(first, tmp_path / "data", drive)
    second = start(workers=1, database_url=postgres_url)
    first.kill()
    gate.open()
    assert_result(second.client, ended(second.client, job), drive)


def test_a_full_disk_refuses_uploads_and_keeps_what_is_there(start: Start, small_disk: Path) -> None:
    server = start(data_dir=small_disk, workers=1)
    drive = server.client.post(f"{API}/drives", json={"name": "full"}).json()["id"]
    address = f"{API}/drives/{drive}/files"
    piece = os.urandom(8 * 1024**2)
    answers = [server.client.put(f"{address}/velodyne/{number:06d}.bin", content=piece) for number in range(9)]
    codes = [answer.status_code for answer in answers]
    stored = codes.index(507)
    assert set(codes[:stored]) == {201}
    assert answers[stored].headers["content-type"] == "application/problem+json"
    assert "disk" in answers[stored].json()["detail"]
    listed = server.client.get(address).json()["files"]
    assert len(listed) == codes.count(201)  # nothing of the refused ones is listed
    assert not files_below(small_disk / "incoming")
    kept = server.client.get(f"{address}/velodyne/000000.bin")
    assert kept.content == piece
    for number in range(codes.count(201)):
        assert server.client.delete(f"{address}/velodyne/{number:06d}.bin").status_code == 204
    assert server.client.put(f"{address}/velodyne/000000.bin", content=piece).status_code == 201  # room again


def test_a_disk_made_read_only_is_told(small_disk: Path) -> None:
    storage = Storage(small_disk)
    storage.check_writable()
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with pytest.raises(OSError, match="Read-only") as refused:
        storage.check_writable()
    assert problem_of(refused.value).kind == STORAGE_READ_ONLY


def test_a_job_on_a_full_disk_fails_in_words(start: Start, drive: Drive, small_disk: Path, tmp_path: Path) -> None:
    database = f"sqlite:///{tmp_path / 'elsewhere.sqlite3'}"  # so that the failure itself can be recorded
    server = start(data_dir=small_disk, workers=1, database_url=database)
    drive_id = upload(server.client, drive.folder)
    filler = small_disk / "filler"
    subprocess.run(["dd", "if=/dev/zero", f"of={filler}", "bs=4k"], check=False, capture_output=True)
    end = ended(server.client, submit(server.client, drive_id))
    assert end["state"] == "failed"
    assert end["error"]["status"] == 507
    assert "space" in end["error"]["detail"]
    filler.unlink()
    assert ended(server.client, submit(server.client, drive_id))["state"] == "successful"
