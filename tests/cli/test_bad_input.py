"""Bad input: one line that names the file, exit code 1, nothing half-written, an older result untouched.

Each refusal in detail: tests/drives, tests/osm.
"""

import re
import resource
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.cli.main import main
from tests.app.processes import Command
from tests.cli.conftest import contents


def test_points_that_are_not_numbers_in_the_middle_of_the_run_leave_an_older_result(
    interloc: Callable, short_drive: Path, osm: Path, detected: Path, tmp_path: Path
) -> None:
    """Only some scans are looked into before the work; faults of the others show when they are read."""
    older = Path(shutil.copytree(detected, tmp_path / "older" / "out"))
    points = np.fromfile(short_drive / "velodyne/000005.bin", np.float32).reshape(-1, 4)
    labels = np.fromfile(short_drive / "labels/000005.label", np.uint32)
    points[np.flatnonzero(labels == 40)[7], 2] = np.nan
    points.tofile(short_drive / "velodyne/000005.bin")
    outcome = interloc("run", short_drive, "-o", older, "--osm", osm, "--set", "keyframes.distance_m=0.1")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.complaint.startswith("interloc: velodyne/000005.bin: point ")
    assert "is not finite" in outcome.complaint
    assert contents(older) == contents(detected)
    assert [path.name for path in older.parent.iterdir()] == ["out"]
    assert interloc("info", short_drive, "--thorough").code == 1


def run_with_small_files() -> None:
    """The command line, of which no file gets larger than 10 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
    main()


@pytest.mark.skipif(sys.platform == "win32", reason="limits of Unix")
def test_a_disk_that_is_full_leaves_nothing_of_a_run(environment: dict[str, str], drive: Path, tmp_path: Path) -> None:
    (tmp_path / "place").mkdir()
    out = tmp_path / "place/new/out"
    arguments = ["run", drive, "-o", out]
    process = Command(arguments, environment, tmp_path / "said", tmp_path / "err", program=run_with_small_files)
    code, said, err = process.ended()
    assert (code, said) == (1, "")
    assert err == f"interloc: {out}/detections.geojson could not be written: file too large.\n"
    assert not list((tmp_path / "place").iterdir())  # not even the folder above


def test_a_run_without_a_map_says_how_to_get_one(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    outcome = interloc("run", drive, "-o", tmp_path / "out")
    assert outcome.code == 0
    west, south, east, north = map(float, re.findall(r"--bbox (\S+) of `osmium extract`", outcome.out)[0].split(","))
    assert (west < 8.4 < east, south < 49.0 < north) == (True, True)


def test_a_clipped_map_works_with_a_note(interloc: Callable, detected: Path, osm: Path, tmp_path: Path) -> None:
    clipped = tmp_path / "clipped.osm"
    clipped.write_text("\n".join(line for line in osm.read_text().splitlines() if '<node id="5"' not in line))
    outcome = interloc("evaluate", shutil.copytree(detected, tmp_path / "out"), "--osm", clipped)
    assert outcome.code == 0
    assert "clipped.osm: 1 highways refer to nodes outside the extract and were cut" in outcome.err
    assert "1 of 1" in outcome.out
