"""`interloc label`, `odometry` and `convert`, and --model and --poses of the commands that read drives."""

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.config import DEFAULT
from interloc.drives.open import open_drive
from interloc.explain.evidence import gather
from interloc.geometry import invert_transform
from interloc.lab.config import LidarConfig, SimulationOptions
from interloc.lab.drive import simulate
from interloc.lab.measure import MislabelledDrive
from interloc.lab.town import Town
from interloc.pipeline import detect
from tests.bags import write_bag
from tests.networks import write_model
from tests.small_drives import lidar_poses, scan_at, write_semantickitti
from tests.street_points import poses_along, seen, street, write_scans


def features_of(path: Path) -> bytes:
    """The features of a layer: the head names the labels."""
    return path.read_bytes().partition(b'"features"')[2]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_model(tmp_path_factory.mktemp("model") / "flat", height=32, width=512, road_half_width_m=5.0)


@pytest.fixture
def unlabelled(tmp_path: Path) -> Path:
    root = write_semantickitti(tmp_path / "07")
    shutil.rmtree(root / "labels")
    return root


def test_label_then_detect(interloc: Callable, unlabelled: Path, model: Path, tmp_path: Path) -> None:
    assert "interloc label" in interloc("run", unlabelled, "-o", tmp_path / "out", "--labels", "labels").complaint
    labelled = interloc("label", unlabelled, "--model", model)
    assert labelled.code == 0
    assert "12 scans by network flat" in labelled.out
    assert len(list((unlabelled / "predictions").glob("*.label"))) == 12
    assert "was not touched" in interloc("label", unlabelled, "--model", model).complaint
    ours = interloc("run", unlabelled, "-o", tmp_path / "a", "--labels", "predictions", "--json").json["run"]
    theirs = interloc("run", unlabelled, "-o", tmp_path / "b", "--model", model, "--json").json["run"]
    assert ours["keyframes"] == theirs["keyframes"] > 5
    assert features_of(tmp_path / "a/detections.local.json") == features_of(tmp_path / "b/detections.local.json")
    assert '"network flat"' in (tmp_path / "b/run.json").read_text()
    elsewhere = interloc("label", unlabelled, "--model", model, "-o", tmp_path / "labels-of-07", "--json").json
    assert elsewhere["out"] == str(tmp_path / "labels-of-07" / "predictions")
    assert 0.5 < elsewhere["road_share"] < 1


def test_info_of_an_unlabelled_drive(interloc: Callable, unlabelled: Path, model: Path) -> None:
    outcome = interloc("info", unlabelled)
    assert outcome.code == 0
    assert "warning: labels: there are none: the road is found by geometry" in outcome.out
    assert "geometry, scheme semantickitti" in outcome.out
    assert interloc("info", unlabelled, "--labels", "predictions").code == 1
    outcome = interloc("info", unlabelled, "--model", model)
    assert outcome.code == 0
    assert "network flat, scheme semantickitti" in outcome.out


def test_no_model_there(interloc: Callable, unlabelled: Path, tmp_path: Path) -> None:
    complaint = interloc("label", unlabelled, "--model", tmp_path / "nothing").complaint
    assert "nothing" in complaint
    assert not (unlabelled / "predictions").exists()
    assert "cuda" in interloc("label", unlabelled, "--model", tmp_path / "nothing", "--help").out


def test_a_bag_to_semantickitti(interloc: Callable, tmp_path: Path) -> None:
    poses = lidar_poses()
    scans, labels = zip(*(scan_at(pose, (40, 48, 70)) for pose in poses), strict=True)
    times = (1.7e9 + 0.1 * np.arange(12)).tolist()
    bag = write_bag(tmp_path / "drive", "mcap", scans, times, labels=labels, poses=list(poses))
    report = interloc("info", bag, "--json").json
    assert {topic["name"]: topic["role"] for topic in report["topics"]} == {"/odom": "poses", "/points": "points"}
    assert "topic /points" in interloc("info", bag).out
    assert "/nothing" in interloc("info", bag, "--points", "/nothing").out
    outcome = interloc("convert", bag, "-o", tmp_path / "out")
    assert outcome.code == 0
    assert "drive: 12 scans" in outcome.out
    before, after = open_drive(bag), open_drive(tmp_path / "out")
    np.testing.assert_allclose(after.T_world_lidar, before.T_world_lidar, atol=1e-9)
    np.testing.assert_array_equal(after.ground_points(7).xyz, before.ground_points(7).xyz)


