"""The image that `make image` builds, started stricter than docs/service.md says: only its volume can be written."""

import json
import os
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.app.processes import FINAL, wait_until
from tests.towns import town_drive

BUILDER = (
    shlex.split(os.environ.get("INTERLOC_CONTAINER", ""))
    or [program for name in ("docker", "podman") if (program := shutil.which(name))][:1]
)
MEMORY = "1g"
LOCKED = ["--read-only", "--tmpfs", "/tmp", "--network", "host", "--cap-drop", "all"]  # noqa: S108 - of the container


def container(*arguments: str, check: bool = True) -> str:
    """Run docker or podman; returns what it prints."""
    done = subprocess.run([*BUILDER, *arguments], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0 or not check, done.stderr
    return done.stdout.strip()


def _has_image() -> bool:
    return bool(BUILDER) and bool(container("images", "--quiet", "interloc", check=False))


pytestmark = pytest.mark.skipif(not _has_image(), reason="there is no image `interloc`: make image builds it")


class Service:
    """A container of the image that serves, on a volume of its own."""

    def __init__(self, name: str, port: int, token: str) -> None:
        self.name = name
        self.address = f"http://127.0.0.1:{port}"
        self.client = httpx.Client(base_url=self.address, headers={"Authorization": f"Bearer {token}"}, timeout=120)

    def is_ready(self) -> bool:
        try:
            return self.client.get("/readyz").status_code == 200
        except httpx.TransportError:
            return False

    def job(self, job: str) -> dict[str, Any]:
        return dict(self.client.get(f"/api/v1/jobs/{job}").raise_for_status().json())


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return town_drive(tmp_path_factory)


@pytest.fixture(scope="module")
def service() -> Iterator[Service]:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    name = f"interloc-test-{port}"
    volume = ["--volume", f"{name}:/data"]
    token = container("run", "--rm", *LOCKED, *volume, "interloc", "admin", "token", "add", "tests").split()[-1]
    settings = ["--env", f"INTERLOC_PORT={port}", "--env", "INTERLOC_WORKERS=1"]
    container("run", "--detach", "--name", name, "--memory", MEMORY, *LOCKED, *volume, *settings, "interloc")
    started = Service(name, port, token)
    try:
        wait_until(started.is_ready, "the container to be ready")
        yield started
    finally:
        started.client.close()
        container("rm", "--force", name, check=False)
        container("volume", "rm", "--force", name, check=False)


def test_it_is_healthy_and_has_all_it_needs_but_rights(service: Service) -> None:
    def inside(*command: str) -> str:
        return container("exec", service.name, *command)

    assert inside("id", "-u") == "1000"
    for folder in ("/opt/interloc", "/var/cache/interloc"):  # only the volume can be written
        assert "Read-only" in inside("sh", "-c", f"touch {folder}/x 2>&1 || true")
    walk = "import re, pkgutil as p, importlib as i, interloc, app; [i.import_module(m.name) for r in (interloc, app) "
    walk += (
        "for m in p.walk_packages(r.__path__, r.__name__ + '.') if not re.search('migrations|[.]ros($|[.])', m.name)]"
    )
    inside("python", "-c", walk)
    assert inside("interloc", "--version").startswith("InterLoc ")
    (image,) = json.loads(container("image", "inspect", "interloc"))
    check = image.get("Healthcheck") or image["Config"]["Healthcheck"]  # of podman, of docker
    assert inside(*check["Test"][1:]) == ""
    no_compiler = "from numba.core.dispatcher import _FunctionCompiler; _FunctionCompiler.compile = None\n"
    inside("python", "-c", no_compiler + "from app.work.kinds import compile_kernels; compile_kernels()")


def test_a_drive_goes_in_and_its_result_comes_out(service: Service, town: Path, tmp_path: Path) -> None:
    push = [sys.executable, "-m", "interloc", "push", str(town), "--osm", str(town / "map.osm"), "--run"]
    token = service.client.headers["Authorization"].split()[-1]
    done = subprocess.run(
        [*push, "--server", service.address, "-o", str(tmp_path / "out")],
        env=os.environ | {"INTERLOC_TOKEN": token},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "intersections.geojson").is_file()


def test_a_job_outlives_a_stop(service: Service) -> None:
    (drive, *_) = service.client.get("/api/v1/drives").raise_for_status().json()["drives"]
    job = service.client.post("/api/v1/jobs", json={"drive_id": drive["id"]}).raise_for_status().json()["id"]
    began = time.monotonic()
    container("stop", "--time", "30", service.name)
    assert time.monotonic() - began < 30
    container("start", service.name)
    wait_until(service.is_ready, "the container to be ready again")
    wait_until(lambda: service.job(job)["state"] in FINAL, "the job to end")
    assert service.job(job)["state"] == "successful"
