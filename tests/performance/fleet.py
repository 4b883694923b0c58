"""Servers on one data folder, clients and backups that live through whatever happens to them, and a ledger of it all.

For `tests.performance.torture`.
"""

import hashlib
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import psutil
from sqlalchemy import select

from app.context import Context
from app.settings import Settings
from app.store.models import DriveFile
from interloc.client.live import LiveSender
from interloc.config import preset
from interloc.drives.open import open_drive
from interloc.errors import NetworkError
from interloc.live.scan import LiveScan, play
from tests.app.jobs.test_webhooks import SECRET
from tests.app.processes import API, FINAL, Command, ServerProcess, archive_of, files_below, free_port, without_job

CLIENTS = 3
SERVERS = 2
LEASE_S = 3.0
PATIENCE_S = 600.0  # a job may be killed many times before it comes to its end
TOLD_S = 120.0  # in which a subscriber hears of the end of a job, though calls are cut off
KEPT_DRIVES = 2  # per client; older ones are deleted, so that looking through all of them stays quick
ANEW = {429, 500, 502, 503, 507}


class Receiver(ThreadingHTTPServer):
    """Notes the ids under which each message came; fails a tenth of them at the first try."""

    daemon_threads = True

    def __init__(self, rng: random.Random, delay_s: float = 0.0) -> None:
        self.delay_s = delay_s
        self.ids: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
        self.failed: set[str] = set()
        self.rng = rng
        self.lock = threading.Lock()
        self.is_called = threading.Event()
        super().__init__(("127.0.0.1", 0), _Handler)
        threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True).start()


class _Handler(BaseHTTPRequestHandler):
    server: Receiver

    def do_POST(self) -> None:
        told = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        id_ = self.headers["webhook-id"]
        with self.server.lock:
            fails = id_ not in self.server.failed and self.server.rng.random() < 0.1
            self.server.failed.add(id_)
            if not fails:
                self.server.ids[told["data"]["job_id"], told["type"]].append(id_)
        self.server.is_called.set()
        time.sleep(self.server.delay_s)
        self.server.is_called.clear()
        self.send_response(500 if fails else 204)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@dataclass
class Ledger:
    """What was acknowledged, and what turned out to be otherwise."""

    files: dict[str, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))
    jobs: dict[str, str] = field(default_factory=dict)
    done: Counter[str] = field(default_factory=Counter)
    faults: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    asked: set[str] = field(default_factory=set)
    """Jobs whose end is to be told."""
    doing: Counter[str] = field(default_factory=Counter)
    """How many clients are at work on a map, or drive: "map", "live"."""
    receiver: Receiver = field(default_factory=lambda: Receiver(random.Random(0), 0.3))  # noqa: S311
    """Who is told of the jobs."""
    maps: set[str] = field(default_factory=set)
    """SHA-256 of the layers of maps of one drive: all drives hold the same, and so must all maps."""

    @contextmanager
    def at(self, what: str) -> Iterator[None]:
        """Count who is at work on something, for those who kill just then."""
        self.doing[what] += 1
        try:
            yield
        finally:
            self.doing[what] -= 1

    def snapshot(self) -> dict[str, dict[str, str]]:
        """Files by drive, as of now."""
        return {drive: dict(paths) for drive, paths in list(self.files.items())}

    def compare_files(self, context: Context, known: dict[str, dict[str, str]], where: str) -> None:
        """Note files that were acknowledged and are not listed, or with other bytes."""
        with context.database.reading() as session:
            rows = session.execute(select(DriveFile.drive_id, DriveFile.path, DriveFile.sha256))
            listed = {(row.drive_id, row.path): row.sha256 for row in rows}
        for drive, paths in known.items():
            for path, digest in paths.items():
                if listed.get((drive, path)) != digest and drive in self.files:  # not deleted meanwhile
                    self.faults["lost"].append(f"{where}: drive {drive}: {path}")

    def compare_told(self) -> None:
        """Note jobs whose end was not told, or under several ids; a call that was cut off is made again after 30 s."""
        end = time.monotonic() + TOLD_S
        while missing := [
            job for job in list(self.jobs) if (job, "job.successful") not in self.receiver.ids and job in self.asked
        ]:
            if time.monotonic() > end:
                break
            time.sleep(0.2)
        self.faults["untold"] += missing
        told = list(self.receiver.ids.items())
        self.faults["double"] += [f"told of job {job}" for (job, _), ids in told if len(set(ids)) > 1]
        self.done["calls of the subscriber"] = len(told)

    def forget(self, drive: str) -> None:
        """A drive is about to be deleted for good."""
        self.files.pop(drive, None)
        for job in [job for job, of in list(self.jobs.items()) if of == drive]:
            self.jobs.pop(job, None)


