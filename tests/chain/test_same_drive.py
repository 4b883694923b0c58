"""The same drive in other clothes gives the same longitudes and latitudes."""

import gzip
import shutil
from collections.abc import Callable
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

LEARNING = {40: 9, 60: 9, 44: 10, 48: 11, 49: 12, 50: 13, 51: 14, 70: 15, 72: 17, 80: 18, 10: 1, 0: 0}
KITTI360 = {40: 7, 60: 7, 44: 9, 48: 8, 49: 6, 50: 11, 51: 13, 70: 21, 72: 22, 80: 17, 10: 26, 0: 0}


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


def write_poses(path: Path, poses: FloatArray, frames: list[int] | None = None) -> None:
    """Write pose lines to the last digit, 4 x 4 behind a frame number where there is one, else 3 x 4."""
    rows = poses[:, :3].reshape(len(poses), 12) if frames is None else poses.reshape(len(poses), 16)
    lines = [" ".join(f"{value:.17g}" for value in row) for row in rows]
    if frames is not None:
        lines = [f"{frame} {line}" for frame, line in zip(frames, lines, strict=True)]
    path.write_text("\n".join(lines) + "\n")


def read_camera_poses(path: Path) -> FloatArray:
    poses = np.tile(np.eye(4), (len(path.read_text().splitlines()), 1, 1))
    poses[:, :3] = np.loadtxt(path).reshape(-1, 3, 4)
    return poses


def relabel(folder: Path, ids: dict[int, int]) -> None:
    """Replace the label ids; in the upper half of a label stands the instance, as in SemanticKITTI."""
    table = np.full(1 << 16, 0xFFFF, np.uint32)
    table[list(ids)] = list(ids.values())
    for path in folder.glob("*.label"):
        labels = table[np.fromfile(path, np.uint32) & 0xFFFF]
        assert labels.max() < 0xFFFF
        (labels | np.uint32(3 << 16)).tofile(path)


def rename(folder: Path, digits: int, frame_of: Callable[[int], int] = int) -> list[int]:
    """Give the files of a folder other numbers; return these."""
    frames = []
    for path in sorted(folder.iterdir(), reverse=True):
        frames.append(frame_of(int(path.stem)))
        path.rename(path.with_stem(f"{frames[-1]:0{digits}d}"))
    return frames[::-1]


def assert_same(found: DriveResult, expected: DriveResult, within_deg: float = SAME_DEG) -> None:
    for table in ("keyframes", "detections", "intersections"):
        ours, theirs = getattr(expected, table).lonlat, getattr(found, table).lonlat
        assert theirs.shape == ours.shape
        assert np.abs(theirs - ours).max() <= within_deg
    assert found.detections.keyframe.tolist() == expected.detections.keyframe.tolist()


def test_poses_of_the_lidar(drive: Path, expected: DriveResult) -> None:
    write_poses(drive / "poses.txt", open_drive(drive).T_world_lidar)
    (drive / "calib.txt").unlink()
    changed = open_drive(drive)
    assert changed.pose_frame == "lidar"
    assert_same(detect(changed), expected)


@pytest.mark.parametrize("rpy_deg", [(2, -3, 137), (0, -90, 180)], ids=["turned and tilted", "on its head"])
def test_poses_in_another_world(drive: Path, expected: DriveResult, rpy_deg: tuple[float, float, float]) -> None:
    T_other_world = np.eye(4)
    T_other_world[:3, :3] = rotation_from_rpy(*np.radians(rpy_deg))
    T_other_world[:3, 3] = 431.0, -1207.5, 88.0
    write_poses(drive / "poses.txt", T_other_world @ read_camera_poses(drive / "poses.txt"))
    changed = open_drive(drive)
    assert changed.pose_frame == "camera"
    assert_same(detect(changed), expected, MOVED_DEG)


def test_ids_of_the_learning_scheme(drive: Path, expected: DriveResult) -> None:
    relabel(drive / "labels", LEARNING)
    changed = open_drive(drive)
    assert changed.scheme.name == "learning"
    assert_same(detect(changed), expected)


def test_frame_numbers_and_ids_of_kitti_360(drive: Path, expected: DriveResult) -> None:
    poses = open_drive(drive).T_world_lidar
    (drive / "calib.txt").unlink()
    (drive / "times.txt").unlink()
    relabel(drive / "labels", KITTI360)
    for folder in ("velodyne", "labels", "oxts/data"):
        frames = rename(drive / folder, 10, lambda number: 250 + 17 * number)
    write_poses(drive / "poses.txt", poses, frames)
    changed = open_drive(drive)
    assert (changed.layout, changed.scheme.name) == ("kitti360", "kitti360")
    assert_same(detect(changed), expected)


def test_oxts_rows_in_one_file(drive: Path, tmp_path: Path, expected: DriveResult) -> None:
    text = "".join(path.read_text() for path in sorted((drive / "oxts" / "data").iterdir()))
    shutil.rmtree(drive / "oxts")
    assert open_drive(drive).georeference is None
    rows = tmp_path / "oxts.txt.gz"
    rows.write_bytes(gzip.compress(text.encode()))
    assert_same(detect(open_drive(drive, oxts=rows)), expected)


@pytest.fixture
def raw_drive(drive: Path, tmp_path: Path) -> Path:
    """The drive as KITTI raw has it: no poses, the calibration one folder above."""
    raw = tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync"
    (raw / "velodyne_points").mkdir(parents=True)
    shutil.move(drive / "velodyne", raw / "velodyne_points" / "data")
    shutil.move(drive / "labels", raw / "labels")
    shutil.move(drive / "oxts", raw / "oxts")
    shutil.move(drive / "calib_imu_to_velo.txt", raw.parent)
    rename(raw / "velodyne_points" / "data", 10)
    rename(raw / "labels", 10)
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
