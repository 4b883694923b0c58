"""What the service carries: `make load`.

A real `interloc serve` on this machine and clients in processes of their own, over the loopback interface only:

- upload: per-file PUT of scans (2 MB and 200 kB) over four connections, against the disk's own speed in writing the
  same files one by one, each synced;
- CPU time of the server for 1,870 reduced scans, each by itself and in bundles, as `interloc push` sends them;
- memory of the server while 5 GB pass through it;
- reading: requests a second on a result of 10,000 detections, with and without a known ETag;
- listeners: 200 event streams on one running job, how late they hear of its end.

Runs for some minutes and needs 10 GB in the folder for temporary files; everything is removed at the end.
"""

import argparse
import asyncio
import http.client
import json
import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import psutil

from interloc.client.connection import Connection
from interloc.client.upload import UploadFile, upload
from tests.app.processes import API, ServerProcess, ended, started, submit
from tests.app.street import write_street
from tests.performance.shared import MB, Row, new_drive, sampled_memory, show

CONNECTIONS = 4
LISTENERS = 200
READ_S = 5.0


def disk_speed(folder: Path, files: int, size: int) -> float:
    """Bytes a second of writing files one by one, each synced: what an upload cannot beat."""
    folder.mkdir()
    content = os.urandom(size)
    began = time.perf_counter()
    for number in range(files):
        with (folder / f"{number}").open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    return files * size / (time.perf_counter() - began)


def put_many(server: ServerProcess, drive: str, contents: Iterator[tuple[str, bytes]]) -> tuple[int, int, float]:
    """Send files over some connections; returns files, bytes and seconds."""
    netloc = urlsplit(server.address).netloc
    lock, counts = threading.Lock(), [0, 0]

    def work() -> None:
        connection = http.client.HTTPConnection(netloc, timeout=120)
        while True:
            with lock:
                item = next(contents, None)
            if item is None:
                return
            connection.request("PUT", f"{API}/drives/{drive}/files/{item[0]}", body=item[1])
            answer = connection.getresponse()
            body = answer.read()
            assert answer.status in {200, 201}, body
            with lock:
                counts[0] += 1
                counts[1] += len(item[1])

    began = time.perf_counter()
    with ThreadPoolExecutor(CONNECTIONS) as pool:
        for future in [pool.submit(work) for _ in range(CONNECTIONS)]:
            future.result()
    return counts[0], counts[1], time.perf_counter() - began


