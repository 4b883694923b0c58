"""`interloc convert --reduce`: a small copy of a drive, with the same results to the last byte."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from interloc.config import DEFAULT
from interloc.drives.open import open_drive
from interloc.explain.evidence import gather
from interloc.lab.config import LidarConfig, SimulationOptions
from interloc.lab.drive import simulate
from interloc.lab.measure import MislabelledDrive
from interloc.lab.town import Town
from interloc.pipeline import detect


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.fixture
def assert_same(interloc: Callable, tmp_path: Path) -> Callable[..., None]:
    """Run a drive and its reduced copy, and compare all that was found, byte by byte."""

    def compare(drive: Path, *options: object, reading: tuple[Any, ...] = ()) -> None:
        reduced = tmp_path / "reduced"
        assert interloc("convert", "--reduce", drive, "-o", reduced, "--quiet", *reading).code == 0
        for source, name, more in ((drive, "before", reading), (reduced, "after", ())):
            assert interloc("run", source, "-o", tmp_path / name, "--quiet", *options, *more).code == 0
        found = sorted(path.name for path in (tmp_path / "before").glob("*json") if path.name != "run.json")
        assert len(found) >= (8 if "--osm" in options else 4)  # a map with buildings makes a layer more
        for name in found:
            assert (tmp_path / "before" / name).read_bytes() == (tmp_path / "after" / name).read_bytes(), name

    return compare


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy drive through the made-up town, every scan of it (several a keyframe), with all its points."""
    drive = tmp_path_factory.mktemp("town") / "town"
    simulate(Town("plain").trip(), drive, SimulationOptions(max_scans=60, sensor=LidarConfig(columns=180)))
    return drive


def test_a_drive_through_the_town(assert_same: Callable[..., None], town: Path, tmp_path: Path) -> None:
    assert_same(town, "--osm", town / "map.osm")
    kept = len(list((tmp_path / "reduced/ground/labels").iterdir()))
    assert 15 < kept < 30
    assert size_of(tmp_path / "reduced") < size_of(town) / 8


def test_real_scans_of_kitti_360(assert_same: Callable[..., None], data: Callable[[str], Path], tmp_path: Path) -> None:
    assert_same(data("kitti360_0009"), "--labels", "predictions", reading=("--frames", ":20"))
    assert size_of(tmp_path / "reduced") < size_of(data("kitti360_0009")) * 20 / 50 / 4


def test_what_it_says(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    small = tmp_path / "small"
    facts = interloc("convert", "--reduce", drive, "-o", small, "--json", "--all-scans").json
    assert (facts["drive"], facts["scans"], facts["kept_scans"], facts["keyframes"]) == ("crossing", 210, 210, None)
    assert facts["labels"] == ["labels"]
    assert facts["bytes_before"] == size_of(drive / "velodyne") + size_of(drive / "labels")
    assert facts["bytes_after"] == size_of(small)
    outcome = interloc("convert", "--reduce", drive, "-o", small)
    assert outcome.code == 0
    assert not outcome.err
    said = dict(line.split(maxsplit=1) for line in outcome.out.splitlines())
    assert said["drive"] == "crossing: 210 scans, 53 kept, the keyframes of 2 m, 5 degrees"
    assert said["labels"] == "labels"
    assert said["size"].endswith(" now")
    assert said["written"].endswith("small")
    arguments = ("run", small, "-o", tmp_path / "out", "--set", "keyframes.distance_m=1")
    complaint = interloc(*arguments).complaint
    assert "was not kept" in complaint
    assert "--all-scans" in complaint
    assert not (tmp_path / "out").exists()


def test_the_other_commands_read_it(interloc: Callable, drive: Path, tmp_path: Path) -> None:
    small = tmp_path / "small"
    facts = interloc("convert", "--reduce", drive, "-o", small, "--json").json
    assert (facts["kept_scans"], facts["keyframes"]) == (53, {"distance_m": 2.0, "angle_deg": 5.0})
    info = interloc("info", small, "--thorough")
    assert info.code == 0
    assert "53 scans kept, the keyframes of 2 m, 5 degrees; " in info.out
    assert "210 (frames 0 to 209), about 6,0" in info.out
    drawn = interloc("explain", small, "--frame", 100, "-o", tmp_path / "steps", "--json").json["files"]
    assert sorted(map(Path, drawn)) == sorted((tmp_path / "steps").iterdir())
    assert len(drawn) == 2
    shown = [pickle.dumps(gather(open_drive(source), 100, DEFAULT)) for source in (drive, small)]
    assert shown[0] == shown[1]  # all that the pictures show
    begins = [open_drive(source, frames=":120") for source in (drive, small)]
    noisy = [detect(MislabelledDrive(each, 0.2, 0.2, 0)).detections for each in begins]
    assert len(noisy[0]) > 20
    assert noisy[0].world_xy.tobytes() == noisy[1].world_xy.tobytes()
