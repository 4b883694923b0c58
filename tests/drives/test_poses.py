"""Pose files: every form that is read or refused, the poses between their times, and of which frame they are."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc import open_drive
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.files import PoseLines, looks_like_tum, read_poses, read_tum
from interloc.drives.poses.frame import find_camera_calibration, guess_frame, to_lidar
from interloc.drives.poses.motion import (
    TimedPoses,
    longest_piece,
    quaternions_from_rotations,
    rotations_from_quaternions,
)
from interloc.errors import DriveError
from interloc.geometry import invert_transform, rotation_from_rpy, yaw_of
from tests.small_drives import refusal_of


def write(folder: Path, text: str) -> SourceFile:
    (folder / "poses.txt").write_text(text)
    return SourceFile(folder / "poses.txt", folder)


def read(tmp_path: Path, text: str) -> PoseLines:
    return read_poses(write(tmp_path, text))


complaint = partial(refusal_of, read)


@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize("frames", [None, [5, 6, 9]])
def test_all_four_forms_give_the_same_poses(
    tmp_path: Path, make: ModuleType, rows: int, frames: list[int] | None
) -> None:
    poses = make.lidar_poses(3)
    lines = read(tmp_path, make.pose_text(poses, frames=frames, rows=rows))
    np.testing.assert_allclose(lines.poses, poses, atol=1e-8)
    assert (None if lines.frames is None else lines.frames.tolist()) == frames


def test_numbered_lines_are_sorted(tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses(2)
    lines = read(tmp_path, make.pose_text(poses, frames=[9, 4]))
    assert lines.frames.tolist() == [4, 9]
    np.testing.assert_allclose(lines.poses[0], poses[1], atol=1e-8)


def test_blank_lines_comments_and_a_byte_order_mark_are_skipped(tmp_path: Path) -> None:
    assert len(read(tmp_path, "\ufeff# a comment\n\n1 0 0 0 0 1 0 0 0 0 1 0\n\n").poses) == 1


def test_rounded_rotations_are_made_proper(tmp_path: Path) -> None:
    rotation = read(tmp_path, "0.9998 -0.02 0 1 0.02 0.9998 0 2 0 0 1 3\n").poses[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 2 3 4 5 6 7 8", "TUM"),
        ("1,0,0,0,0,1,0,0,0,0,1,0", "commas"),
        ("1 0 0 0 0 1 0 0 0 0 1 zero", "'zero' is not a number"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0", "not finite"),
        ("1 0 0 inf 0 1 0 0 0 0 1 0", "not finite"),
        ("1 0 0 2e7 0 1 0 0 0 0 1 0", "10,000 km"),
        ("2 0 0 0 0 1 0 0 0 0 1 0", "not a rotation"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "mirrors"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 5 5 5 1", "0 0 0 1"),
        ("0.5 1 0 0 0 0 1 0 0 0 0 1 0", "frame number"),
        ("0 0 0 0 0 0 0 0 0 0 0 0", "not a rotation"),
        ("VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1", "a pose graph of g2o"),
        ("0 0 1", "a .log of Open3D"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 7 8 9 1", "transpose each"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, line: str, words: str) -> None:
    text = complaint(tmp_path, line + "\n")
    assert text.startswith("poses.txt: line 1: ")
    assert words in text


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be"])
def test_text_of_another_encoding_is_named(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "poses.txt").write_bytes("\ufeff1 0 0 0\n".encode(encoding))
    with pytest.raises(DriveError, match=r"UTF-16, as PowerShell"):
        read_poses(SourceFile(tmp_path / "poses.txt", tmp_path))


def test_a_file_that_is_missing_or_has_two_poses_of_one_frame(tmp_path: Path, make: ModuleType) -> None:
    with pytest.raises(DriveError, match=r"poses\.txt: is missing"):
        read_poses(SourceFile(tmp_path / "poses.txt", tmp_path))
    assert "frame 3 has two poses" in complaint(tmp_path, make.pose_text(make.lidar_poses(2), frames=[3, 3]))


def turned_by(*yaws_deg: float) -> TimedPoses:
    poses = np.tile(np.eye(4), (len(yaws_deg), 1, 1))
    poses[:, :3, :3] = rotation_from_rpy(0, 0, np.radians(yaws_deg))
    poses[:, 0, 3] = 10 * np.arange(len(yaws_deg))
    return TimedPoses(np.arange(len(yaws_deg), dtype=np.float64), poses)


def test_lines_become_poses(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    file = write(tmp_path, f"# time x y z qx qy qz qw\n1.5 1 2 3 0 0 0 1\n\n2.5 4 5 6 0 0 {half} {half}\n")
    timed = read_tum(file)
    np.testing.assert_array_equal(timed.times_s, [1.5, 2.5])
    np.testing.assert_array_equal(timed.poses[:, :3, 3], [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(np.degrees(yaw_of(timed.poses[:, :3, :3])), [0, 90])
    assert timed.source == "poses.txt"


@pytest.mark.parametrize(
    "text",
    [
        "1600000001.5,1,2,3,0,0,0,1\n1600000002.25,4,5,6,0,0,0,1\n",
        "timestamp x y z q_x q_y q_z q_w\n1600000001.5 1 2 3 0 0 0 1\n1600000002.25 4 5 6 0 0 0 1\n",
        "# sec,nsec,x,y,z,qx,qy,qz,qw\n1600000001,500000000,1,2,3,0,0,0,1\n1600000002,250000000,4,5,6,0,0,0,1\n",
        "1600000001500000000 1 2 3 0 0 0 1\n1600000002250000000 4 5 6 0 0 0 1\n",
        "1600000001500000 1 2 3 0 0 0 1\n1600000002250000 4 5 6 0 0 0 1\n",
        "#timestamp x y z qx qy qz qw id\n1600000001.5 1 2 3 0 0 0 1 7\n1600000002.25 4 5 6 0 0 0 1 8\n",
        "num,t,x,y,z,qx,qy,qz,qw\n1,1600000001.5,1,2,3,0,0,0,1\n2,1600000002.25,4,5,6,0,0,0,1\n",
    ],
)
def test_relatives_of_the_format(tmp_path: Path, text: str) -> None:
    file = write(tmp_path, text)
    assert looks_like_tum(file.path)
    timed = read_tum(file)
    np.testing.assert_allclose(timed.times_s, [1600000001.5, 1600000002.25], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(timed.poses[:, :3, 3], [[1, 2, 3], [4, 5, 6]])


def test_lines_without_comments_are_read_the_same(tmp_path: Path) -> None:
    timed = read_tum(write(tmp_path, "1 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n2 1 2 3 0 0 0 1\n"))
    np.testing.assert_array_equal(timed.times_s, [1, 2])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1 0 0 0 0 0 0\n", r"line 1: 7 numbers; expected 8"),
        ("1 0 0 0 1 0 0 0 1 0 0 0\n", r"poses as matrices \(KITTI\)"),
        ("1 0 0 0 0 0 0 1\n# cut\n2 0 0\n", "line 3: 3 numbers"),
        ("1 0 0 nan 0 0 0 1\n", "line 1: holds a value that is not finite"),
        ("1 0 0 x 0 0 0 1\n", "'x' is not a number"),
        ("1 0 0 0 0 0 0 0\n", "the quaternion is 0 long"),
        ("1 0 0 0 0.1 0.2 3 1\n", r"the quaternion is 3\.17 long"),
        ("1 1e9 0 0 0 0 0 1\n", "line 1: a position is more than 10,000 km"),
        ("2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "line 2: runs backwards in time"),
        ("2 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n", "line 2: has the time of the line before, but another pose"),
        ("# nothing\n", "comments only"),
        ("", "is empty"),
    ],
)
def test_damaged_lines_are_refused_in_words(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(DriveError, match=complaint):
        read_tum(write(tmp_path, text))


@pytest.mark.parametrize("turn_deg", [0.0, 1.0], ids=["straight", "in a bend"])
@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
def test_the_order_of_quaternions_shows_in_the_motion(tmp_path: Path, order: str, turn_deg: float) -> None:
    yaw = np.radians(turn_deg * np.arange(60))
    x, y = np.cumsum([np.cos(yaw), np.sin(yaw)], axis=1)
    quaternion = {"x": 0 * yaw, "y": 0 * yaw, "z": np.sin(yaw / 2), "w": np.cos(yaw / 2)}
    np.savetxt(tmp_path / "poses.txt", np.column_stack([np.arange(60), x, y, 0 * x, *(quaternion[e] for e in order)]))
    findings = Findings(stop_at_first=False)
    timed = read_tum(SourceFile(tmp_path / "poses.txt", tmp_path), findings)
    np.testing.assert_allclose(yaw_of(timed.poses[:, :3, :3]), yaw, atol=1e-9)
    assert [each.message[:40] for each in findings.found] == ["the quaternions are in the order w x y z"] * (
        order == "wxyz"
    )


def test_shuffled_lines_are_sorted(tmp_path: Path) -> None:
    timed = read_tum(write(tmp_path, "".join(f"{time} {time} 0 0 0 0 0 1\n" for time in (3, 1, 4, 2, 5))))
    np.testing.assert_array_equal(timed.poses[:, 0, 3], [1, 2, 3, 4, 5])


@pytest.mark.parametrize("numbered", [True, False], ids=["numbered", "by rows"])
@pytest.mark.parametrize(
    ("jumped_at", "by_m", "kept"), [(30, 60.0, slice(0, 30)), (10, -9.0, slice(10, 40)), (1, 5e6, slice(1, 40))]
)
def test_jumps_are_cut_where_no_times_are_known(jumped_at: int, by_m: float, kept: slice, numbered: bool) -> None:
    positions = np.outer(np.arange(40), [1.0, 0, 0])
    positions[jumped_at:, 1] += by_m
    frames = np.arange(0, 200, 5) if numbered else np.arange(40)
    rows, jumps = longest_piece(positions, None, frames)
    assert rows == kept
    assert f"by {abs(by_m):,.0f} m after scan {frames[jumped_at - 1]}" in jumps


@pytest.mark.parametrize("steps_m", [[0, 0, 0, 6, 14, 17, 17, 25], [5, 17, 25, 25], [1] * 50 + [3] * 20, [0] * 30])
def test_what_a_vehicle_may_drive_is_no_jump(steps_m: list[float]) -> None:
    positions = np.outer(np.cumsum([0, *steps_m]), [1.0, 0, 0])
    assert longest_piece(positions, None, np.arange(len(positions)))[1] == ""


def test_between_two_poses_the_body_turns_steadily() -> None:
    timed = turned_by(0, 90)
    poses = timed.at([0, 1 / 3, 0.5, 1])
    np.testing.assert_allclose(np.degrees(yaw_of(poses[:, :3, :3])), [0, 30, 45, 90], atol=1e-9)
    np.testing.assert_allclose(poses[:, 0, 3], [0, 10 / 3, 5, 10])
    the_short_way_round = turned_by(170, -170).at([0.5])
    np.testing.assert_allclose(np.degrees(yaw_of(the_short_way_round[:, :3, :3])) % 360, [180], atol=1e-9)


def test_nothing_is_extrapolated_nor_told_in_a_long_gap() -> None:
    timed = turned_by(0, 0, 0)
    np.testing.assert_array_equal(timed.covers([-0.1, 0, 1, 2, 2.1, np.nan]), [False, True, True, True, False, False])
    with pytest.raises(DriveError, match=r"1 of 2 times have no pose, such as 2.100 s: the poses cover 0.000 s to 2.0"):
        timed.at([1, 2.1])
    with_gap = TimedPoses(np.array([0.0, 1.0, 10.0]), np.tile(np.eye(4), (3, 1, 1)))
    covered = with_gap.covers([0, 0.5, 1, 5, 10, 11], longest_gap_s=2)
    np.testing.assert_array_equal(covered, [True, True, True, False, True, False])
    alone = turned_by(30)
    np.testing.assert_array_equal(alone.at([0, 0]), np.concatenate([alone.poses, alone.poses]))


@pytest.mark.parametrize("by_number", [False, True])
def test_a_real_drive_with_its_poses_as_tum_is_the_same(tmp_path: Path, sample: FolderDrive, by_number: bool) -> None:
    for folder in ("velodyne", "labels"):
        (tmp_path / folder).symlink_to(sample.root / folder)
    assert sample.times_s is not None
    times_s = sample.times_s - sample.times_s[0]
    np.savetxt(tmp_path / "times.txt", times_s)
    quaternions = quaternions_from_rotations(sample.T_world_lidar[:, :3, :3])
    first = sample.frames if by_number else times_s
    lines = np.column_stack([first, sample.T_world_lidar[:, :3, 3], quaternions])
    np.savetxt(tmp_path / "poses.txt", lines, fmt="%.9f", header="time x y z qx qy qz qw")
    drive = open_drive(tmp_path)
    assert drive.pose_frame == "lidar"
    np.testing.assert_allclose(drive.T_world_lidar, sample.T_world_lidar, atol=1e-6)  # 9 digits


def test_rotations_and_quaternions_are_inverse() -> None:
    quaternions = np.random.default_rng(0).normal(size=(200, 4))
    quaternions = np.concatenate([quaternions, np.eye(4)])  # half turns about the axes
    rotations = rotations_from_quaternions(quaternions)
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    np.testing.assert_allclose(rotations_from_quaternions(quaternions_from_rotations(rotations)), rotations, atol=1e-12)


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
