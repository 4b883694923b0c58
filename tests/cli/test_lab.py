"""`interloc simulate` and `interloc benchmark`."""

import io
import json
import shlex
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from interloc.cli import lab
from interloc.cli.main import run
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
    assert list(SENSORS) == list(lab.SENSORS)
    drive = tmp_path / "drive"
    chosen = ("--part", "quarter", "--every-scan", "--ground-only", "--sensor", "vlp-16")
    outcome = interloc("simulate", "town", *chosen, "-o", drive, "--max-scans", 3, "--quiet")
    assert (outcome.code, outcome.out) == (0, "")
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


SET = ("--set", "bev.resolution_m=0.4")


@pytest.fixture(scope="module")
def measured(drive: Path, osm: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A benchmark over the drive of these tests, and what was printed."""
    out = tmp_path_factory.mktemp("benchmark") / "out"
    with redirect_stdout(io.StringIO()) as printed:
        assert run(["benchmark", "drives", str(drive), "--osm", str(osm), "-o", str(out), *SET]) == 0
    return out, printed.getvalue()


def test_tables_and_files(measured: tuple[Path, str]) -> None:
    out, printed = measured
    assert "Performance, comparison with MMInsectDet, and errors of the labels" in printed
    assert (out / "benchmark.txt").read_text() == printed
    assert {path.name for path in out.iterdir()} == {"benchmark.json", "benchmark.txt", "rows"}
    record = json.loads((out / "benchmark.json").read_text())
    for preset in ("default", "paper"):
        (figures,) = (
            e for e in record["results"] if (e["preset"], e["drive"]) == (f"{preset} bev.resolution_m=0.4", "all")
        )
        assert figures["nodes_found"]["mean"] == figures["nodes_in_zone"]["mean"] == 1
        assert figures["ace_m"]["mean"] < 1.5


def test_presets_levels_and_seeds(measured: tuple[Path, str], drive: Path, osm: Path, interloc: Callable) -> None:
    out, _ = measured
    outcome = interloc(
        *("benchmark", "drives", drive, "--osm", osm, "-o", out, "--preset", "default", *SET),
        *("--noise", "20/20,5/5", "--noise", "5/5", "--seeds", 2, "--json"),
    )
    assert "1 row kept from before" in outcome.err
    record = outcome.json
    assert record == json.loads((out / "benchmark.json").read_text())
    assert record["presets"] == ["default bev.resolution_m=0.4"]
    assert record["noises"] == ["0/0", "20/20", "5/5"]
    assert record["config"]["default bev.resolution_m=0.4"]["bev"]["resolution_m"] == 0.4
    assert record["results"][-1]["ace_m"]["seeds"] == 2


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--noise", "20"), "Expected r-FPR/r-FNR in percent"),
        (("--noise", "200/0"), "Expected r-FPR/r-FNR in percent"),
        (("--preset", "best"), "there is no 'best'"),
        (("--preset", ""), "it is empty"),
        (("--noise", "5/5", "--noise", " ,"), "it is empty"),
        (("--set", "bev.colour=1"), "colour"),
    ],
)
def test_options_without_meaning(
    option: tuple[str, ...], words: str, drive: Path, osm: Path, interloc: Callable, tmp_path: Path
) -> None:
    outcome = interloc("benchmark", "drives", drive, "--osm", osm, "-o", tmp_path / "out", *option)
    assert outcome.code == 2
    assert words in outcome.err
    assert not (tmp_path / "out").exists()


def test_a_georeference_of_several_drives_is_refused(drive: Path, osm: Path, interloc: Callable) -> None:
    outcome = interloc("benchmark", "drives", drive, drive.parent, "--osm", osm, "--oxts", "x", "-o", "out")
    assert outcome.code == 2
    assert "put oxts/data or geo.csv into each" in outcome.err


def test_a_damaged_drive_is_named_before_any_is_measured(
    drive: Path, short_drive: Path, osm: Path, interloc: Callable, tmp_path: Path
) -> None:
    (short_drive / "labels/000003.label").unlink()
    outcome = interloc("benchmark", "drives", drive, short_drive, "--osm", osm, "-o", tmp_path / "out", "--quiet")
    assert outcome.code == 1
    assert str(short_drive) in outcome.complaint
    assert not (tmp_path / "out").exists()
