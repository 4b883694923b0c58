"""Layouts: what is a drive, which one, and what is refused."""

import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.errors import ConfigError, DriveError
from tests.pcd_files import write_pcd


def test_kitti_raw_takes_its_poses_from_oxts(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_kitti_raw(tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync")
    (root / "calib_imu_to_velo.txt").rename(root.parent / "calib_imu_to_velo.txt")
    drive = open_drive(root)
    assert (drive.layout, drive.pose_frame) == ("kitti_raw", "oxts")
    np.testing.assert_allclose(drive.T_world_lidar, make.lidar_poses(), atol=0.02)
    np.testing.assert_allclose(np.diff(drive.times_s), 0.1, atol=1e-6)
    assert len(drive.ground_points(11).road) > 0
    assert "calib_imu_to_velo.txt" in drive.georeference.source
    shutil.rmtree(root / "oxts")
    with pytest.raises(DriveError, match=r"the odometry lost track here.*give poses"):  # the points are noise
        open_drive(root)


@pytest.mark.parametrize("rows", [3, 4])
def test_kitti360_maps_frames_explicitly(tmp_path: Path, make: ModuleType, rows: int) -> None:
    """Frame numbers in front of the poses allow gaps between scans."""
    poses, frames = make.lidar_poses(), [*range(100, 106), *range(110, 116)]
    root = make.write_semantickitti(tmp_path / "360", poses=poses, pose_frame="lidar", scheme="kitti360", frames=frames)
    (root / "times.txt").unlink()
    (root / "poses.txt").write_text(make.pose_text(poses, frames=frames, rows=rows))
    drive = open_drive(root)
    assert (drive.layout, drive.scheme.name) == ("kitti360", "kitti360")
    assert drive.frames.tolist() == frames
    np.testing.assert_allclose(drive.T_world_lidar, poses, atol=1e-6)


def test_a_layout_can_be_named(tmp_path: Path, sequence: Path, make: ModuleType) -> None:
    root = make.write_kitti_raw(tmp_path / "both")
    (root / "velodyne").mkdir()
    with pytest.raises(DriveError, match="it could be two drives"):
        open_drive(root)
    assert open_drive(root, layout="kitti_raw").layout == "kitti_raw"
    with pytest.raises(DriveError, match=r"is not of layout kitti_raw\. Expected velodyne_points/data"):
        open_drive(sequence, layout="kitti_raw")


def test_clouds_beside_the_scans_are_a_map(sequence: Path) -> None:
    write_pcd(sequence / "map.pcd", np.zeros((5, 4), np.float32))
    assert open_drive(sequence).layout == "semantickitti"
    (sequence / "pcd").mkdir()
    write_pcd(sequence / "pcd" / "000000.pcd", np.zeros((5, 4), np.float32))
    assert open_drive(sequence).layout == "semantickitti"
    assert inspect_drive(sequence, layout="pcd").layout == "pcd"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("sequences/", "root of a data set"),
        ("00/", "It holds sequences"),
        ("2011_09_26_drive_0001_sync/", "It holds drives"),
        ("000000.bin", "It holds the scans themselves"),
        ("000000.label", "It holds labels"),
        ("drive.tar.gz", "unpack it first"),
        (
            "lidar/top/0.pcd",
            "holds 1 .pcd file in lidar/top: give that folder.*`interloc convert .*lidar/top --poses FILE",
        ),
        ("mine/velodyne/0.bin", "1 .bin file in mine/velodyne: give the folder they belong to, mine"),
        ("clouds/0.ply", r"1 \.ply file: PLY is not read, write PCD files .*docs/own-data.md lists all formats"),
        ("velodyne/000000.ply", r"velodyne: holds no \.bin file, but 1 \.ply"),
        ("velodyne/velodyne/000000.bin", r"velodyne: holds no \.bin file, but the folder velodyne/"),
        ("holiday.jpg", "is not a drive. Expected velodyne/000000.bin"),
    ],
)
def test_usual_mistakes(tmp_path: Path, name: str, words: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.mkdir() if name.endswith("/") else path.touch()
    with pytest.raises(DriveError, match=words):
        open_drive(tmp_path)


def test_folder_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(DriveError, match="does not exist"):
        open_drive(tmp_path / "gone")
    with pytest.raises(DriveError, match="is an empty folder"):
        open_drive(tmp_path)
    (tmp_path / "drive.zip").touch()
    with pytest.raises(DriveError, match=r"is a file.*unpack first what is packed"):
        open_drive(tmp_path / "drive.zip")
    (tmp_path / "drive.pcap").touch()
    with pytest.raises(DriveError, match=r"is a file.*packets of the sensor are not read"):
        open_drive(tmp_path / "drive.pcap")


def test_path_that_no_file_system_takes() -> None:
    with pytest.raises(DriveError, match="cannot be read"):
        open_drive("a" * 5000)
    assert not inspect_drive("a" * 5000).ok


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("lidar/00.pkl.gz", "PandaSet"),
        ("val/00a6ffc1/sensors/lidar/315968.feather", "Argoverse 2"),
        ("training/lidar/1002.parquet", "Waymo"),
        ("v1.0-mini/scene.json", r"nuScenes.*v1.0-mini names 2 scenes \(scene-0061, scene-0103\)"),
        ("town/frames/frame_0000.ply", "KITTI-CARLA"),
        ("velodyne_left/1400505893134088.bin", "Oxford RobotCar.*reshape"),
        ("LiDAR/Ouster/1689519045126396000.bin", "HeLiPR"),
        ("sensor_data/Ouster/1564718964124758686.bin", "MulRan"),
        ("lidar/1606417097528152.bin", "Boreas: .*six float32"),
        ("velodyne_sync/1326030979747850.bin", "NCLT: .*eight bytes"),
        ("ouster_points/data/0000000000.bin", "VBR"),
    ],
)
def test_public_data_sets_are_named_with_the_way_out(tmp_path: Path, file: str, words: str) -> None:
    (tmp_path / file).parent.mkdir(parents=True)
    (tmp_path / file).write_text('[{"name": "scene-0103"}, {"name": "scene-0061"}]')
    with pytest.raises(DriveError, match=f"It looks like {words}"):
        open_drive(tmp_path)


