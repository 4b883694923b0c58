"""A disk that is really full while a result is written."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import contents
from tests.forks import Command

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits and mounts of Unix")


@pytest.fixture
def limited(environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Run a command that may write no file larger than some bytes; returns the only line it writes: what is wrong."""

    def call(limit_bytes: int, *arguments: object) -> str:
        streams = tmp_path_factory.mktemp("streams")
        process = Command(arguments, environment, streams / "out", streams / "err", max_file_bytes=limit_bytes)
        out, err = process.communicate(60)
        assert (process.returncode, out) == (1, "")
        (line,) = err.splitlines()
        return line

    return call


def test_detect_with_files_limited(limited: Callable, drive: Path, tmp_path: Path) -> None:
    complaint = limited(10_000, "run", drive, "-o", tmp_path / "new" / "out")
    assert complaint == f"interloc: {tmp_path}/new/out/detections.geojson could not be written: file too large."
    assert not list(tmp_path.iterdir())  # not even the folder above


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


def fill(disk: Path) -> dict[str, bytes]:
    """Leave 24 kB, which a result of the whole drive does not fit into; returns what is on the disk."""
    left = os.statvfs(disk)
    (disk / "ballast").write_bytes(bytes(left.f_bavail * left.f_frsize - 24 * 1024))
    return contents(disk)


def test_a_full_disk(interloc: Callable, drive: Path, short_drive: Path, small_disk: Path) -> None:
    out = small_disk / "out"
    assert interloc("run", short_drive, "-o", out).code == 0
    before = fill(small_disk)
    outcome = interloc("run", drive, "-o", out)
    assert "could not be written: no space left on device." in outcome.complaint
    assert str(out) in outcome.complaint
    assert contents(small_disk) == before
    assert sorted(path.name for path in small_disk.iterdir()) == ["ballast", "out"]


def test_a_disk_that_is_the_result_folder(interloc: Callable, drive: Path, short_drive: Path, small_disk: Path) -> None:
    """As the volume of a container is: it cannot be renamed, so it is filled in place."""
    assert interloc("run", short_drive, "-o", small_disk).code == 0
    before = fill(small_disk)
    outcome = interloc("run", drive, "-o", small_disk)
    assert "could not be written: no space left on device." in outcome.complaint
    assert contents(small_disk) == before
