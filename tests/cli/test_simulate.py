"""`interloc simulate`."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.cli import options
from interloc.drives.open import open_drive
from interloc.lab.config import SENSORS

FEW = ("--max-scans", 4, "--columns", 90)


def test_the_small_town_is_a_drive_with_its_map(tmp_path: Path, interloc: Callable) -> None:
    drive = tmp_path / "drive"
    outcome = interloc("simulate", "town", "--part", "plain", "-o", drive, *FEW)
    assert outcome.code == 0
    assert json.loads((drive / "simulation.json").read_text())["town"] == "plain"
    assert not outcome.err  # no progress where nobody watches
    assert "4 scans" in outcome.out
    assert (drive / "map.osm").is_file()
    (line,) = (line for line in outcome.out.splitlines() if line.startswith("go on"))
    assert shlex.split(line)[2:] == [
        *("interloc", "run", str(drive), "-o", f"{drive}_result", "--osm", str(drive / "map.osm"))
    ]
    opened = open_drive(drive)
    assert opened.georeference is not None
    assert np.linalg.norm(opened.T_world_lidar[1, :3, 3]) > 2.0  # keyframes


def test_options_choose_the_part_the_sensor_and_the_scans(tmp_path: Path, interloc: Callable) -> None:
    assert list(SENSORS) == list(options.SENSORS)
    drive = tmp_path / "drive"
    chosen = ("--part", "quarter", "--every-scan", "--ground-only", "--sensor", "vlp-16")
    assert interloc("simulate", "town", *chosen, "-o", drive, "--max-scans", 3).code == 0
    assert json.loads((drive / "simulation.json").read_text())["town"] == "quarter"
    step = np.linalg.norm(np.diff(open_drive(drive).T_world_lidar[:, :3, 3], axis=0), axis=1)
    assert step == pytest.approx(0.8, abs=0.02)
    labels = np.fromfile(drive / "labels/000000.label", dtype=np.uint32)
    assert set(labels.tolist()) <= {40, 44, 48, 49, 60}
    x, y, z, _ = np.fromfile(drive / "velodyne/000000.bin", np.float32).reshape(-1, 4).T
    elevations = np.unique(np.degrees(np.arctan2(z, np.hypot(x, y))).round())
    assert set(elevations.tolist()) <= set(range(-15, 16, 2))
    assert elevations.min() == -15


def test_the_twin_of_an_unknown_sequence(tmp_path: Path, interloc: Callable) -> None:
    outcome = interloc("simulate", "twin", "03", "--kitti", tmp_path, "-o", tmp_path / "drive")
    assert outcome.code == 1
    assert "sequence 03 has no oxts/03.txt.gz" in outcome.complaint
