"""The same drive in another world, or as KITTI raw has it, gives the same longitudes and latitudes."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.drives.georeference.geodetic import poses_of
from interloc.drives.open import open_drive
from interloc.geometry import rotation_from_rpy
from interloc.pipeline import detect
from interloc.results import DriveResult
from tests.chain.conftest import EXACT_LIDAR, junction_drive

SAME_DEG = 1e-9  # 0.1 mm
MOVED_DEG = 5e-7  # 5 cm: the last digit of a moved pose may put a point into the next cell


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of some 40 keyframes as SemanticKITTI has them, with all that is in its scans."""
    dense = replace(EXACT_LIDAR, columns=1024)
    out = tmp_path_factory.mktemp("original") / "drive"
    return junction_drive(out, "X", 60, "turning", sensor=dense, ground_only=False)


@pytest.fixture(scope="module")
def expected(original: Path) -> DriveResult:
    result = detect(open_drive(original))
    assert len(result.detections) > 30
    assert len(result.intersections) == 1
    return result


@pytest.fixture
def drive(original: Path, tmp_path: Path) -> Path:
    """A copy of the drive, to be changed."""
    return Path(shutil.copytree(original, tmp_path / "drive"))


def write_poses(path: Path, poses: FloatArray) -> None:
    np.savetxt(path, poses[:, :3].reshape(len(poses), 12), "%.17g")


def read_camera_poses(path: Path) -> FloatArray:
    poses = np.tile(np.eye(4), (len(path.read_text().splitlines()), 1, 1))
    poses[:, :3] = np.loadtxt(path).reshape(-1, 3, 4)
    return poses


def assert_same(found: DriveResult, expected: DriveResult, within_deg: float = SAME_DEG) -> None:
    for table in ("keyframes", "detections", "intersections"):
        ours, theirs = getattr(expected, table).lonlat, getattr(found, table).lonlat
        assert theirs.shape == ours.shape
        assert np.abs(theirs - ours).max() <= within_deg
    assert found.detections.keyframe.tolist() == expected.detections.keyframe.tolist()


@pytest.mark.parametrize("rpy_deg", [(2, -3, 137), (0, -90, 180)], ids=["turned and tilted", "on its head"])
def test_poses_in_another_world(drive: Path, expected: DriveResult, rpy_deg: tuple[float, float, float]) -> None:
    T_other_world = np.eye(4)
    T_other_world[:3, :3] = rotation_from_rpy(*np.radians(rpy_deg))
    T_other_world[:3, 3] = 431.0, -1207.5, 88.0
    write_poses(drive / "poses.txt", T_other_world @ read_camera_poses(drive / "poses.txt"))
    changed = open_drive(drive)
    assert changed.pose_frame == "camera"
    assert_same(detect(changed), expected, MOVED_DEG)


@pytest.fixture
def raw_drive(drive: Path, tmp_path: Path) -> Path:
    """The drive as KITTI raw has it: no poses, the calibration one folder above."""
    raw = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (raw / "velodyne_points").mkdir(parents=True)
    shutil.move(drive / "velodyne", raw / "velodyne_points" / "data")
    shutil.move(drive / "labels", raw / "labels")
    shutil.move(drive / "oxts", raw / "oxts")
    shutil.move(drive / "calib_imu_to_velo.txt", raw.parent)
    for path in [*(raw / "velodyne_points" / "data").iterdir(), *(raw / "labels").iterdir()]:
        path.rename(path.with_stem(path.stem.zfill(10)))
    return raw


def test_kitti_raw(original: Path, raw_drive: Path, tmp_path: Path) -> None:
    """Poses are those of the OXTS on both sides, so the results agree to the last digits."""
    georeference = open_drive(original).georeference
    assert georeference is not None
    copy = Path(shutil.copytree(original, tmp_path / "oxts_poses"))
    write_poses(copy / "poses.txt", poses_of(georeference))
    (copy / "calib.txt").unlink()
    raw = open_drive(raw_drive)
    assert (raw.layout, raw.pose_frame) == ("kitti_raw", "oxts")
    assert_same(detect(raw), detect(open_drive(copy)))
