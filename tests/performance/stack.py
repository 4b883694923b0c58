"""The stack of deploy/ on this machine: `python -m tests.performance.stack [--from COMMIT]`.

The service as deploy/compose.yaml sets it up, with PostgreSQL, a Dask scheduler, two workers and nginx by
deploy/nginx.conf, as processes. Through nginx go a drive by `interloc push` and one by the page, a live session, and a
webhook; a worker is killed, the database restarted, a backup made and restored. `--from` upgrades: a version of before
makes a drive and a result, which this one must show. Prometheus' promtool, systemd-analyze and nginx look at the
files of deploy/, where they are installed.
"""

import argparse
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import psycopg
import yaml

from app.settings import Settings
from tests.app.http.test_behind_nginx import answers, replaced, running_nginx
from tests.app.jobs.test_webhooks import SECRET, receiving
from tests.app.postgres import _as_user, _program, new_database
from tests.app.processes import API, FINAL, ServerProcess, free_port, started, wait_until
from tests.app.street import write_street
from tests.page.browsers import PATIENCE_MS, chromium
from tests.performance.fleet import Cluster

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
SCANS = 60
PATH = "/interloc"


def say(step: str, began: float, found: str = "") -> None:
    print(f"{time.monotonic() - began:7.1f} s  {step:50} {found}", flush=True)  # noqa: T201 - what it is for


