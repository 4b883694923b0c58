"""KITTI-360 as it is published: scans, poses and calibration in folders of their own."""

import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc import open_drive
from interloc.drive import Georeference
from interloc.drives.findings import Findings
from interloc.drives.georeference.geodetic import poses_of
from interloc.drives.georeference.read import ORIGIN_LAT_DEG, ORIGIN_LON_DEG, georeference_of_kitti360
from interloc.drives.layouts import find_layout
from interloc.drives.options import DriveOptions
from interloc.drives.trajectory import posed_frames
from interloc.errors import DriveError
from interloc.geometry import rotation_from_rpy, yaw_of
from interloc.reduction.look import look_into

DRIVE = "2013_05_28_drive_0009_sync"
T_IMU_CAM = np.array([[0.0, 0, 1, 1.5], [1, 0, 0, 0.3], [0, 1, 0, 0.9], [0, 0, 0, 1]])  # x ahead, y right, z down


@pytest.fixture
def published(tmp_path: Path, make: ModuleType) -> Path:
    """Write twelve scans, 100 to 111, of which the last has no pose; the labels are predictions of a network."""
    root = tmp_path / "KITTI-360"
    lidar = make.lidar_poses() @ np.eye(4)
    lidar[:, :3, 3] += (300.0, -200.0, 116.0)
    drive = root / "data_3d_raw" / DRIVE
    scans = drive / "velodyne_points" / "data"
    scans.mkdir(parents=True)
    source = make.write_semantickitti(tmp_path / "source", pose_frame="lidar")
    (drive / "predictions").mkdir()
    for number in range(12):
        (source / "velodyne" / f"{number:06d}.bin").rename(scans / f"{number + 100:010d}.bin")
        (source / "labels" / f"{number:06d}.label").rename(drive / "predictions" / f"{number + 100:010d}.label")
    times = [f"2013-05-28 11:46:{number // 10:02d}.{number % 10}00000000" for number in range(112)]
    (drive / "velodyne_points" / "timestamps.txt").write_text("\n".join(times) + "\n")
    poses = root / "data_poses" / DRIVE
    poses.mkdir(parents=True)
    T_lidar_imu = np.linalg.inv(T_IMU_CAM @ make.T_CAM_LIDAR)
    (poses / "poses.txt").write_text(make.pose_text(lidar[:11] @ T_lidar_imu, frames=list(range(100, 111))))
    cameras = lidar[:11] @ np.linalg.inv(make.T_CAM_LIDAR)
    (poses / "cam0_to_world.txt").write_text(make.pose_text(cameras, frames=list(range(100, 111)), rows=4))
    (root / "calibration").mkdir()
    numbers = " ".join(f"{value:.9f}" for value in np.linalg.inv(make.T_CAM_LIDAR)[:3].ravel())
    (root / "calibration" / "calib_cam_to_velo.txt").write_text(numbers + "\n")
    numbers = " ".join(f"{value:.9f}" for value in T_IMU_CAM[:3].ravel())
    (root / "calibration" / "calib_cam_to_pose.txt").write_text(f"image_00: {numbers}\n")
    return root


@pytest.mark.parametrize("folder", [".", "data_3d_raw", f"data_3d_raw/{DRIVE}"])
def test_all_of_a_drive_is_found(published: Path, make: ModuleType, folder: str) -> None:
    drive = open_drive(published / folder, labels="predictions")
    assert (drive.layout, drive.pose_frame, drive.name) == ("kitti360", "imu", DRIVE)
    assert drive.frames.tolist() == list(range(100, 111))
    np.testing.assert_allclose(drive.T_world_lidar, make.lidar_poses()[:11], atol=1e-5)
    np.testing.assert_allclose(np.diff(drive.times_s), 0.1, atol=1e-6)


def test_its_world_is_the_georeference(published: Path) -> None:
    drive = open_drive(published, labels="predictions")
    assert "in the world of KITTI-360" in drive.georeference.source
    on_ellipsoid = poses_of(drive.georeference)
    np.testing.assert_allclose(on_ellipsoid, drive.T_world_lidar, atol=0.05)  # 0.2 % of 20 m
    np.testing.assert_allclose(drive.georeference.alt_m[0], 116)


def test_camera_poses_will_do(published: Path, make: ModuleType) -> None:
    (published / "data_poses" / DRIVE / "poses.txt").unlink()
    drive = open_drive(published, labels="predictions")
    assert drive.pose_frame == "camera"
    assert drive.georeference is not None
    np.testing.assert_allclose(drive.T_world_lidar, make.lidar_poses()[:11], atol=1e-5)


def write_oxts(published: Path, *, lat_offset_deg: float = 0.0) -> Georeference:
    """Write the OXTS of the poses, as it would be without errors, and return the georeference of the poses."""
    world = open_drive(published, labels="predictions").georeference
    oxts = published / "data_poses" / DRIVE / "oxts" / "data"
    oxts.mkdir(parents=True)
    cam_to_velo = np.loadtxt(published / "calibration" / "calib_cam_to_velo.txt").reshape(3, 4)
    T_imu_lidar = T_IMU_CAM @ np.linalg.inv(np.vstack([cam_to_velo, [0, 0, 0, 1]]))
    R_enu_up = world.R_enu_lidar @ T_imu_lidar[:3, :3].T @ np.diag([1.0, -1, -1])
    for row, frame in enumerate(range(100, 111)):
        rpy = [0.0, 0.0, float(yaw_of(R_enu_up[row]))]
        values = [world.lat_deg[row] + lat_offset_deg, world.lon_deg[row], 116.0, *rpy, *[0.0] * 24]
        (oxts / f"{frame:010d}.txt").write_text(" ".join(f"{value:.12g}" for value in values))
    return world