def test_labels_by_geometry(interloc: Callable, unlabelled: Path, tmp_path: Path) -> None:
    labelled = interloc("label", unlabelled, "--by", "geometry")
    assert labelled.code == 0
    assert "12 scans by geometry" in labelled.out
    ours = interloc("run", unlabelled, "-o", tmp_path / "a", "--labels", "geometry", "--json").json["run"]
    assert ours["keyframes"] > 5
    assert interloc("run", unlabelled, "-o", tmp_path / "b", "--labels", "predictions").code == 0
    assert features_of(tmp_path / "a/detections.local.json") == features_of(tmp_path / "b/detections.local.json")
    assert '"geometry"' in (tmp_path / "a/run.json").read_text()
    assert "geometry, scheme semantickitti" in interloc("info", unlabelled, "--labels", "geometry").out


def test_a_reduced_drive_has_no_points_for_geometry(interloc: Callable, tmp_path: Path) -> None:
    root = write_semantickitti(tmp_path / "07")
    assert interloc("convert", "--reduce", root, "-o", tmp_path / "reduced").code == 0
    complaint = interloc("run", tmp_path / "reduced", "-o", tmp_path / "out", "--labels", "geometry").complaint
    assert "holds ground points only" in complaint
    assert "labels" in complaint


def test_reduced_by_geometry(interloc: Callable, unlabelled: Path, tmp_path: Path) -> None:
    assert interloc("convert", "--reduce", unlabelled, "-o", tmp_path / "reduced", "--labels", "geometry").code == 0
    assert interloc("run", tmp_path / "reduced", "-o", tmp_path / "a").code == 0
    assert interloc("run", unlabelled, "-o", tmp_path / "b", "--labels", "geometry").code == 0
    assert features_of(tmp_path / "a/detections.local.json") == features_of(tmp_path / "b/detections.local.json")


POSES = poses_along(np.full(4, 1.5), turn_rad=0.02)


@pytest.fixture
def scans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A drive of points, and nothing else."""
    pytest.importorskip("small_gicp", reason="poses from points need small_gicp")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return write_scans(tmp_path / "drive", [seen(street(), pose) for pose in POSES])


def test_poses_are_written_and_read(interloc: Callable, scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses.txt"
    done = interloc("odometry", scans, "-o", out)
    assert done.code == 0
    assert "5 scans, 6 m" in done.out
    expected = (invert_transform(POSES[0]) @ POSES)[:, :3].reshape(-1, 12)
    np.testing.assert_allclose(np.loadtxt(out), expected, atol=0.05)
    assert "was not touched" in interloc("odometry", scans, "-o", out).complaint
    written = interloc("convert", scans, "-o", tmp_path / "copy", "--poses", "odometry", "--quiet")
    assert written.code == 0
    np.testing.assert_allclose(np.loadtxt(tmp_path / "copy/poses.txt"), np.loadtxt(out), atol=1e-6)


def test_tum_needs_times(interloc: Callable, scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "poses.tum"
    assert "those of the scans are not known" in interloc("odometry", scans, "-o", out, "--quiet").complaint
    (scans / "times.txt").write_text("".join(f"{0.1 * row:.3f}\n" for row in range(5)))
    done = interloc("odometry", scans, "-o", out, "--json").json
    assert (done["scans"], done["has_times"], done["how"]) == (5, True, "odometry over the points of 5 scans")
    rows = np.loadtxt(out)
    np.testing.assert_allclose(rows[:, 0], 0.1 * np.arange(5))
    np.testing.assert_allclose(np.linalg.norm(rows[:, 4:], axis=1), 1)


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy drive through the made-up town, every scan of it (several a keyframe), with all its points."""
    drive = tmp_path_factory.mktemp("town") / "town"
    simulate(Town("plain").trip(), drive, SimulationOptions(max_scans=60, sensor=LidarConfig(columns=180)))
    return drive


def test_a_drive_through_the_town(interloc: Callable, town: Path, tmp_path: Path) -> None:
    """The results of the drive and of its reduced copy are the same, byte by byte."""
    reduced = tmp_path / "reduced"
    assert interloc("convert", "--reduce", town, "-o", reduced, "--quiet").code == 0
    for source, name in ((town, "before"), (reduced, "after")):
        assert interloc("run", source, "-o", tmp_path / name, "--quiet", "--osm", town / "map.osm").code == 0
    found = sorted(path.name for path in (tmp_path / "before").glob("*json") if path.name != "run.json")
    assert len(found) >= 8
    for name in found:
        assert (tmp_path / "before" / name).read_bytes() == (tmp_path / "after" / name).read_bytes(), name
    kept = len(list((reduced / "ground/labels").iterdir()))
    assert 15 < kept < 30
    assert size_of(reduced) < size_of(town) / 8


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