def run(*command: str | Path, **environment: str) -> str:
    """Run a command that must succeed; returns what it prints."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | environment)
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def interloc(*arguments: str | Path, **environment: str) -> str:
    return run(sys.executable, "-m", "interloc", *arguments, **environment)


def check_files(folder: Path, metrics: str) -> Iterator[tuple[str, str]]:
    """Let the programs that read the files of deploy/ look at them."""
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    environment = compose["services"]["interloc"]["environment"]
    fields = {f"INTERLOC_{name.upper()}" for name in Settings.model_fields}
    assert set(environment) <= fields, set(environment) - fields
    yield "settings of compose.yaml", f"{len(environment)} known"
    asked = {
        name
        for file in ("alerts.yaml", "grafana.json")
        for name in re.findall(r"\b(?:interloc|process)_\w+", (DEPLOY / file).read_text())
    }
    missing = {name for name in asked if f"\n{name}" not in metrics}
    missing -= {"interloc_webhooks_total"}  # where there was one
    assert not missing, f"/metrics has none of {missing}"
    yield "metrics of alerts and board", f"{len(asked)} there"
    if promtool := shutil.which("promtool"):
        run(promtool, "check", "rules", DEPLOY / "alerts.yaml")
        yield "promtool check rules", "good"
    if analyze := shutil.which("systemd-analyze"):
        unit = folder / "interloc.service"
        text = (DEPLOY / "interloc.service").read_text()
        unit.write_text(text.replace("/opt/interloc/bin/interloc", str(Path(sys.executable).with_name("interloc"))))
        run(analyze, "verify", "--man=no", unit)
        yield "systemd-analyze verify", "good"


@contextmanager
def nginx(folder: Path, service: str, port: int) -> Iterator[str]:
    """Run nginx by deploy/nginx.conf; yields the address under which it shows the service."""
    folder.mkdir()
    changes = (("listen 80;", f"listen 127.0.0.1:{port};"), ("http://interloc:8000/", f"{service}/"))
    with running_nginx(folder, port, replaced((DEPLOY / "nginx.conf").read_text(), *changes)):
        yield f"http://127.0.0.1:{port}{PATH}"


class Stack:
    """The service behind nginx, as seen by a client with a token."""

    def __init__(self, address: str, token: str) -> None:
        self.address = address
        self.token = token
        headers = {"Authorization": f"Bearer {token}"}
        self.client = httpx.Client(base_url=f"{address}{API}", headers=headers, timeout=300)

    def ask(self, method: str, path: str, **options: Any) -> Any:
        return self.client.request(method, path, **options).raise_for_status().json()

    def drives(self) -> list[dict[str, Any]]:
        return list(self.ask("GET", "/drives")["drives"])

    def finished(self, job: str) -> dict[str, Any]:
        """Wait for the end of a job, which must be a good one."""

        def ended() -> dict[str, Any] | None:
            try:
                told = self.ask("GET", f"/jobs/{job}")
            except httpx.HTTPError:  # while the database is restarted
                return None
            return dict(told) if told["state"] in FINAL else None

        told: dict[str, Any] = wait_until(ended, f"job {job} to end", 300)
        assert told["state"] == "successful", told
        return told

    def submit(self, drive: str, **more: Any) -> str:
        return str(self.ask("POST", "/jobs", json={"drive_id": drive, "osm": {"file": "map.osm"}, **more})["id"])


def by_page(stack: Stack, street: Path) -> None:
    """Log in, pick a folder, and have it uploaded."""
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(f"{stack.address}/#panel=upload")
        page.get_by_label("API token").fill(stack.token)
        page.keyboard.press("Enter")
        page.set_input_files("input[name=folder]", street)
        page.get_by_role("button", name="Upload only", exact=True).click()
        wait_until(lambda: any(each["name"] == street.name for each in stack.drives()), "the drive of the page")
        wait_until(lambda: {each["name"]: each for each in stack.drives()}[street.name]["state"] == "ready", "its end")


def restart_database(url: str) -> None:
    """Restart the server of PostgreSQL, as an upgrade of it would."""
    with psycopg.connect(url.replace("+psycopg", "")) as connection:
        (folder,) = connection.execute("SHOW data_directory").fetchone() or ("",)
        (options,) = (Path(folder) / "postmaster.opts").read_text().split("\n", 1)[0].split(" ", 1)[1:] or ("",)
    control = _program("pg_ctl")
    assert control is not None
    log = str(Path(folder).with_name("log2"))
    subprocess.run(
        [*_as_user(), control, "restart", "-m", "fast", "-w", "-D", folder, "-l", log, "-o", options],
        check=True, capture_output=True, cwd="/",
    )  # fmt: skip


def upgrade(commit: str, folder: Path, street: Path) -> str:
    """Make a drive and a result by a version of before, and read them by this one."""
    old = folder / "old"
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(old, filter="data")
    data, port = folder / "data-of-before", free_port()
    environment = {"PYTHONPATH": str(old), "INTERLOC_DATA_DIR": str(data), "INTERLOC_MIN_FREE_BYTES": "0"}
    command = [sys.executable, "-m", "interloc", "serve", "--port", str(port), "--log-level", "error"]
    process = subprocess.Popen(command, cwd=old, env=os.environ | environment)
    try:
        wait_until(lambda: answers(port), "the version of before")
        address = f"http://127.0.0.1:{port}"
        push = ("push", street, "--osm", street / "map.osm", "--run", "--json")
        told = interloc(*push, "--server", address, **environment)
        drive = json.loads(told)["drive_id"]
        (job,) = [each["id"] for each in httpx.get(f"{address}{API}/jobs?drive={drive}").json()["jobs"]]
        # Its address in version 0.2.0.
        before = httpx.get(f"{address}{API}/jobs/{job}/intersections").raise_for_status().content
    finally:
        process.terminate()
        process.wait(60)
    with started(data, folder / "upgraded.log") as server:
        after = server.client.get(f"{API}/jobs/{job}/layers/intersections").raise_for_status().content
        assert json.loads(after)["features"] == json.loads(before)["features"]
    return interloc("admin", "check", "--data-dir", data).strip()


def main() -> None:
    """Run all of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--from", dest="before", metavar="COMMIT", help="version to upgrade from")
    arguments = parser.parse_args()
    with ExitStack() as ends:
        folder = Path(ends.enter_context(tempfile.TemporaryDirectory(prefix="stack-", ignore_cleanup_errors=True)))
        began = time.monotonic()
        url = ends.enter_context(new_database())
        cluster = Cluster(folder / "dask")
        ends.callback(cluster.close)
        say("PostgreSQL, Dask scheduler and two workers run", began)
        port, data = free_port(), folder / "data"
        known: dict[str, Any] = {"database_url": url, "dask": cluster.address, "trusted_proxies": "*"}
        known |= {"public_url": f"http://127.0.0.1:{port}{PATH}"}
        known |= {"webhook_hosts": "127.0.0.1", "webhook_secret": SECRET}
        environment = {"INTERLOC_DATABASE_URL": url, "INTERLOC_DATA_DIR": str(data)}
        token = interloc("admin", "token", "add", "stack", **environment).split()[-1]
        server = ServerProcess(data, folder / "log", host="0.0.0.0", **known)  # noqa: S104 - as in the image
        ends.callback(server.close)
        say("the service runs", began)
        service = f"http://127.0.0.1:{server.address.rpartition(':')[2]}"
        stack = Stack(ends.enter_context(nginx(folder / "nginx", service, port)), token)
        say("nginx runs", began)

        street = write_street(folder / "street", SCANS)
        client = {"INTERLOC_TOKEN": token, "XDG_CACHE_HOME": str(folder)}
        push = ("push", street, "--osm", street / "map.osm", "--run")
        interloc(*push, "-o", folder / "out", "--server", stack.address, **client)
        assert (folder / "out" / "report.html").is_file()
        (drive,) = [each["id"] for each in stack.drives()]
        say("interloc push --run through nginx, result fetched", began)
        by_page(stack, write_street(folder / "by page", SCANS // 2))
        say("the page through nginx: logged in, folder uploaded", began)
        interloc("live", street, "--keep", "--speed", "20", "--server", stack.address, **client)
        wait_until(lambda: len(stack.drives()) == 3, "the drive of the live session")
        say("a live session through nginx, kept as a drive", began)
        with receiving() as receiver:
            stack.finished(stack.submit(drive, subscriber={"successUri": f"{receiver.uri}/done"}))
            wait_until(lambda: receiver.told, "the webhook")
        say("a webhook came", began)
        job = stack.submit(drive)
        wait_until(lambda: stack.ask("GET", f"/jobs/{job}")["state"] != "accepted", "the job to begin")
        cluster.workers()[-1].kill()
        stack.finished(job)
        say("a Dask worker killed, its job goes on", began)
        job = stack.submit(drive)
        restart_database(url)
        stack.finished(job)
        say("PostgreSQL restarted, the job goes on", began)
        metrics = httpx.get(f"{stack.address}/metrics", headers=stack.client.headers).raise_for_status().text
        for step, found in check_files(folder, metrics):
            say(step, began, found)
        interloc("admin", "backup", folder / "backup", **environment)
        restored = folder / "restored"
        interloc("admin", "restore", folder / "backup", "--data-dir", restored)
        checked = interloc("admin", "check", "--data-dir", restored).strip()
        say("backed up, restored into SQLite, checked", began, checked)
        assert server.stop() == 0
        say("stopped in good order", began)
        if arguments.before:
            say(f"upgraded from {arguments.before}", began, upgrade(arguments.before, folder, street))


if __name__ == "__main__":
    main()
