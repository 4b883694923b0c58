"""Commands and servers as processes of their own, to be killed; and the few requests that the tests of faults send."""

import errno
import io
import os
import re
import signal
import socket
import ssl
import sys
import tarfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import httpx
import psutil

from interloc.cli.main import main
from tests.forks import begin, context

API = "/api/v1"
FINAL = {"successful", "failed", "dismissed"}
PATIENCE_S = 120.0
NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)  # a client loads all certificates otherwise: 10 ms each time


def wait_until(
    condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S, *, every_s: float = 0.02
) -> Any:
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(every_s)
    raise AssertionError(f"waited {patience_s:.0f} s in vain for {what}")


def as_by_command(answer: httpx.Response) -> bytes:
    """Return a layer of a job as the command line writes it."""
    return without_job(answer.content)


def without_job(layer: bytes) -> bytes:
    """Return a layer without the id of the job that made it."""
    return re.sub(rb'"job":"\w+"', b'"job":null', layer)


def assert_as_by_command(client: httpx.Client, job: dict[str, Any], out: Path, *layers: str) -> None:
    """The layers of a job, these and those that all jobs have, are those that the command line wrote into a folder."""
    assert job["state"] == "successful", job
    for layer in ("detections", "intersections", "keyframes", "trajectory", *layers):
        assert as_by_command(client.get(job["links"][layer])) == (out / f"{layer}.geojson").read_bytes(), layer


def files_below(folder: Path) -> list[Path]:
    """All files below a folder that a server works in, but its lock: what goes meanwhile is passed over."""
    return [Path(root) / name for root, _, names in os.walk(folder) for name in names if name != "lock"]


def bytes_below(folder: Path) -> int:
    """Size of these files but for those of the database; what goes meanwhile counts as nothing."""
    size = 0
    for path in files_below(folder):
        with suppress(FileNotFoundError):
            size += 0 if "sqlite" in path.name else path.stat().st_size
    return size


class Command(context.Process):  # type: ignore[name-defined, misc]
    """A program, `interloc` or another, in a process of its own that writes into files."""

    def __init__(
        self,
        arguments: Sequence[object],
        environment: Mapping[str, str],
        out: Path,
        err: Path,
        cwd: Path | None = None,
        *,
        program: Callable[[], object] = main,
    ) -> None:
        super().__init__(target=_become, args=([*map(str, arguments)], dict(environment), out, err, cwd, program))
        self.out, self.err = out, err
        self.start()

    def ended(self, timeout: float = 60) -> tuple[int, str, str]:
        """Wait for the end; returns the exit code and what was written."""
        self.join(timeout)
        assert self.exitcode is not None, f"it has not ended within {timeout:.0f} s"
        return self.exitcode, self.out.read_text(), self.err.read_text()

    def send(self, number: signal.Signals) -> None:
        """Send a signal, unless the process has ended."""
        if self.exitcode is None:
            os.kill(self.pid, number)


def _become(
    words: list[str], environment: dict[str, str], out: Path, err: Path, cwd: Path | None, program: Callable[[], object]
) -> None:
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(cwd or ".")
    for path, stream in ((out, 1), (err, 2)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), stream)
    sys.argv = ["interloc", *words]
    if environment.get("PYTHONWARNINGS") == "error":
        warnings.simplefilter("error")
    if {"serve", "batch", "worker"} & set(words):
        begin()  # else the first of its workers would import everything again
    program()


class ServerProcess:
    """`interloc serve` as a process of its own; `port` 0 is any free one."""

    def __init__(self, data_dir: Path, log: Path, *, port: int = 0, **settings: Any) -> None:
        self.log = log
        variables = {f"INTERLOC_{name.upper()}": str(value) for name, value in settings.items()}
        clean = {name: value for name, value in os.environ.items() if not name.startswith("INTERLOC_")}
        base = {"INTERLOC_MIN_FREE_BYTES": "0", "INTERLOC_LEASE_S": "5", "INTERLOC_DATA_DIR": str(data_dir)}
        out = log.with_name(f"{log.name}.out")
        out.write_bytes(b"")
        self.process = Command(["serve", "--port", port], {**clean, **base, **variables}, out, log)
        wait_until(lambda: out.read_bytes().endswith(b"\n") or self.process.exitcode is not None, "the server to start")
        found = re.search(r"http://\S+?:\d+", out.read_text())
        assert found, f"the server did not start: {out.read_text()!r} {log.read_text()}"
        self.address = found.group()
        self.client = httpx.Client(base_url=self.address, timeout=60, verify=NO_TLS)

    def workers(self) -> list[psutil.Process]:
        """The processes that work for it."""
        return workers_of(self.process.pid)

    def kill(self) -> None:
        """kill -9: no farewell."""
        self.process.kill()
        self.process.join()

    def stop(self) -> int:
        """SIGTERM, and wait for the end."""
        self.process.terminate()
        return self.process.ended()[0]

    def close(self) -> None:
        """Whatever happened, leave nothing behind."""
        self.client.close()
        if self.process.is_alive():
            children = psutil.Process(self.process.pid).children(recursive=True)
            self.kill()
            for child in children:
                kill_if_there(child)


