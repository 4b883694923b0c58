"""Drives rewritten in SemanticKITTI's layout, and label files by a network."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from interloc.drives.files import SourceFile
from interloc.drives.georeference.geodetic import ecef_poses
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.bin_files import read_points
from interloc.errors import ConfigError, DriveError
from interloc.reduction.convert import convert_drive, label_drive
from interloc.reduction.reduce import reduce_drive
from tests.drives.scans.test_pcd import as_pcd_with_gaps
from tests.networks import write_model
from tests.pcd_files import write_pcd
from tests.small_drives import lidar_poses, pose_text, write_kitti_raw


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network that calls everything road that lies low and within 5 m of the middle."""
    return write_model(tmp_path_factory.mktemp("model") / "flat", height=32, width=512, road_half_width_m=5.0)


def test_camera_poses_become_those_of_the_lidar(sequence: Path, tmp_path: Path) -> None:
    done = convert_drive(sequence, tmp_path / "out")
    assert (done.scans, done.labels, done.is_renumbered, done.has_georeference) == (12, "labels", False, False)
    before, after = open_drive(sequence), open_drive(tmp_path / "out")
    assert after.pose_frame == "lidar"
    np.testing.assert_allclose(after.T_world_lidar, before.T_world_lidar, atol=1e-12)
    np.testing.assert_array_equal(after.times_s, before.times_s)
    for index in (0, 11):
        np.testing.assert_array_equal(after.ground_points(index).xyz, before.ground_points(index).xyz)


def test_a_georeference_becomes_a_geo_csv(tmp_path: Path) -> None:
    write_kitti_raw(tmp_path / "raw")
    assert convert_drive(tmp_path / "raw", tmp_path / "out").has_georeference
    before, after = open_drive(tmp_path / "raw"), open_drive(tmp_path / "out")
    np.testing.assert_allclose(
        ecef_poses(after.georeference)[:, :3, 3], ecef_poses(before.georeference)[:, :3, 3], atol=0.002
    )


def test_scans_with_gaps_are_numbered_anew(sequence: Path, tmp_path: Path) -> None:
    root = as_pcd_with_gaps(sequence, tmp_path / "pcd-drive")
    assert convert_drive(root, tmp_path / "out").is_renumbered
    assert open_drive(tmp_path / "out").frames.tolist() == list(range(12))


def test_remission_is_scaled_to_one(sequence: Path, tmp_path: Path) -> None:
    root = tmp_path / "pcd-drive"
    rng = np.random.default_rng(1)
    for scan in sorted((sequence / "velodyne").iterdir()):
        values = read_points(SourceFile(scan, sequence)).copy()
        values[:, 3] = rng.integers(0, 256, len(values))
        write_pcd(root / f"{scan.stem}.pcd", values)
    (root / "poses.txt").write_text(pose_text(lidar_poses()))
    convert_drive(root, tmp_path / "out")
    written = read_points(SourceFile(tmp_path / "out/velodyne/000003.bin", tmp_path))
    assert 0.98 < written[:, 3].max() <= 1


def test_ids_that_only_their_maker_knows_become_those_of_semantickitti(sequence: Path, tmp_path: Path) -> None:
    for path in (sequence / "labels").iterdir():
        ids = np.fromfile(path, "<u4") & 0xFFFF
        np.where(ids == 40, 7, 900).astype("<u4").tofile(path)
    convert_drive(sequence, tmp_path / "out", DriveOptions.of(label_scheme="7"))
    before, after = open_drive(sequence, label_scheme="7"), open_drive(tmp_path / "out")
    assert after.scheme.name == "semantickitti"
    np.testing.assert_array_equal(after.ground_points(4).xyz, before.ground_points(4).xyz)


def test_labels_of_a_network(sequence: Path, model: Path) -> None:
    shutil.rmtree(sequence / "labels")
    folder, reading = label_drive(sequence, None, DriveOptions.of(model=model))
    assert folder == sequence / "predictions"
    assert reading.labels.road_share == pytest.approx(0.74, abs=0.03)
    on_the_way, from_files = open_drive(sequence, model=model), open_drive(sequence, labels="predictions")
    for index in range(12):
        np.testing.assert_array_equal(from_files.ground_points(index).xyz, on_the_way.ground_points(index).xyz)
    road = from_files.ground_points(3).road
    assert (np.abs(road[:, 1]) < 6).all()
    assert (road[:, 2] < -1.5).all()


def test_predictions_that_are_there_are_kept(sequence: Path, model: Path) -> None:
    (sequence / "labels").rename(sequence / "predictions")
    before = sorted((sequence / "predictions").iterdir())
    with pytest.raises(ConfigError, match="predictions is there already, and was not touched"):
        label_drive(sequence, None, DriveOptions.of(model=model))
    assert sorted((sequence / "predictions").iterdir()) == before


def test_other_folders_are_not_replaced(sequence: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    for there in (tmp_path / "mine", sequence):
        with pytest.raises(ConfigError, match="is there already, and was not touched"):
            convert_drive(sequence, there)
    (tmp_path / "empty").mkdir()
    assert convert_drive(sequence, tmp_path / "empty").scans == len(list((sequence / "velodyne").iterdir()))
    reduce_drive(sequence, tmp_path / "reduced")
    with pytest.raises(DriveError, match="is a reduced drive"):
        convert_drive(tmp_path / "reduced", tmp_path / "out")