def test_oxts_can_be_given(published: Path) -> None:
    world = write_oxts(published)
    oxts = published / "data_poses" / DRIVE / "oxts"
    assert find_layout(published, DriveOptions()).oxts == oxts
    given = open_drive(published, labels="predictions", oxts=oxts).georeference
    assert given.source.endswith("lever arm of calib_cam_to_pose.txt")
    np.testing.assert_allclose(given.R_enu_lidar, world.R_enu_lidar, atol=1e-6)


def test_the_poses_are_smoother_than_oxts_unless_they_were_moved(published: Path, make: ModuleType) -> None:
    world = write_oxts(published)
    oxts = published / "data_poses" / DRIVE / "oxts"
    for gap in (False, True):
        if gap:  # not fatal
            (oxts / "data" / "0000000105.txt").unlink()
        found = open_drive(published, labels="predictions").georeference
        assert found.source == world.source
    shutil.rmtree(oxts)
    write_oxts(published, lat_offset_deg=0.01)
    found = open_drive(published, labels="predictions").georeference
    assert found.source.endswith("lever arm of calib_cam_to_pose.txt")
    shutil.rmtree(oxts)
    text = make.pose_text(make.lidar_poses(), frames=list(range(100, 112)))  # from the identity: no georeference
    (published / "data_poses" / DRIVE / "poses.txt").write_text(text)
    assert open_drive(published, labels="predictions", pose_frame="lidar").georeference is None


def test_scans_without_a_pose_are_left_out_and_counted(published: Path) -> None:
    parts = find_layout(published, DriveOptions())
    findings = Findings(stop_at_first=True)
    assert posed_frames(parts, np.arange(100, 112), findings).tolist() == list(range(100, 111))
    (note,) = findings.found
    assert "1 of 12 scans have no pose (frames 111) and are left out" in note.message
    with pytest.raises(DriveError, match="has poses for the frames 100 to 110, and none for the scans 500 to 501"):
        posed_frames(parts, np.arange(500, 502), findings)


def test_a_drive_may_hold_its_part_of_the_data_set(published: Path, make: ModuleType) -> None:
    drive = published / "data_3d_raw" / DRIVE
    write_oxts(published)
    (published / "data_poses").rename(drive / "data_poses")  # as the page sends it
    (published / "calibration").rename(drive / "calibration")
    own = drive.rename(published.parent / "files")
    opened = open_drive(own, labels="predictions")
    assert (opened.layout, opened.pose_frame) == ("kitti360", "imu")
    np.testing.assert_allclose(opened.T_world_lidar, make.lidar_poses()[:11], atol=1e-5)
    assert "in the world of KITTI-360" in opened.georeference.source

    contents = {path.relative_to(own).as_posix(): path.read_bytes() for path in own.rglob("*") if path.is_file()}
    look = look_into({path: len(data) for path, data in contents.items()}, contents, "files", keyframes=None).drive
    assert look.plan.kept == [(100, 11)]
    assert look.plan.manifest.files.poses == f"data_poses/{DRIVE}/poses.txt"
    assert "in the world of KITTI-360" in str(look.georeference)


def test_the_root_of_several_drives_lists_them(published: Path) -> None:
    (published / "data_3d_raw" / "2013_05_28_drive_0000_sync" / "velodyne_points" / "data").mkdir(parents=True)
    with pytest.raises(DriveError, match=f"holds the drives 2013_05_28_drive_0000_sync, {DRIVE}: give one of them"):
        open_drive(published)
    assert open_drive(published / "data_3d_raw" / DRIVE, labels="predictions").name == DRIVE


def test_what_is_not_there_is_named(published: Path) -> None:
    with pytest.raises(DriveError, match="labels: is missing"):
        open_drive(published, labels="labels")
    for path in (published / "data_poses" / DRIVE).iterdir():
        path.unlink()
    with pytest.raises(DriveError, match=rf"data_poses/{DRIVE}/poses.txt: is missing"):
        open_drive(published, labels="predictions")


def test_the_world_of_kitti360_is_mercator_about_its_origin() -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = [[0, 0, 110], [1000, 0, 110], [0, 1000, 110]]
    poses[:, :3, :3] = rotation_from_rpy(0, 0, 0.3)
    fixes = georeference_of_kitti360(poses, "")
    np.testing.assert_allclose([fixes.lat_deg[0], fixes.lon_deg[0]], [ORIGIN_LAT_DEG, ORIGIN_LON_DEG])
    # the sphere of the projection, not the ellipsoid: a kilometre in the file is 1000 m / 6378137 m of its radius
    np.testing.assert_allclose(fixes.lon_deg[1] - ORIGIN_LON_DEG, np.degrees(1000 / 6378137) / 0.65628, rtol=1e-4)
    np.testing.assert_allclose(fixes.lat_deg[2] - ORIGIN_LAT_DEG, np.degrees(1000 / 6378137), rtol=2e-4)
    np.testing.assert_allclose(yaw_of(fixes.R_enu_lidar), 0.3)