class Cluster:
    """A Dask scheduler and two workers with their nannies; what dies is started again, as a supervisor would."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        port = free_port()
        self.address = f"tcp://127.0.0.1:{port}"
        scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
        worker = ["worker", self.address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "10"]
        self._commands = {"scheduler": scheduler, "worker1": worker, "worker2": worker}
        self._folder = folder
        self._processes = {name: self._start(name) for name in self._commands}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._supervise)
        self._thread.start()

    def scheduler(self) -> psutil.Process:
        return psutil.Process(self._processes["scheduler"].pid)

    def workers(self) -> list[psutil.Process]:
        nannies = [process.pid for name, process in self._processes.items() if name != "scheduler"]
        found = []
        for pid in nannies:
            with suppress(psutil.NoSuchProcess):
                nanny = psutil.Process(pid)
                found += [nanny, *nanny.children(recursive=True)]
        return found

    def close(self) -> None:
        self._stopping.set()
        self._thread.join()
        for process in [*self.workers(), self.scheduler()]:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        for started in self._processes.values():
            started.wait()

    def _start(self, name: str) -> subprocess.Popen[bytes]:
        with (self._folder / f"{name}.log").open("ab") as log:
            command = [sys.executable, "-m", "dask", *self._commands[name]]
            return subprocess.Popen(command, stdout=log, stderr=log, cwd=self._folder)

    def _supervise(self) -> None:
        while not self._stopping.wait(0.2):
            for name, process in self._processes.items():
                if process.poll() is not None:
                    self._processes[name] = self._start(name)


class Fleet:
    """Servers on one data folder, each on a port of its own that it keeps."""

    def __init__(
        self, folder: Path, database_url: str | None, count: int = SERVERS, cluster: Cluster | None = None
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.cluster = cluster
        self.data = folder / "data"
        self.database_url = database_url
        self._folder = folder
        self._options: dict[str, Any] = {"workers": 1, "lease_s": LEASE_S, "max_attempts": 20, "min_free_bytes": 0}
        self._options |= {"webhook_hosts": "127.0.0.1", "webhook_secret": SECRET}
        if database_url is not None:
            self._options["database_url"] = database_url
        if cluster is not None:
            self._options["dask"] = cluster.address
        self._ports = [free_port() for _ in range(count)]
        self.servers: list[ServerProcess] = []
        self.servers = [self._start(number) for number in range(count)]

    def settings(self) -> Settings:
        return Settings(data_dir=self.data, database_url=self.database_url, min_free_bytes=0)

    def address(self, rng: random.Random) -> str:
        return f"http://127.0.0.1:{rng.choice(self._ports)}"

    def restart(self, number: int) -> None:
        self.servers[number].close()
        self.servers[number] = self._start(number)

    def is_ready(self) -> bool:
        with suppress(httpx.TransportError):
            return all(server.client.get("/readyz", timeout=10).status_code == 200 for server in self.servers)
        return False

    def close(self) -> None:
        for server in self.servers:
            server.close()

    def _start(self, number: int) -> ServerProcess:
        return ServerProcess(self.data, self._folder / f"server{number}.log", port=self._ports[number], **self._options)


class _StoppedError(Exception):
    """The client was asked to stop."""


class Client:
    """A client that lives through whatever happens to the servers: it asks again until it is answered."""

    def __init__(self, fleet: Fleet, ledger: Ledger, street: Path, reference: dict[str, str], seed: str) -> None:
        self.fleet = fleet
        self.ledger = ledger
        self.rng = random.Random(seed)  # noqa: S311 - to be repeated
        self.stopping = threading.Event()
        self.process: Command | None = None  # to be killed
        self._street = street
        self._contents = {path.relative_to(street).as_posix(): path.read_bytes() for path in files_below(street)}
        self._archive = archive_of(street)
        self._reference = reference
        self._http = httpx.Client(timeout=30)
        self._mine: list[str] = []
        self._home = Path(tempfile.mkdtemp(dir=street.parent))

    def live(self) -> None:
        """Do one thing after the other until it is stopped."""
        while not self.stopping.is_set():
            try:
                send = self.rng.choice([self._put_files, self._send_archive, self._push, self._drive_live])
                if (drive := send()) is not None and not self.stopping.is_set():
                    self._work_on(drive)
            except _StoppedError:
                return
            except Exception as error:  # noqa: BLE001 - whatever it is belongs into the table, and the client goes on
                self.ledger.faults["client"].append(f"{type(error).__name__}: {str(error)[:300]}")

    def ask(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Send a request until it is answered by something else than "not now"."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            self._stop_if_asked()
            with suppress(httpx.TransportError):
                answer = self._http.request(method, f"{self.fleet.address(self.rng)}{API}{path}", **options)
                if answer.status_code == 500:
                    self.ledger.faults["500"].append(f"{method} {path}: {answer.text}")
                if answer.status_code not in ANEW:
                    return answer
            time.sleep(0.1)
        raise AssertionError(f"{method} {path} was not answered within {PATIENCE_S:.0f} s")

    def _stop_if_asked(self) -> None:
        if self.stopping.is_set():
            raise _StoppedError

    def _new_drive(self) -> str:
        drive: str = self.ask("POST", "/drives", json={"name": "street"}).raise_for_status().json()["id"]
        self.ledger.files[drive] = {}
        self._mine.append(drive)
        return drive

    def _put_files(self) -> str | None:
        drive = self._new_drive()
        for path, content in self._contents.items():
            if self.stopping.is_set():
                return None
            self.ask("PUT", f"/drives/{drive}/files/{path}", content=content).raise_for_status()
            self.ledger.files[drive][path] = sha256(content)
        self.ledger.done["uploads, file by file"] += 1
        return drive

    def _send_archive(self) -> str | None:
        drive = self._new_drive()
        answer = self.ask(
            "POST", f"/drives/{drive}/archive", content=self._archive, headers={"Prefer": "respond-async"}
        ).raise_for_status()
        self._end_of(answer.json()["job_id"])
        self.ledger.files[drive].update({path: sha256(content) for path, content in self._contents.items()})
        self.ledger.done["archives"] += 1
        return drive

    def _push(self) -> str | None:
        """Push a reduced drive, as often as the killer makes it necessary."""
        home = Path(tempfile.mkdtemp(dir=self._home))
        out, server = home / "out", self.fleet.address(self.rng)
        street = Path(shutil.copytree(self._street, home / "street"))  # the same folder would be the same drive
        environment = {**os.environ, "XDG_CACHE_HOME": str(home)}
        while not self.stopping.is_set():
            out.write_bytes(b"")
            arguments = ["push", street, "--osm", street / "map.osm", "--server", server, "--json"]
            self.process = Command(arguments, environment, out, home / "err")
            self.process.join()
            if self.process.exitcode == 0:
                drive = str(json.loads(out.read_text())["drive_id"])
                self._mine.append(drive)
                self.ledger.files[drive] = self._listed(drive)
                self.ledger.done["pushes"] += 1
                return drive
            time.sleep(0.1)
        return None

    def _drive_live(self) -> None:
        """Drive a session that is kept; where its server is killed another one begins. Its drive and its job stay."""
        said: list[dict[str, Any]] = []

        def scans(after: int) -> Iterator[LiveScan]:
            for scan in play(open_drive(self._street), preset("default"), speed=1.0, after=after):
                self._stop_if_asked()
                yield scan

        address = self.fleet.address(self.rng)
        keep = {"name": "live", "keep": True}
        try:
            with self.ledger.at("live"):
                LiveSender(address, None, keep, said.append, keeps_all=True, patience_s=PATIENCE_S).run(scans)
        except NetworkError as error:
            if "all was sent" not in str(error):
                raise
            return  # its server was killed before the end was heard
        end = said[-1]
        self._mine.append(end["drive_id"])
        self.ledger.files[end["drive_id"]] = self._listed(end["drive_id"])
        if sum(each["type"] == "session" for each in said) == 1:  # else the last one may have had no scans
            self.ledger.jobs[end["job_id"]] = end["drive_id"]
            self._end_of(end["job_id"])
            self.ledger.done["live drives"] += 1
        self._tidy()

    def _work_on(self, drive: str) -> None:
        """Commit a drive, have its intersections found, look at them; sometimes delete and restore it."""
        end = time.monotonic() + PATIENCE_S
        while self.ask("GET", f"/drives/{drive}").json()["state"] != "ready":
            answer = self.ask("POST", f"/drives/{drive}/commit", headers={"Prefer": "wait=5"})
            assert answer.status_code in {200, 202, 409}, answer.text
            assert time.monotonic() < end, f"drive {drive} was not ready within {PATIENCE_S:.0f} s"
        self.ledger.done["commits"] += 1
        key = f"{self.rng.getrandbits(64):x}"
        told = {"successUri": f"http://127.0.0.1:{self.ledger.receiver.server_port}/"}
        request = {"drive_id": drive, "osm": {"file": "map.osm"}, "subscriber": told}
        answer = self.ask("POST", "/jobs", json=request, headers={"Idempotency-Key": key}).raise_for_status()
        job: str = answer.json()["id"]
        self.ledger.jobs[job] = drive
        self.ledger.asked.add(job)
        self._end_of(job)
        self._compare(job)
        self.ledger.done["jobs"] += 1
        if self.rng.random() < 0.5:
            self.ask("DELETE", f"/drives/{drive}")
            answer = self.ask("POST", f"/trash/drives/{drive}/restore")
            if answer.status_code == 404 and self.ask("GET", f"/drives/{drive}").status_code != 200:
                self.ledger.faults["lost"].append(f"drive {drive} was not in the trash: {answer.text}")
            self._compare(job)
            self.ledger.done["drives deleted and restored"] += 1
        if self.rng.random() < 0.5:
            with self.ledger.at("map"):
                self._merge(drive)
        self._tidy()

    def _tidy(self) -> None:
        while len(self._mine) > KEPT_DRIVES:
            old = self._mine.pop(0)
            self.ledger.forget(old)
            self.ask("DELETE", f"/drives/{old}?purge=true")

    def _merge(self, drive: str) -> None:
        """Make a map of a drive, take the drive out, put it in again: it is the same map with the same names."""
        city: str = (
            self.ask("POST", "/maps", json={"name": "street", "drives": [drive]}).raise_for_status().json()["id"]
        )
        for method, drives in (("PUT", 1), ("DELETE", 0), ("PUT", 1)):
            self.ask(method, f"/maps/{city}/drives/{drive}").raise_for_status()
            end = time.monotonic() + PATIENCE_S
            while (told := self.ask("GET", f"/maps/{city}").json())["drives"] != drives or told["is_waiting"]:
                assert time.monotonic() < end, f"map {city} did not come up to date within {PATIENCE_S:.0f} s: {told}"
                time.sleep(0.1)
            layers = [self.ask("GET", f"/maps/{city}/files/{name}.geojson").content for name in ("city", "drives")]
            found = self.ask("GET", f"/maps/{city}/ogc/collections/city/items").json()["numberMatched"]
            if found != layers[0].count(b'"uid"'):
                self.ledger.faults["unequal"].append(
                    f"map {city}: {found} intersections in the index, others in its file"
                )
            if drives:
                self.ledger.maps.add(sha256(b"".join(layers)))
        if len(self.ledger.maps) > 1:
            self.ledger.faults["unequal"].append(f"map {city} is not that of before")
        self.ask("DELETE", f"/maps/{city}")
        self.ledger.done["maps"] += 1

    def _end_of(self, job: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while (told := self.ask("GET", f"/jobs/{job}").raise_for_status().json())["state"] not in FINAL:
            assert time.monotonic() < end, f"job {job} did not end within {PATIENCE_S:.0f} s: {told}"
            time.sleep(0.1)
        if told["state"] != "successful":
            self.ledger.faults["failed"].append(f"job {job}: {told['error']}")

    def _compare(self, job: str) -> None:
        for name, expected in self._reference.items():
            answer = self.ask("GET", f"/jobs/{job}/files/{name}")
            if answer.status_code != 200:
                self.ledger.faults["lost"].append(f"job {job}: {name}: {answer.text}")
            elif without_timings(name, answer.content) != expected:
                self.ledger.faults["unequal"].append(f"job {job}: {name}")

    def _listed(self, drive: str) -> dict[str, str]:
        files = self.ask("GET", f"/drives/{drive}/files?limit=1000").raise_for_status().json()["files"]
        return {file["path"]: file["sha256"] for file in files}

    def close(self) -> None:
        self.stopping.set()
        self._http.close()


def without_timings(name: str, content: bytes) -> str:
    """SHA-256 of a file of a result, without what no two runs have in common: times, and the id of the job."""
    if name == "report.json":
        report = json.loads(content)
        content = json.dumps({key: value for key, value in report.items() if "seconds" not in key}).encode()
    return sha256(without_job(content))


def undisturbed(folder: Path, street: Path) -> dict[str, str]:
    """Files of the result of a run that nothing disturbs: layers, figures and the report as data."""
    fleet = Fleet(folder, None, count=1)
    client = Client(fleet, Ledger(), street, {}, "undisturbed")
    try:
        drive = client._put_files()
        assert drive is not None
        client._work_on(drive)
        (job,) = client.ledger.jobs
        files = client.ask("GET", f"/jobs/{job}/files").json()["files"]
        kept = [file["name"] for file in files if file["name"].endswith((".geojson", ".svg", "report.json"))]
        assert kept, files
        return {path: without_timings(path, client.ask("GET", f"/jobs/{job}/files/{path}").content) for path in kept}
    finally:
        client.close()
        fleet.close()


@contextmanager
def clients(fleet: Fleet, ledger: Ledger, street: Path, reference: dict[str, str], seed: str) -> Iterator[list[Client]]:
    """Let clients live until the block ends."""
    living = [Client(fleet, ledger, street, reference, f"{seed}-{number}") for number in range(CLIENTS)]
    threads = [threading.Thread(target=client.live) for client in living]
    for thread in threads:
        thread.start()
    try:
        yield living
    finally:
        for client in living:
            client.stopping.set()
            if client.process is not None:
                client.process.kill()
        for thread in threads:
            thread.join()


class Backups:
    """`interloc admin backup`, over and over."""

    def __init__(self, fleet: Fleet, out: Path, ledger: Ledger) -> None:
        self._fleet = fleet
        self.out = out
        self._ledger = ledger
        self._process: Command | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def kill(self) -> bool:
        process = self._process
        if process is None or not process.is_alive():
            return False
        process.kill()
        return True

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("INTERLOC_")}
        if self._fleet.database_url is not None:
            environment["INTERLOC_DATABASE_URL"] = self._fleet.database_url
        log, out = self.out.with_name("backup.log"), self.out.with_name("backup.out")
        while not self._stopping.wait(0.5):
            log.write_bytes(b"")
            shutil.rmtree(self.out, ignore_errors=True)
            arguments = ["admin", "backup", self.out, "--data-dir", self._fleet.data, "--quiet"]
            self._process = Command(arguments, environment, out, log)
            self._process.join()
            if self._process.exitcode == 0:
                self._ledger.done["backups"] += 1
            elif log.read_text() and "database" not in log.read_text():
                self._ledger.faults["backup"].append(log.read_text())
