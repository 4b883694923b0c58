"""A disk that is really full while a result is written."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from interloc.cli.main import run

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits and mounts of Unix")

LIMITED = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}));"
MAIN = "from interloc.cli.main import main; main()"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def only_line(process: subprocess.CompletedProcess[str]) -> str:
    assert process.returncode == 1
    (line,) = process.stderr.splitlines()
    return line


@pytest.fixture
def limited(environment: dict[str, str]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run a command that may write no file larger than some bytes."""

    def call(limit_bytes: int, *arguments: object) -> subprocess.CompletedProcess[str]:
        code = LIMITED.format(limit_bytes) + MAIN
        return subprocess.run(
            [sys.executable, "-c", code, *map(str, arguments)],
            capture_output=True,
            text=True,
            env=environment,
            check=False,
        )

    return call


def test_detect_with_files_limited(limited: Callable, drive: Path, tmp_path: Path) -> None:
    process = limited(10_000, "detect", drive, "-o", tmp_path / "new" / "out")
    assert only_line(process) == (
        f"interloc: {tmp_path}/new/out/detections.geojson could not be written: file too large."
    )
    assert not list(tmp_path.iterdir())  # not even the folder above


def test_evaluate_with_files_limited(limited: Callable, drive: Path, osm: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(["run", str(drive), "-o", str(out), "--osm", str(osm), "--quiet"]) == 0
    before = contents(out)
    limit = max(path.stat().st_size for path in out.glob("*.*json")) + 1000
    assert limit < (out / "report.html").stat().st_size
    process = limited(limit, "evaluate", out, "--osm", osm, "--policy", "all")
    assert "could not be written: file too large." in only_line(process)
    assert contents(out) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 kB."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a small disk")
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no small disk can be mounted: {mounted.stderr.strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", disk], check=True)


def test_a_full_disk(interloc: Callable, drive: Path, small_disk: Path) -> None:
    out = small_disk / "out"
    assert interloc("detect", drive, "-o", out, "--set", "keyframes.distance_m=8").code == 0
    before = contents(small_disk)
    (small_disk / "ballast").write_bytes(bytes(64 * 1024 - sum(map(len, before.values())) - 24 * 1024))
    outcome = interloc("detect", drive, "-o", out)
    assert "could not be written: no space left on device." in outcome.complaint
    assert str(out) in outcome.complaint
    assert contents(out) == {name.removeprefix("out/"): content for name, content in before.items()}
    assert sorted(path.name for path in small_disk.iterdir()) == ["ballast", "out"]


def test_a_disk_that_is_the_result_folder(interloc: Callable, drive: Path, small_disk: Path) -> None:
    """As the volume of a container is: it cannot be renamed, so it is filled in place."""
    assert interloc("detect", drive, "-o", small_disk, "--set", "keyframes.distance_m=8").code == 0
    before = contents(small_disk)
    outcome = interloc("detect", drive, "-o", small_disk, "--set", "keyframes.distance_m=0.5")
    assert "could not be written: no space left on device." in outcome.complaint
    assert contents(small_disk) == before
