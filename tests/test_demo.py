"""`make demo`, without the installation."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from app.demo.work import prepare
from app.demo.work import run as simulate
from app.settings import Settings
from app.work.requests import JobRequest
from app.work.task import UNPACKED
from interloc.cli.main import run
from tests.app.processes import NO_TLS, free_port
from tests.tasks import task_for

ROOT = Path(__file__).resolve().parents[1]
DRIVE = "demo/drive/simulation.json"
RECIPE = (ROOT / "Makefile").read_text().split(f"\n{DRIVE}:")[1].split("\nendif")[0]
ON_THE_COMMAND_LINE, IN_THE_SERVICE = RECIPE.split("\nifneq ($(SERVE),)\n")
BEGINNING = ["--max-scans", "60"]
NODES = 1  # there


def work(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run the commands of the first part, on the beginning of the drive, in a folder."""
    monkeypatch.chdir(folder)
    for recipe in ON_THE_COMMAND_LINE.splitlines():
        line = recipe.replace("\t@test -f demo/drive/map.osm || ", "\t")  # it is not there yet
        if line.startswith("\t$(BIN)/interloc "):
            words = shlex.split(line)[1:]
            assert run([*words, *(BEGINNING if words[0] == "simulate" else [])]) == 0


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("demo")
    with pytest.MonkeyPatch.context() as monkeypatch:
        work(folder, monkeypatch)
    return folder


def test_the_demo_makes_what_it_says(demo: Path) -> None:
    promised = [
        name
        for line in ON_THE_COMMAND_LINE.splitlines()
        if line.startswith("\t@echo")
        for name in re.findall(r"demo/\S+\.\w+", line)
    ]
    assert len(promised) == 2
    for name in promised:
        assert (demo / name).is_file()
    report = json.loads((demo / "demo/drive_result/report.json").read_text())
    assert report["nodes_found"] == report["nodes_in_zone"] == NODES


def test_the_service_makes_the_same_drive(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Settings, "max_demo_scans", 3)
    task = task_for("demo", JobRequest(), tmp_path)
    (part,) = prepare(task).parts
    simulate(task, part, lambda _: None)
    for name in ("map.osm", "velodyne/000002.bin", "labels/000002.label"):
        assert (task.scratch / UNPACKED / name).read_bytes() == (demo / "demo/drive" / name).read_bytes()


def test_the_demo_ends_in_the_service(demo: Path, tmp_path: Path) -> None:
    """Its last command, as make gives it to the shell: serve, send the drive, name the result, end by Ctrl-C."""
    port = free_port()
    makefile = tmp_path / "Makefile"
    settings = f"BIN := {Path(sys.executable).parent}\nPORT := {port}\n"
    makefile.write_text(f"{settings}.PHONY: demo\ndemo:\n{IN_THE_SERVICE}\n")
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("INTERLOC_", "MAKE"))}
    process = subprocess.Popen(
        ["make", "-f", str(makefile), "demo"],
        cwd=demo,
        env=clean | {"INTERLOC_MIN_FREE_BYTES": "0"},
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        lines = iter(process.stdout.readline, "")
        address = next(line for line in lines if line.startswith("page ")).split()[1]
        base, job = address.split("/#panel=result&job=")
        assert base == f"http://127.0.0.1:{port}"
        told = httpx.get(f"{base}/api/v1/jobs/{job}", verify=NO_TLS).json()
        assert told["state"] == "successful"
        assert told["summary"]["report"]["nodes_found"] == NODES
        os.killpg(process.pid, signal.SIGINT)
        process.wait(60)
        with pytest.raises(httpx.ConnectError):
            httpx.get(base, verify=NO_TLS)
    finally:
        process.stdout.close()
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
