"""`interloc serve` and `interloc admin token` as processes: what they say, how they start and end."""

import json
import os
import re
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

import httpx
import pytest

from tests.app.processes import NO_TLS, Command, wait_until
from tests.cli.conftest import ENVIRONMENT

pytestmark = pytest.mark.usefixtures("untouched_logging")
Interloc = Callable[..., Any]
EVERYWHERE = "0.0.0.0"  # noqa: S104 - with tokens


@contextmanager
def serving(folder: Path, *options: str, **variables: str) -> Iterator[tuple[Command, str]]:
    """Run the command until the block ends; yields the process and its address."""
    clean = {name: value for name, value in ENVIRONMENT.items() if not name.startswith("INTERLOC_")}
    arguments = ["serve", "--port", "0", "--workers", "1", *options]
    out = folder / f"out-{uuid4().hex}"
    out.touch()
    process = Command(arguments, {**clean, "INTERLOC_MIN_FREE_BYTES": "0", **variables}, out, folder / "log", folder)
    try:
        wait_until(lambda: "\n" in out.read_text() or process.exitcode is not None, "the first line")
        found = re.match(r"InterLoc \S+ at (http://\S+/) \(data in (.+)\); Ctrl-C stops it\n", out.read_text())
        assert found, f"{out.read_text()!r} {(folder / 'log').read_text()}"
        yield process, found[1]
    finally:
        process.kill()
        process.join()


@pytest.mark.parametrize("stop", [signal.SIGTERM, signal.SIGINT])
def test_a_server_starts_and_stops(stop: signal.Signals, tmp_path: Path) -> None:
    variables = {"INTERLOC_STATIC_DIR": str(tmp_path), "INTERLOC_SERVICE_HOST": "10.0.0.1"}
    variables |= {"INTERLOC_WORKRES": "4", "INTERLOC_LIVE_IDLE_S": "60"}
    with serving(tmp_path, **variables) as (process, address):
        assert httpx.get(f"{address}healthz", verify=NO_TLS).json() == {"status": "ok"}
        assert (tmp_path / "interloc-data/interloc.sqlite3").is_file()
        process.send(stop)
        code, out, _ = process.ended()
        assert code == 0
        _, second, third, fourth = out.splitlines()
        assert second.startswith("The page is not installed, only the API: ")
        assert third == "INTERLOC_LIVE_IDLE_S is not a setting and has no effect; docs/service.md lists all."
        assert fourth == "INTERLOC_WORKRES is not a setting and has no effect; INTERLOC_WORKERS is one."
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert lines[-1]["message"] == "stopped"
    assert not [line for line in lines if line["level"] in {"error", "warning"}]


def test_a_stop_does_not_wait_for_an_upload_that_stalls(tmp_path: Path) -> None:
    with serving(tmp_path) as (process, address), httpx.Client(base_url=address, verify=NO_TLS) as client:
        drive = client.post("api/v1/drives", json={"name": "a"}).json()["id"]
        with socket.create_connection((client.base_url.host, client.base_url.port or 80)) as link:
            path = f"/api/v1/drives/{drive}/files/poses.txt"
            link.sendall(f"PUT {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nabc".encode())
            process.terminate()
            assert process.ended()[0] == 0
    assert not list((tmp_path / "interloc-data/incoming").glob("*"))


def test_options_and_environment(tmp_path: Path) -> None:
    options = ("--data-dir", str(tmp_path / "here"), "--log-format", "text", "--root-path", "/interloc/")
    with serving(tmp_path, *options, INTERLOC_HOST="127.0.0.2") as (process, address):
        assert re.fullmatch(r"http://127\.0\.0\.2:\d+/interloc/", address)
        assert httpx.get(f"{address}api/v1/drives", verify=NO_TLS).status_code == 200
        assert httpx.get(f"{address.removesuffix('interloc/')}api/v1/drives", verify=NO_TLS).status_code == 200
        process.terminate()
        process.join(30)
    assert (tmp_path / "here/interloc.sqlite3").is_file()
    line = r"^\d\d:\d\d:\d\d info    GET /api/v1/drives 200 .* status=200"
    assert re.search(line, (tmp_path / "log").read_text(), re.MULTILINE)


def test_other_machines_need_a_token(tmp_path: Path, interloc: Interloc) -> None:
    refused = interloc("serve", "--host", EVERYWHERE, "--data-dir", tmp_path / "interloc-data")
    assert refused.code == 2
    assert "lets other machines in, and there is no token" in refused.complaint
    token = interloc("admin", "token", "add", "alice", "--data-dir", tmp_path / "interloc-data").out.strip()
    with serving(tmp_path, "--host", EVERYWHERE) as (_, address):
        drives = f"{address.replace(EVERYWHERE, '127.0.0.1')}api/v1/drives"
        assert httpx.get(drives, verify=NO_TLS).status_code == 401
        assert httpx.get(drives, headers={"Authorization": f"Bearer {token}"}, verify=NO_TLS).status_code == 200
        assert httpx.get(f"{drives}?token={token}", verify=NO_TLS).status_code == 401
    log = (tmp_path / "log").read_text()
    assert token not in log
    assert '"client": "alice"' in log