def measure_uploads(server: ServerProcess, folder: Path, gigabytes: float) -> Iterator[Row]:
    """Throughput at two sizes of file, then memory while many bytes pass."""
    for size, files in ((2 * MB, 400), (200 * 1024, 2000)):
        own = disk_speed(folder / f"disk{size}", files, size)
        drive = new_drive(server.client, "speed")
        content = os.urandom(size)
        count, sent, seconds = put_many(server, drive, ((f"velodyne/{n:06d}.bin", content) for n in range(files)))
        server.client.delete(f"{API}/drives/{drive}")
        speed = sent / seconds
        value = f"{speed / MB:.0f} MB/s, {count / seconds:.0f} files/s; disk {own / MB:.0f} MB/s ({speed / own:.0%})"
        yield f"upload, files of {size / MB:.1f} MB", value
    with sampled_memory(server) as samples:
        rounds = max(1, round(gigabytes))
        content = os.urandom(2 * MB)
        for _ in range(rounds):
            drive = new_drive(server.client, "passing")
            put_many(server, drive, ((f"velodyne/{n:06d}.bin", content) for n in range(512)))
            server.client.delete(f"{API}/drives/{drive}")
    own = [sample[0] / MB for sample in samples]
    first = max(own[: max(1, len(own) // rounds)])
    value = f"{first:.0f} MB in the first, {max(own):.0f} MB at most, {own[-1]:.0f} MB at the end"
    yield f"memory of the server while {rounds} GB pass", value


def measure_bundles(server: ServerProcess) -> Iterator[Row]:
    """CPU time of the server per file and per GB."""
    files, content = [f"ground/labels/{number:06d}.ground" for number in range(1870)], os.urandom(76_500)
    gigabytes = len(files) * len(content) / 1e9

    def single(drive: str) -> None:
        put_many(server, drive, ((path, content) for path in files))

    def bundled(drive: str) -> None:
        with Connection(server.address) as connection:
            upload(connection, drive, [UploadFile(path, lambda: content) for path in files], threads=CONNECTIONS)

    for name, send in (("by itself", single), ("in bundles", bundled)):
        drive = new_drive(server.client, name)
        process = psutil.Process(server.process.pid)
        before = sum(process.cpu_times()[:2])
        send(drive)
        cpu_s = sum(process.cpu_times()[:2]) - before
        server.client.delete(f"{API}/drives/{drive}")
        value = f"{1e3 * cpu_s / len(files):.2f} ms of CPU per file, {cpu_s / gigabytes:.1f} s per GB"
        yield f"upload of {len(files):,} reduced scans, each {name}", value


def _read(netloc: str, path: str, headers: dict[str, str], status: int, counted: Any) -> None:
    connection = http.client.HTTPConnection(netloc, timeout=60)
    end, count = time.perf_counter() + READ_S, 0
    while time.perf_counter() < end:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        answer.read()
        assert answer.status == status
        count += 1
    counted.put(count)


def measure_reads(server: ServerProcess, job: str) -> Iterator[Row]:
    """Requests a second on the detections of a big result."""
    path = f"{API}/jobs/{job}/layers/detections"
    answer = server.client.get(path)  # compressed, which has an ETag of its own
    size, detections = len(answer.content), len(answer.json()["features"])
    etag = answer.headers["etag"]
    spawn = multiprocessing.get_context("spawn")
    kinds = (
        ("whole", {}, 200),
        ("gzip", {"Accept-Encoding": "gzip"}, 200),
        ("unchanged (304)", {"Accept-Encoding": "gzip", "If-None-Match": etag}, 304),
    )
    for name, headers, status in kinds:
        counted = spawn.Queue()
        netloc = urlsplit(server.address).netloc
        readers = [spawn.Process(target=_read, args=(netloc, path, headers, status, counted)) for _ in range(2)]
        for reader in readers:
            reader.start()
        total = sum(counted.get() for _ in readers)
        for reader in readers:
            reader.join()
        yield (f"GET {detections:,} detections ({size / MB:.1f} MB), {name}", f"{total / READ_S:.0f} requests/s")


async def _listen(address: str, job: str, heard: list[float]) -> None:
    parts = urlsplit(address)
    reader, writer = await asyncio.open_connection(parts.hostname, parts.port)
    head = f"GET {API}/jobs/{job}/events HTTP/1.1\r\nHost: {parts.netloc}\r\nAccept: text/event-stream\r\n\r\n"
    writer.write(head.encode())
    await writer.drain()
    while line := await reader.readline():
        if line.startswith(b"data:") and json.loads(line[5:])["state"] == "successful":
            heard.append(time.time())
            break
    writer.close()


def measure_listeners(server: ServerProcess, drive: str) -> Iterator[Row]:
    """Many event streams on one job."""
    job = submit(server.client, drive, config={"bev": {"resolution_m": 0.14}})
    heard: list[float] = []
    process = psutil.Process(server.process.pid)
    before, began = sum(process.cpu_times()[:2]), time.perf_counter()

    async def listen() -> None:
        await asyncio.gather(*(_listen(server.address, job, heard) for _ in range(LISTENERS)))

    asyncio.run(listen())
    cpu = (sum(process.cpu_times()[:2]) - before) / (time.perf_counter() - began)
    ended(server.client, job)
    value = (
        f"{len(heard)} heard its end, the last {max(heard) - min(heard):.2f} s after the first; "
        f"server at {cpu:.0%} of a core, {process.memory_info().rss / MB:.0f} MB"
    )
    yield f"{LISTENERS} listeners on a job of {time.perf_counter() - began:.0f} s", value


def measure_drive(server: ServerProcess, street: Path, scans: int) -> Iterator[Row]:
    """A whole drive: upload, commit, job; then reads and listeners."""
    drive = new_drive(server.client, "street")
    files = [path for path in street.rglob("*") if path.is_file()]
    contents = ((path.relative_to(street).as_posix(), path.read_bytes()) for path in files)
    count, sent, seconds = put_many(server, drive, contents)
    name = f"upload of a drive, {count:,} files, {sent / MB:.0f} MB"
    yield name, f"{count / seconds:.0f} files/s, {seconds:.1f} s"
    began = time.perf_counter()
    answer = server.client.post(f"{API}/drives/{drive}/commit", headers={"Prefer": "wait=300"}, timeout=310)
    assert answer.status_code == 200, answer.text
    stored = answer.json()["stored_bytes"]
    yield "commit: check and reduce", f"{time.perf_counter() - began:.1f} s, {stored / MB:.0f} MB kept"
    began = time.perf_counter()
    job = submit(server.client, drive)
    ended(server.client, job, 300)
    yield "job", f"{time.perf_counter() - began:.1f} s for {scans:,} keyframes"
    yield from measure_reads(server, job)
    yield from measure_listeners(server, drive)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gigabytes", type=float, default=5.0, help="to pass through the server")
    parser.add_argument("--scans", type=int, default=6800, help="of the drive whose detections are read")
    parser.add_argument("--database", help="URL of an empty database; a SQLite file by default")
    options = parser.parse_args()
    database = {"database_url": options.database} if options.database else {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        street = write_street(folder / "street", options.scans)
        with started(folder / "data", folder / "server.log", **database) as server:
            show(measure_bundles(server))
            show(measure_uploads(server, folder, options.gigabytes))
            show(measure_drive(server, street, options.scans))


if __name__ == "__main__":
    main()
