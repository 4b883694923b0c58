"""Camera or LiDAR poses: told from the motion."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.files import read_poses
from interloc.drives.poses.frame import find_camera_calibration, guess_frame, to_lidar
from interloc.errors import DriveError
from interloc.geometry import invert_transform, rotation_from_rpy


def parts(root: Path, layout: str = "semantickitti") -> DriveParts:
    return DriveParts(layout, root, root, root / "poses.txt", None, (root,), None, None)


def pose_file(root: Path) -> SourceFile:
    return SourceFile(root / "poses.txt", root)


@pytest.fixture
def findings() -> Findings:
    return Findings(stop_at_first=True)


@pytest.mark.parametrize("turn_rad", [0.0, 0.1, -0.2])
def test_the_motion_tells(make: ModuleType, turn_rad: float) -> None:
    lidar = make.lidar_poses(turn_rad=turn_rad)
    assert guess_frame(lidar)[0] == "lidar"
    frame, why = guess_frame(make.camera_poses(lidar))
    assert frame == "camera"
    assert "moves along its z axis" in why
    hill = np.eye(4)
    hill[:3, :3] = rotation_from_rpy(0.0, -0.4, 0.0)
    assert guess_frame(hill @ lidar)[0] == "lidar"
    assert guess_frame(make.lidar_poses(20, step_m=0.01))[0] is None  # it stands


@given(turn=st.floats(-0.2, 0.2), step=st.floats(0.2, 20), pitch=st.floats(-0.3, 0.3), yaw=st.floats(-3, 3))
@settings(max_examples=50, deadline=None)
def test_camera_poses_and_back(make: ModuleType, turn: float, step: float, pitch: float, yaw: float) -> None:
    start = np.eye(4)
    start[:3, :3] = rotation_from_rpy(0.0, pitch, yaw)
    lidar = start @ make.lidar_poses(8, step_m=step, turn_rad=turn)
    camera = make.camera_poses(lidar)
    back = camera @ make.T_CAM_LIDAR
    np.testing.assert_allclose(
        invert_transform(back[0]) @ back, invert_transform(lidar[0]) @ lidar, atol=1e-6 * max(1.0, step)
    )
    assert (guess_frame(lidar)[0], guess_frame(camera)[0]) == ("lidar", "camera")


def test_camera_poses_need_a_calibration(tmp_path: Path, make: ModuleType, findings: Findings) -> None:
    camera = make.camera_poses(make.lidar_poses())
    with pytest.raises(DriveError, match=r"poses\.txt: holds camera poses .* no calib\.txt .* Put the calib\.txt"):
        to_lidar(camera, parts(tmp_path), pose_file(tmp_path), "auto", findings)
    numbers = " ".join(str(v) for v in invert_transform(make.T_CAM_LIDAR)[:3].ravel())
    (tmp_path / "calib.txt").write_text(f"Tr: {numbers}\n")
    with pytest.raises(DriveError, match=r"calib\.txt: does not lead from the LiDAR to the camera.*inverse"):
        to_lidar(camera, parts(tmp_path), pose_file(tmp_path), "auto", findings)


@pytest.mark.parametrize(("declared", "actual"), [("camera", "lidar"), ("lidar", "camera")])
def test_declared_frame_that_contradicts_the_motion(
    tmp_path: Path, make: ModuleType, declared: str, actual: str, findings: Findings
) -> None:
    (tmp_path / "calib.txt").write_text(make.calib_text())
    poses = make.lidar_poses() if actual == "lidar" else make.camera_poses(make.lidar_poses())
    with pytest.raises(DriveError, match=f"pose frame '{declared}'.*Give pose frame 'auto' or '{actual}'"):
        to_lidar(poses, parts(tmp_path), pose_file(tmp_path), declared, findings)


@pytest.mark.parametrize("has_calibration", [True, False])
def test_standing_vehicle_falls_back_on_the_calibration(
    tmp_path: Path, make: ModuleType, has_calibration: bool, findings: Findings
) -> None:
    if has_calibration:
        (tmp_path / "calib.txt").write_text(make.calib_text())
    _, frame, why = to_lidar(make.lidar_poses(5, step_m=0.01), parts(tmp_path), pose_file(tmp_path), "auto", findings)
    assert frame == ("camera" if has_calibration else "lidar")
    assert "less than 1 m" in why
    assert [problem.severity for problem in findings.found] == ["note"]


def test_inverted_poses_are_named(tmp_path: Path, make: ModuleType, findings: Findings) -> None:
    ahead, corner = make.lidar_poses(20, turn_rad=0.0), make.lidar_poses(10, turn_rad=0.15)
    poses = np.concatenate([ahead, ahead[-1] @ corner, ahead[-1] @ corner[-1] @ ahead])
    assert to_lidar(poses, parts(tmp_path), pose_file(tmp_path), "auto", findings)[1] == "lidar"
    with pytest.raises(DriveError, match="inverted poses"):
        to_lidar(invert_transform(poses), parts(tmp_path), pose_file(tmp_path), "auto", findings)


def test_driving_backwards_is_a_warning(tmp_path: Path, make: ModuleType, findings: Findings) -> None:
    to_lidar(make.lidar_poses(20, step_m=-2.0), parts(tmp_path), pose_file(tmp_path), "auto", findings)
    assert [problem.severity for problem in findings.found] == ["warning"]
    assert "backwards" in findings.found[0].message


def test_imu_poses_of_kitti360(tmp_path: Path, make: ModuleType, findings: Findings) -> None:
    """Its IMU looks forward, right and down; its world has z up."""
    T_cam_velo = make.T_CAM_LIDAR
    T_imu_cam = np.array([[0.0, 0, 1, 1.6], [1, 0, 0, 0], [0, 1, 0, -0.65], [0, 0, 0, 1]])
    lidar = make.lidar_poses()
    imu = lidar @ invert_transform(T_imu_cam @ T_cam_velo)
    with pytest.raises(DriveError, match="KITTI-360's IMU"):
        to_lidar(imu, parts(tmp_path, "kitti360"), pose_file(tmp_path), "auto", findings)
    numbers = " ".join(str(v) for v in invert_transform(T_cam_velo)[:3].ravel())
    (tmp_path / "calib_cam_to_velo.txt").write_text(numbers + "\n")
    (tmp_path / "calib_cam_to_pose.txt").write_text(
        "image_00: " + " ".join(str(v) for v in T_imu_cam[:3].ravel()) + "\n"
    )
    got, frame, _ = to_lidar(imu, parts(tmp_path, "kitti360"), pose_file(tmp_path), "auto", findings)
    assert frame == "imu"
    np.testing.assert_allclose(got, lidar, atol=1e-9)


@pytest.mark.parametrize("source", ["poses_gt", "poses_suma"])
@pytest.mark.parametrize("sequence", range(11))
def test_every_kitti_sequence_and_every_window_of_it(data: Callable[[str], Path], source: str, sequence: int) -> None:
    path = data(f"kitti/{source}/{sequence:02d}.txt")
    camera = read_poses(SourceFile(path, path.parent)).poses
    calibration = data(f"kitti/calib/{sequence:02d}.txt")
    T_cam_lidar = _calibration(calibration)
    lidar = invert_transform(T_cam_lidar) @ camera @ T_cam_lidar
    assert (guess_frame(camera)[0], guess_frame(lidar)[0]) == ("camera", "lidar")
    for first in range(0, len(camera) - 60, 37):
        window = slice(first, first + 60)
        moved = np.linalg.norm(lidar[window, :3, 3] - lidar[first, :3, 3], axis=1).max()
        if moved > 10:
            assert (guess_frame(camera[window])[0], guess_frame(lidar[window])[0]) == ("camera", "lidar"), first


def _calibration(path: Path) -> np.ndarray:
    line = next(line for line in path.read_text().splitlines() if line.startswith("Tr:"))
    return np.vstack([np.array(line.split()[1:], float).reshape(3, 4), [0, 0, 0, 1]])


def test_calibrations_of_all_layouts(tmp_path: Path, make: ModuleType) -> None:
    T = make.T_CAM_LIDAR
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    rotation, translation = " ".join(map(str, T[:3, :3].ravel())), " ".join(map(str, T[:3, 3]))
    (tmp_path / "a" / "calib_velo_to_cam.txt").write_text(f"calib_time: 15-Mar-2012\nR: {rotation}\nT: {translation}\n")
    inverse = " ".join(map(str, invert_transform(T)[:3].ravel()))
    (tmp_path / "b" / "calib_cam_to_velo.txt").write_text(inverse + "\n")
    for name in ("a", "b"):
        found = find_camera_calibration(parts(tmp_path / name))
        np.testing.assert_allclose(found[1], T, atol=1e-12)
    assert find_camera_calibration(parts(tmp_path)) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("P0: 1 2 3\n", "no line 'Tr'"),
        ("Tr: 1 0 0\n", "3 numbers; expected 12"),
        ("Tr: 1 0 0 x 0 1 0 0 0 0 1 0\n", "not a number"),
        ("Tr: 2 0 0 0 0 1 0 0 0 0 1 0\n", "not a rotation"),
        ("Tr: 1 0 0 9e9 0 1 0 0 0 0 1 0\n", "Expected metres"),
    ],
)
def test_damaged_calibration(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "calib.txt").write_text(text)
    with pytest.raises(DriveError, match=words):
        find_camera_calibration(parts(tmp_path))
