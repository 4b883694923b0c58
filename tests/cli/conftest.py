"""A drive through one X junction with its own little map, and the command line to run on it."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.cli.main import run
from interloc.geometry import lonlat_from_enu
from tests.once import once
from tests.osm_files import osm_text
from tests.small_drives import calib_text, camera_poses, geo_csv, level_poses, pose_text, write_scan

LAT_DEG, LON_DEG = 49.0, 8.4
SPACING_M = 0.6  # between scans; every fourth one is a keyframe
SCANS = 210
CROSSING_M = (60.0, 0.0)
CROSSING_RAD = np.radians(70.0)
ENVIRONMENT = {**os.environ, "PYTHONWARNINGS": "error", "INTERLOC_DEBUG": ""}
"""Of a process that shows its own faults and no others."""


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """The one JSON object on stdout."""
        value = json.loads(self.out or self.err)  # which shows what went wrong
        assert isinstance(value, dict)
        return value

    @property
    def complaint(self) -> str:
        """The one line on stderr of a command that failed."""
        assert self.code != 0
        assert "Traceback" not in self.err
        (line,) = self.err.splitlines()
        return line


Interloc = Callable[..., Outcome]


@pytest.fixture
def interloc(capfd: pytest.CaptureFixture[str]) -> Interloc:
    """Run a command in this process."""

    def call(*arguments: object) -> Outcome:
        capfd.readouterr()
        code = run([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return Outcome(code, out, err)

    return call


def strict_json(path: Path) -> Any:
    """Read JSON as the standard has it: no NaN, no infinity."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def scan_at(x_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the plane within 35 m, and their labels: road, sidewalk beside it, terrain."""
    x, y = np.meshgrid(np.arange(-48, 176, 0.8), np.arange(-48, 48, 0.8))
    near = np.hypot(x - x_m, y) < 35
    x, y = x[near], y[near]
    across = np.abs((x - CROSSING_M[0]) * np.sin(CROSSING_RAD) - (y - CROSSING_M[1]) * np.cos(CROSSING_RAD))
    aside = np.minimum(np.abs(y), across)
    points = np.stack([x - x_m, y, np.full_like(x, -1.73), np.full_like(x, 0.3)], axis=1)
    labels = np.where(aside < 5, 40, np.where(aside < 7, 48, 72))
    return points.astype(np.float32), labels.astype(np.uint32)


def poses() -> np.ndarray:
    """Of a vehicle that drives ahead, which is east."""
    return level_poses(np.arange(SCANS) * SPACING_M)


def write_drive(root: Path) -> Path:
    """Write the drive in SemanticKITTI layout, without a georeference."""
    for frame in range(SCANS):
        write_scan(root, frame, *scan_at(frame * SPACING_M))
    (root / "poses.txt").write_text(pose_text(camera_poses(poses())))
    (root / "calib.txt").write_text(calib_text())
    (root / "times.txt").write_text("".join(f"{0.1 * frame:.6e}\n" for frame in range(SCANS)))
    return root


def crossing_map() -> str:
    """Map of the two streets, and of one that leaves the extract: its last node is missing."""
    c, s = np.cos(CROSSING_RAD), np.sin(CROSSING_RAD)
    x, y = CROSSING_M
    enu = [(-50.0, 0.0), CROSSING_M, (190.0, 0.0), (x - 80 * c, y - 80 * s), (x + 80 * c, y + 80 * s)]
    return osm_text(lonlat_from_enu(LAT_DEG, LON_DEG, np.array(enu)), [(1, 2, 3), (4, 2, 5)])


@pytest.fixture(scope="session")
def local_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive without a georeference. Shared: do not change it."""
    return once(tmp_path_factory, "local", write_drive)


@pytest.fixture(scope="session")
def drive(local_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive with a geo.csv. Shared: do not change it."""

    def make(root: Path) -> None:
        shutil.copytree(local_drive, root, copy_function=os.link)
        (root / "geo.csv").write_text(geo_csv(poses()))

    return once(tmp_path_factory, "crossing", make)


@pytest.fixture(scope="session")
def osm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Map of the drive. Shared: do not change it."""
    return once(tmp_path_factory, "map.osm", lambda path: path.write_text(crossing_map()))


@pytest.fixture(scope="session")
def finished(drive: Path, osm: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of a run over the drive, with its report. Shared: do not change it."""
    return once(tmp_path_factory, "finished", lambda out: succeed("run", drive, "-o", out, "--osm", osm))


@pytest.fixture(scope="session")
def detected(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of the drive before any evaluation. Shared: do not change it."""
    return once(tmp_path_factory, "detected", lambda out: succeed("run", drive, "-o", out))


@pytest.fixture(scope="session")
def local_result(local_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result folder of the drive without a georeference. Shared: do not change it."""
    return once(tmp_path_factory, "local_result", lambda out: succeed("run", local_drive, "-o", out))


def succeed(*arguments: object) -> None:
    """Run a command of which nobody reads what it says."""
    assert run([*map(str, arguments), "--quiet"]) == 0


@pytest.fixture
def short_drive(drive: Path, tmp_path: Path) -> Path:
    """The first 16 scans, to be damaged."""
    root = tmp_path / "short"
    for folder, suffix in (("velodyne", "bin"), ("labels", "label")):
        (root / folder).mkdir(parents=True)
        for frame in range(16):
            shutil.copy(drive / folder / f"{frame:06d}.{suffix}", root / folder)
    for name, lines in (("poses.txt", 16), ("times.txt", 16), ("geo.csv", 17), ("calib.txt", 2)):
        text = (drive / name).read_text().splitlines(keepends=True)
        (root / name).write_text("".join(text[:lines]))
    return root