def test_what_keeps_a_server_from_starting(interloc: Interloc, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        outcome = interloc("serve", "--port", port, "--data-dir", tmp_path)
        assert outcome.complaint == (
            f"interloc: cannot listen on 127.0.0.1 port {port}: something listens there already; "
            "--port chooses another port"
        )
    (tmp_path / "file").write_bytes(b"")
    outcome = interloc("serve", "--data-dir", tmp_path / "file")
    assert "cannot be written: file exists" in outcome.complaint
    assert (outcome.code, "INTERLOC_DATA_DIR" in outcome.err) == (1, True)
    outcome = interloc("serve", "--host", "192.0.2.77", "--allow-anonymous", "--data-dir", tmp_path)
    assert "this machine has no such address" in outcome.complaint
    outcome = interloc("serve", "--host", "no such name", "--allow-anonymous", "--data-dir", tmp_path)
    assert (outcome.code, "no such address" in outcome.complaint) == (2, True)
    assert interloc("serve", "--port", "70000").code == 2


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("INTERLOC_WORKERS", "many", "INTERLOC_WORKERS or --workers"),
        ("INTERLOC_PORT", "-1", "INTERLOC_PORT or --port"),
        ("INTERLOC_TOKEN", "secret", "16 or more printable"),
        ("INTERLOC_ROOT_PATH", "interloc", "a path begins with /"),
        ("INTERLOC_DATABASE_URL", "mysql://somewhere", "SQLite and PostgreSQL"),
        ("INTERLOC_DATABASE_URL", "postgresql+psycopg://u:geheim@127.0.0.1:1/x", "cannot be reached"),
        ("INTERLOC_DATABASE_URL", "nonsense", "SQLite and PostgreSQL"),
        ("INTERLOC_DATABASE_URL", "sqlite://", "SQLite and PostgreSQL"),
        ("INTERLOC_DATABASE_URL", "postgresql://u:geheim@h:abc/x", "SQLite and PostgreSQL"),
        ("INTERLOC_ALLOWED_HOSTS", "lidar.example:8443", "without https:// or port"),
        ("INTERLOC_SOURCES", "s3://", "is not an address in object storage"),
    ],
)
def test_a_bad_setting_is_named(
    interloc: Interloc, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, value: str, says: str
) -> None:
    monkeypatch.setenv(name, value)
    outcome = interloc("serve", "--data-dir", tmp_path)
    assert says in outcome.complaint
    assert "secret" not in outcome.err
    assert "geheim" not in outcome.err


def test_tokens_are_shown_once(interloc: Interloc, tmp_path: Path) -> None:
    data = ("--data-dir", tmp_path)
    assert "holds no drives of a service" in interloc("admin", "token", "list", *data).complaint
    assert "holds no drives of a service" in interloc("admin", "token", "revoke", "alice", *data).complaint
    assert not list(tmp_path.iterdir())  # a mistyped folder does not become a service
    token = interloc("admin", "token", "add", "alice", *data).out.strip()
    assert token.startswith("interloc_")
    listed = interloc("admin", "token", "list", *data).out
    assert listed.startswith("alice ")
    assert token not in listed
    assert interloc("admin", "token", "add", "alice", *data).code == 2
    assert "no token is left" in interloc("admin", "token", "revoke", "alice", *data).err
    assert interloc("admin", "token", "revoke", "alice", *data).code == 2
    assert interloc("admin", "token", "list", *data).err == "no tokens\n"


def test_tokens_tell_what_they_allow(interloc: Interloc, tmp_path: Path) -> None:
    data = ("--data-dir", tmp_path)
    limits = ("--expires", "30d", "--max-bytes", "1.5GB", "--max-jobs", "5")
    assert interloc("admin", "token", "add", "alice", "--read-only", *limits, *data).code == 0
    few = ("--max-bytes", "1MB", "--max-jobs", "1")
    assert interloc("admin", "token", "add", "bob", "--expires", "2999-12-31T02:00+02:00", *few, *data).code == 0
    alice, bob = interloc("admin", "token", "list", *data).out.splitlines()
    assert re.fullmatch(
        r"alice +read  since .* UTC, no use noted yet, expires 2\d{3}-\d\d-\d\d .*, 1\.5 GB, 5 jobs", alice
    )
    assert re.fullmatch(r"bob +write since .* UTC, no use noted yet, expires 2999-12-31 00:00, 1 MB, 1 job", bob)


@pytest.mark.parametrize(
    ("option", "says"),
    [
        (("--expires", "soon"), "expected 30d, 12h or a date"),
        (("--expires", "2001-01-01"), "would have expired already"),
        (("--max-bytes", "much"), "expected a number with kB, MB, GB or TB"),
        (("--max-jobs", "0"), "x>=1"),
    ],
)
def test_limits_of_a_token_that_make_no_sense(
    interloc: Interloc, tmp_path: Path, option: tuple[str, str], says: str
) -> None:
    outcome = interloc("admin", "token", "add", "alice", *option, "--data-dir", tmp_path)
    assert outcome.code == 2
    assert says in outcome.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_data_folder_that_cannot_be_written(interloc: Interloc, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    assert "permission denied" in interloc("serve", "--data-dir", tmp_path / "data").complaint
