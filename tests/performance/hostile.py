"""One client's short job next to ten hostile ones of another client: `python -m tests.performance.hostile`.

A real `interloc serve` with default workers. Eve sends maps that unpack to 245 MB, pose files of a million and of five
million lines, archives of very many files, and jobs with settings as large as they can be; Ann's job is short. The
table says how long it takes alone and beside Eve's, how each of those ended, and how much memory was used.
Runs for some minutes and needs 2 GB in the folder for temporary files; everything is removed at the end.
"""

import argparse
import gzip
import io
import os
import re
import shutil
import struct
import tarfile
import tempfile
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx

from app.jobs.processes import EXTRA_SLOTS, memory_share
from app.settings import Settings
from app.store.database import Database
from app.store.tokens import add_token
from interloc.processes import cores
from tests.app.processes import API, FINAL, ended, job_of, started, submit, upload
from tests.app.street import write_street
from tests.performance.shared import MB, Row, new_drive, sampled_memory, show

SCANS = 12
TRIES = 3
MAP_BYTES = 245_000_000
QUICKLY = {"Prefer": "respond-async"}


def large_map(street: Path) -> bytes:
    """The map of a street, packed, again and again under other ids."""
    text = (street / "map.osm").read_text()
    start, end = text.index("<node"), text.rindex("</osm>")
    packed = io.BytesIO()
    with gzip.open(packed, "wt", 1) as file:
        file.write(text[:start])
        for number in range(MAP_BYTES // (end - start)):
            file.write(re.sub(r'(id|ref)="(\d+)"', rf'\1="{number}\2"', text[start:end]))
        file.write(text[end:])
    return packed.getvalue()


def many_entries(count: int) -> bytes:
    """A zip file of empty files."""
    local = struct.pack("<4s5H3L2H", b"PK\x03\x04", 20, 0, 0, 0, 33, 0, 0, 0, 8, 0)
    head = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", 20, 20, 0, 0, 0, 33, 0, 0, 0, 8, 0, 0, 0, 0, 0, 0)
    names = [f"{number:08d}".encode() for number in range(count)]
    files, listing = b"".join(local + name for name in names), b"".join(head + name for name in names)
    record = struct.pack("<4sQ2H2L4Q", b"PK\x06\x06", 44, 45, 45, 0, 0, count, count, len(listing), len(files))
    locator = struct.pack("<4sLQL", b"PK\x06\x07", 0, len(files) + len(listing), 1)
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return files + listing + record + locator + end


def many_members(count: int) -> bytes:
    """A .tar.gz of empty files."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for number in range(count):
            archive.addfile(tarfile.TarInfo(f"velodyne/{number:06d}.bin"))
    return packed.getvalue()


def long_poses(root: Path, street: Path, lines: int) -> Path:
    folder = root / f"poses{lines}"
    shutil.copytree(street, folder)
    (folder / "poses.txt").write_text("1 0 0 12.5 0 1 0 0 0 0 1 0\n" * lines)
    return folder


def job_on(client: httpx.Client, drive: str, kind: str) -> str:
    answer = client.get(f"{API}/jobs", params={"drive": drive, "kind": kind}).json()
    job: str = answer["jobs"][0]["id"]
    return job


def send_archive(client: httpx.Client, content: bytes) -> str:
    drive = new_drive(client, "archive")
    client.post(f"{API}/drives/{drive}/archive", content=content, headers=QUICKLY).raise_for_status()
    return job_on(client, drive, "unpack")


def send_drive(client: httpx.Client, folder: Path) -> str:
    drive = new_drive(client, folder.name)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            address = f"{API}/drives/{drive}/files/{path.relative_to(folder).as_posix()}"
            client.put(address, content=path.read_bytes()).raise_for_status()
    client.post(f"{API}/drives/{drive}/commit", headers=QUICKLY).raise_for_status()
    return job_on(client, drive, "commit")


def hostile_jobs(client: httpx.Client, root: Path, street: Path) -> list[tuple[str, Callable[[], str]]]:
    """The ten of them, prepared; each call sends one and returns the id of its job."""
    drive, map_ = upload(client, street), large_map(street)
    for number in range(3):
        client.put(f"{API}/drives/{drive}/files/large{number}.osm.gz", content=map_).raise_for_status()
    zipped, packed = many_entries(1_000_000), many_members(250_000)
    drives = {lines: long_poses(root, street, lines) for lines in (1_000_000, 5_000_000)}
    extreme: list[dict[str, Any]] = [
        {"bev": {"resolution_m": 0.05, "size_m": 200}, "keyframes": {"window": 500}},
        {"bev": {"resolution_m": 0.05, "size_m": 200}, "candidates": {"kind": "harris", "min_score": 0.0}},
    ]
    return [
        *[
            (f"map of 245 MB, unpacked ({n + 1})", lambda n=n: submit(client, drive, osm={"file": f"large{n}.osm.gz"}))
            for n in range(3)
        ],
        *[
            (f"settings as large as they can be ({n + 1})", lambda n=n: submit(client, drive, config=extreme[n]))
            for n in range(2)
        ],
        *[(f"{lines:,} poses", lambda lines=lines: send_drive(client, drives[lines])) for lines in drives],
        *[(f"zip of 1,000,000 files ({n + 1})", lambda: send_archive(client, zipped)) for n in range(2)],
        ("tar.gz of 250,000 files", lambda: send_archive(client, packed)),
    ]


def seconds_of(client: httpx.Client, drive: str) -> float:
    """How long a job takes for whoever waits for it."""
    began = time.perf_counter()
    job = ended(client, submit(client, drive, osm={"file": "map.osm"}))
    assert job["state"] == "successful", job
    return time.perf_counter() - began


def clients(data: Path, address: str) -> list[httpx.Client]:
    database = Database(Settings(data_dir=data).sqlalchemy_url)
    tokens = [add_token(database, name) for name in ("ann", "eve")]
    database.close()
    return [
        httpx.Client(base_url=address, timeout=300, headers={"Authorization": f"Bearer {token}"}) for token in tokens
    ]


def end_of(job: dict[str, Any]) -> str:
    seconds = "" if job["finished_at"] is None else f", {_seconds_between(job):.0f} s"
    detail = (job["error"] or {}).get("detail", "")
    return f"{job['state']}{seconds}{': ' if detail else ''}{detail[:110]}"


def _seconds_between(job: dict[str, Any]) -> float:
    began, ended_ = (datetime.fromisoformat(job[name] or job["created_at"]) for name in ("started_at", "finished_at"))
    return (ended_ - began).total_seconds()


def measure(root: Path, stage_s: float) -> Iterator[Row]:
    street = write_street(root / "street", scans=SCANS)
    data = root / "data"
    with (
        started(data, root / "server.log", lease_s=30, job_stage_s=stage_s) as server,
        sampled_memory(server) as samples,
    ):
        ann, eve = clients(data, server.address)
        drive = upload(ann, street)
        alone = [seconds_of(ann, drive) for _ in range(TRIES)]
        yield "Ann's job, alone", ", ".join(f"{each:.1f} s" for each in alone)
        prepared = hostile_jobs(eve, root, street)
        jobs = {}
        for name, send in prepared:
            jobs[name] = send()
        beside = []
        for _ in range(TRIES):
            beside.append(seconds_of(ann, drive))
            busy = sum(job_of(eve, job)["state"] == "running" for job in jobs.values())
            time.sleep(2)
            yield f"Ann's job, beside {busy} of Eve's that run", f"{beside[-1]:.1f} s"
        began = time.perf_counter()
        upload(ann, street)
        yield "Ann's upload and check", f"{time.perf_counter() - began:.1f} s"
        for name, job in jobs.items():
            yield f"Eve: {name}", end_of(ended(eve, job, 60 * 60))
        for name, peak in zip(("server", "worker", "all"), map(max, zip(*samples, strict=True)), strict=True):
            yield f"peak memory, {name}", f"{peak / MB:,.0f} MB"
        yield "memory a worker may use", f"{memory_share(cores() + EXTRA_SLOTS) / MB:,.0f} MB"
        left = [job for job in jobs.values() if job_of(eve, job)["state"] not in FINAL]
        assert not left, left


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--stage-s", type=float, default=60.0, help="INTERLOC_JOB_STAGE_S of the server.")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="interloc-hostile-") as folder:
        show(measure(Path(folder), arguments.stage_s))
    show([("load of the machine at the end", f"{os.getloadavg()[0]:.1f}")])


if __name__ == "__main__":
    main()
