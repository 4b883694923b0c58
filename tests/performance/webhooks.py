"""Deliveries to a subscriber that fails now and then, by servers that are killed: none may be lost.

    python -m tests.performance.webhooks --deliveries 1000 --kills 8

Each drive is committed with a subscriber that is told of the begin and the end of its check. A hostile subscriber, who
takes every connection and never answers, is told of every tenth drive beside. At the end each message must have come,
and one that came twice under the same id.
"""

import argparse
import base64
import json
import random
import socket
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx

from tests import forks
from tests.app.processes import API, NO_TLS, ServerProcess

SECRET = "whsec_" + base64.b64encode(bytes(range(32))).decode()
PATIENCE_S = 150.0


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


def ask(servers: list[ServerProcess], method: str, path: str, **given: Any) -> httpx.Response:
    """Ask whichever server lives, until one answers."""
    while True:
        try:
            return httpx.request(method, f"{servers[-1].address}{API}{path}", timeout=30, verify=NO_TLS, **given)
        except httpx.TransportError:
            time.sleep(0.1)


def commit(servers: list[ServerProcess], subscriber: dict[str, str]) -> str | None:
    """Make a drive without files, and commit it; returns the id of the job of its check."""
    drive = ask(servers, "POST", "/drives", json={"name": "empty"}).json()["id"]
    given = {"json": {"subscriber": subscriber}, "headers": {"Prefer": "wait=0"}}
    ask(servers, "POST", f"/drives/{drive}/commit", **given)
    jobs = ask(servers, "GET", f"/jobs?kind=commit&drive={drive}").json()["jobs"]
    return jobs[0]["id"] if jobs and jobs[0]["request"].get("subscriber") else None


def main(say: Callable[[str], object] = print) -> None:
    """Deliver, kill, and print what became of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--deliveries", type=int, default=1000)
    parser.add_argument("--kills", type=int, default=8)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng = random.Random(options.seed)  # noqa: S311 - kills
    forks.ready()
    receiver = Receiver(random.Random(options.seed))  # noqa: S311
    hostile = socket.create_server(("127.0.0.1", 0), backlog=1000)
    good = f"http://127.0.0.1:{receiver.server_port}"
    bad = f"http://127.0.0.2:{hostile.getsockname()[1]}"
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        hosts = {"webhook_hosts": "127.0.0.1,127.0.0.2", "webhook_secret": SECRET}
        settings = {**hosts, "workers": 2, "max_queued_jobs": 10**6}
        servers = [ServerProcess(folder / "data", folder / "0.log", **settings)]
        jobs: list[str] = []
        wanted = options.deliveries // 2
        kill_at = sorted(rng.sample(range(5, wanted), options.kills))
        try:
            for number in range(wanted):
                if kill_at and number >= kill_at[0]:
                    kill_at.pop(0)
                    servers[-1].kill()
                    servers.append(ServerProcess(folder / "data", folder / f"{len(servers)}.log", **settings))
                if number % 10 == 0:
                    commit(servers, {"failedUri": f"{bad}/x"})
                job = commit(servers, {"inProgressUri": f"{good}/began", "failedUri": f"{good}/ended"})
                jobs += [] if job is None else [job]
                sys.stderr.write(f"\r{number + 1} of {wanted} commits")
            missing = {(job, kind) for job in jobs for kind in ("job.running", "job.successful")}
            end = time.monotonic() + PATIENCE_S
            while missing and time.monotonic() < end:
                time.sleep(0.5)
                missing -= set(receiver.ids)
        finally:
            for server in servers:
                server.close()
    ids = receiver.ids
    twice = sum(len(each) > 1 for each in ids.values())
    same = all(len(set(each)) == 1 for each in ids.values())
    rows = (
        ("deliveries asked for", f"{2 * len(jobs)}, beside a subscriber that never answers"),
        ("servers killed", f"{len(servers) - 1}"),
        ("lost", f"{len(missing)}"),
        ("came more than once", f"{twice}, {'all' if same else 'NOT all'} under the id of the first"),
        ("time", f"{time.monotonic() - began:.0f} s"),
    )
    for name, value in rows:
        say(f"{name:22}{value}")


if __name__ == "__main__":
    main()