def workers_of(pid: int) -> list[psutil.Process]:
    """Processes that work for a server: a child of it forks them, or of this process where it runs here."""
    ours = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]
    found: list[psutil.Process] = []
    for child in psutil.Process(pid).children():
        with suppress(psutil.NoSuchProcess):
            found += child.children() if pid != os.getpid() or child.pid == ours else []
    return found


@contextmanager
def suspended(processes: list[psutil.Process]) -> Iterator[None]:
    """Let processes, of which there must be one, stand still."""
    assert processes
    try:
        for process in processes:
            process.suspend()
        yield
    finally:
        for process in processes:
            process.resume()


def kill_if_there(process: psutil.Process) -> None:
    try:
        process.kill()
    except psutil.NoSuchProcess:
        return


def started(data_dir: Path, log: Path, **settings: Any) -> closing[ServerProcess]:
    return closing(ServerProcess(data_dir, log, **settings))


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def archive_of(folder: Path) -> bytes:
    """A drive as a .tar."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w") as archive:
        archive.add(folder, arcname=folder.name)
    return buffer.getvalue()


def upload(client: httpx.Client, folder: Path, **drive: Any) -> str:
    """Send a drive as one archive and commit it; returns its id."""
    answer = client.post(f"{API}/drives", json={"name": folder.name, **drive})
    assert answer.status_code == 201, answer.text
    drive_id: str = answer.json()["id"]
    answer = client.post(f"{API}/drives/{drive_id}/archive", content=archive_of(folder), headers={"Prefer": "wait=120"})
    assert answer.status_code == 200, answer.text
    answer = client.post(f"{API}/drives/{drive_id}/commit", headers={"Prefer": "wait=120"})
    assert answer.status_code == 200, answer.text
    return drive_id


def every(client: httpx.Client, address: str, rows: str, **query: Any) -> list[dict[str, Any]]:
    """All rows of a list that comes in pages."""
    found: list[dict[str, Any]] = []
    while True:
        page = client.get(address, params=query).raise_for_status().json()
        found += page[rows]
        if page["next"] is None:
            return found
        query["after"] = page["next"]


def connected(client: httpx.Client) -> socket.socket:
    """A connection to a server, for requests that no client would send."""
    return socket.create_connection((client.base_url.host, client.base_url.port or 80), timeout=30)


def heard(link: socket.socket) -> bytes:
    """All that a server answers until it ends the connection, perhaps while more is being sent."""
    answer = b""
    with suppress(ConnectionResetError):
        while piece := link.recv(65536):
            answer += piece
    return answer


def raw_get(client: httpx.Client, path: str) -> tuple[int, bytes]:
    """Ask for a path as it is, dots and all; status and content."""
    with connected(client) as link:
        link.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        head, _, content = heard(link).partition(b"\r\n\r\n")
    return int(head.split()[1]), content


def submit(client: httpx.Client, drive_id: str, **job: Any) -> str:
    answer = client.post(f"{API}/jobs", json={"drive_id": drive_id, **job})
    assert answer.status_code == 202, answer.text
    job_id: str = answer.json()["id"]
    return job_id


def job_of(client: httpx.Client, job_id: str) -> dict[str, Any]:
    answer = client.get(f"{API}/jobs/{job_id}")
    assert answer.status_code == 200, answer.text
    job: dict[str, Any] = answer.json()
    return job


def ended(client: httpx.Client, job_id: str, patience_s: float = PATIENCE_S) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        job = job_of(client, job_id)
        return job if job["state"] in FINAL else None

    job: dict[str, Any] = wait_until(look, f"the end of job {job_id}", patience_s, every_s=0.1)
    return job


class Gate:
    """A scan of a ready drive that is a pipe: a job that comes to it stands there, without work, until it is opened."""

    def __init__(self, data_dir: Path, drive_id: str, frame: int) -> None:
        self._place = data_dir / f"drives/{drive_id}/reduced/ground/labels/{frame:06d}.ground"
        self._content = self._place.read_bytes()
        self._pipe = data_dir / f"gate-{drive_id}"
        self._place.unlink()
        os.mkfifo(self._pipe)
        os.link(self._pipe, self._place)

    def open(self) -> None:
        """Let through who stands there, and all who come later."""
        new = self._pipe.with_suffix(".new")
        new.write_bytes(self._content)
        new.replace(self._place)
        try:
            with os.fdopen(os.open(self._pipe, os.O_WRONLY | os.O_NONBLOCK), "wb") as pipe:
                os.set_blocking(pipe.fileno(), True)
                pipe.write(self._content)  # once: who stands there would read it twice
        except OSError as error:
            if error.errno not in {errno.ENXIO, errno.EPIPE}:  # nobody stands there any more
                raise
        self._pipe.unlink()


def half_way(client: httpx.Client, job_id: str) -> dict[str, Any]:
    """Wait until some, but not all, keyframes of a job are done."""

    def look() -> dict[str, Any] | None:
        job = job_of(client, job_id)
        assert job["state"] not in FINAL, f"the job ended before it could be disturbed: {job}"
        progress = job["progress"]
        return job if progress["total"] and 0 < progress["done"] < progress["total"] else None

    job: dict[str, Any] = wait_until(look, f"job {job_id} to be half-way", every_s=0.1)
    return job