def test_poses_in_files_of_their_own_are_named(sequence: Path) -> None:
    (sequence / "poses.txt").unlink()
    (sequence / "pose").mkdir()
    (sequence / "pose" / "0000000.txt").write_text("1 0 0 0")
    with pytest.raises(DriveError, match=r"holds no poses.txt. It looks like Waymo in KITTI's form"):
        open_drive(sequence)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"labels": "else"}, "labels 'else': expected 'auto', 'labels', 'predictions' or 'geometry'"),
        ({"pose_frame": "imu"}, "pose frame 'imu': expected 'auto', 'camera' or 'lidar'"),
        (
            {"layout": "nuscenes"},
            "layout 'nuscenes': expected 'auto', 'semantickitti', 'kitti_raw', 'kitti360', 'pcd', 'rosbag' or 'las'",
        ),
        ({"label_scheme": "mine"}, "label scheme 'mine': expected auto, semantickitti, learning, kitti360"),
        ({"label_scheme": {-1}}, "label scheme '-1': expected auto"),
        ({"label_scheme": set()}, "label scheme '': expected auto"),
        ({"label_scheme": [70000]}, "must be numbers from 0 to 65535"),
        ({"crs": "foo"}, "crs 'foo': expected one such as EPSG:25832"),
        ({"colour": "red"}, "colour 'red': Extra inputs are not permitted"),
    ],
)
def test_an_unknown_option_or_choice(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        DriveOptions.of(**arguments)


def test_arguments_come_before_given_options() -> None:
    given = DriveOptions(labels="predictions", layout="kitti_raw", name="08")
    assert DriveOptions.of(given, labels="auto") == DriveOptions(layout="kitti_raw", name="08")


SAMPLES = [
    ("semantickitti_mini/sequences/00", "labels", "camera"),
    ("semantickitti_mini/sequences/07", "labels", "camera"),
    ("kitti360_0009", "labels", "lidar"),
    ("kitti360_0009", "predictions", "lidar"),
]


@pytest.mark.parametrize(("name", "labels", "frame"), SAMPLES)
def test_real_drives_are_sound(data: Callable[[str], Path], name: str, labels: str, frame: str) -> None:
    report = inspect_drive(data(name), labels=labels, thorough=True)
    assert report.ok
    assert not [problem for problem in report.problems if problem.severity == "warning"]
    assert (report.pose_frame, report.label_scheme) == (frame, "semantickitti")
    assert 0.1 < report.road_share < 0.4
    assert report.flatness_m < 0.3


def test_sequence_07_has_more_poses_than_scans(data: Callable[[str], Path]) -> None:
    report = inspect_drive(data("semantickitti_mini/sequences/07"))
    assert (report.scans, report.poses) == (10, 1101)
    assert [problem.message for problem in report.problems] == [
        "1,101 poses for 10 scans; the poses of other frames are not used."
    ]
