"""Units, frames and mirrors: what cannot be points or poses of a LiDAR on a vehicle is refused with its cause."""

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.arrays import FloatArray
from interloc.drives.findings import Findings
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive, read_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scan_motion import check_scan_motion
from interloc.geometry import invert_transform, rotation_from_rpy
from tests import streets
from tests.small_drives import geo_csv, level_poses

HALF_TURN_ABOUT_X = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture
def street(tmp_path: Path, written: Path) -> Path:
    path = streets.linked(written, tmp_path / "street")
    write_poses(path, streets.poses())
    return path


def errors(path: Path) -> str:
    return "\n".join(p.message for p in inspect_drive(path).problems if p.severity == "error")


def write_poses(path: Path, poses: FloatArray) -> None:
    (path / "poses.txt").write_text(streets.pose_text(poses))


def test_a_sound_street_has_no_findings(street: Path) -> None:
    streets.write_geo(street, streets.poses())
    assert inspect_drive(street).problems == []


@pytest.mark.parametrize("scale", [1000.0, 100.0, 0.001])
def test_points_in_another_unit(street: Path, scale: float) -> None:
    streets.change_points(street, scale * np.eye(3))
    assert "Expected x y z in metres" in errors(street)


def test_points_in_the_frame_of_the_world(street: Path) -> None:
    streets.change_points(street, poses_applied=streets.poses())
    assert "in the frame of the world already" in errors(street)


def test_a_sensor_upside_down(street: Path) -> None:
    streets.change_points(street, HALF_TURN_ABOUT_X[:3, :3])
    write_poses(street, streets.poses() @ HALF_TURN_ABOUT_X)
    assert "the road lies 1.7 m above the sensor" in errors(street)


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (HALF_TURN_ABOUT_X[:3, :3], "1.7 m above the sensor"),
        ([[0, -1, 0], [0, 0, -1], [1, 0, 0]], "lies in the direction of +y, not below"),
        ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], "lies in the direction of -y, not below"),
    ],
    ids=["upside down", "axes of a camera", "on its side"],
)
def test_points_are_judged_before_anything_labels_them(street: Path, turn: FloatArray, words: str) -> None:
    streets.change_points(street, np.array(turn, float))
    shutil.rmtree(street / "labels")
    (street / "poses.txt").unlink()
    told = errors(street)
    assert words in told
    assert "poses.txt" not in told
    assert "odometry-" not in told


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "labels"),
    [(0, 20, "labels"), (0, -12, "labels"), (15, 0, "labels"), (7, 7, "labels"), (7, 7, "geometry")],
)
def test_a_sensor_at_an_angle_is_turned_upright(street: Path, roll_deg: float, pitch_deg: float, labels: str) -> None:
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_from_rpy(np.radians(roll_deg), np.radians(pitch_deg), 0)
    level = open_drive(street)
    streets.change_points(street, tilt[:3, :3].T)
    tilted = streets.poses() @ tilt
    write_poses(street, invert_transform(tilted[0]) @ tilted)
    findings = Findings(stop_at_first=True)
    (reading,) = read_drive(street, DriveOptions.of(labels=labels), findings).values()
    assert any("points and poses are turned upright" in each.message for each in findings.found)
    moved, expected = (each.T_world_lidar[:, :3, 3] for each in (reading.drive, level))
    np.testing.assert_allclose(np.linalg.norm(moved[:, :2], axis=1), np.linalg.norm(expected[:, :2], axis=1), atol=0.1)
    assert np.abs(moved[:, 2] - expected[:, 2]).max() < 1.0


def test_a_small_tilt_is_that_of_roads_and_changes_nothing(street: Path) -> None:
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_from_rpy(0, np.radians(3), 0)
    streets.change_points(street, tilt[:3, :3].T)
    write_poses(street, streets.poses() @ tilt)
    before = invert_transform(streets.poses()[0] @ tilt) @ streets.poses() @ tilt
    np.testing.assert_allclose(open_drive(street).T_world_lidar, before, atol=1e-5)


@pytest.mark.parametrize("scale", [1000.0, 100.0])
def test_poses_in_another_unit(street: Path, scale: float) -> None:
    scaled = streets.poses().copy()
    scaled[:, :3, 3] *= scale
    write_poses(street, scaled)
    assert "Expected positions in metres" in errors(street)


def test_a_jump_of_the_poses_cuts_the_drive(street: Path) -> None:
    after = streets.poses().copy()
    after[60:, 0, 3] += 15.0
    write_poses(street, after)
    report = inspect_drive(street)
    (jump,) = (problem for problem in report.problems if problem.severity == "warning")
    assert jump.path == "poses.txt"
    assert "by 15 m after scan 59 (91 m on)" in jump.message
    assert "longest piece is used: scans 0 to 59, 60 of 100" in jump.message
    assert (report.ok, report.scans, report.last_frame) == (True, 60, 59)


def test_the_piece_after_a_jump_is_a_drive_of_its_own(street: Path) -> None:
    after = streets.poses().copy()
    after[30:, 0, 3] += 15.0
    write_poses(street, after)
    drive = open_drive(street)
    assert drive.frames.tolist() == list(range(30, 100))
    assert len(drive.times_s) == 70
    expected = invert_transform(streets.poses()[30]) @ streets.poses()[99]
    np.testing.assert_allclose(drive.T_world_lidar[-1], expected, atol=1e-4)
    assert len(drive.ground_points(69).road)


def test_a_georeference_that_jumps_against_the_poses(street: Path) -> None:
    header, *rows = geo_csv(streets.poses()).splitlines()
    for number in range(40, 60):
        frame, lat, *rest = rows[number].split(",")
        rows[number] = ",".join([frame, f"{float(lat) + 2e-4:.9f}", *rest])  # 22 m to the north
    (street / "geo.csv").write_text("\n".join([header, *rows]) + "\n")
    (jump,) = (problem for problem in inspect_drive(street).problems if problem.severity == "warning")
    assert jump.path.startswith("geo.csv")
    assert "2 times, first by 22 m after " in jump.message


@pytest.mark.parametrize("yaw", [0.0, 1.0])
def test_an_orientation_that_stays_the_same(street: Path, yaw: float) -> None:
    constant = streets.poses().copy()
    constant[:, :3, :3] = rotation_from_rpy(0.0, 0.0, yaw)
    write_poses(street, constant)
    assert "these are positions, not poses" in errors(street)


def test_a_georeference_that_turns_to_the_other_side(street: Path) -> None:
    """The poses are mirrored (z down): their steps along x are the same, left and right are not."""
    streets.write_geo(street, streets.poses())
    write_poses(street, HALF_TURN_ABOUT_X @ streets.poses() @ HALF_TURN_ABOUT_X)
    assert "geo.csv" in "".join(p.path for p in inspect_drive(street).problems)
    assert "turns to the other side than the poses" in errors(street)


@pytest.mark.parametrize("scans", [5, -8])
def test_a_georeference_that_starts_at_another_frame(street: Path, scans: int) -> None:
    streets.write_geo(street, streets.poses()[np.clip(np.arange(streets.COUNT) - scans, 0, streets.COUNT - 1)])
    found = errors(street)
    assert "another motion" in found or f"scans {'late' if scans > 0 else 'early'} against the poses" in found


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same street without anything that stands upright."""
    path = streets.write_street(tmp_path_factory.mktemp("streets") / "ground")
    for points in sorted((path / "velodyne").iterdir()):
        labels = path / "labels" / f"{points.stem}.label"
        ids = np.fromfile(labels, np.uint32)
        np.fromfile(points, np.float32).reshape(-1, 4)[ids != 50].tofile(points)
        ids[ids != 50].tofile(labels)
    return path


def with_poses(source: Path, path: Path, poses: FloatArray) -> str:
    """Return the errors about a copy of a drive with other poses."""
    streets.linked(source, path)
    (path / "poses.txt").write_text(streets.pose_text(invert_transform(poses[0]) @ poses))
    return "\n".join(p.message for p in inspect_drive(path).problems if p.severity != "note")


def scaled(factor: float) -> Callable[[FloatArray], FloatArray]:
    def change(poses: FloatArray) -> FloatArray:
        other = poses.copy()
        other[:, :3, 3] *= factor
        return other

    return change


def mirrored(poses: FloatArray) -> FloatArray:
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return flip @ poses @ flip


def late(scans: int) -> Callable[[FloatArray], FloatArray]:
    return lambda poses: np.concatenate([np.repeat(poses[:1], scans, axis=0), poses[:-scans]])


def turned(poses: FloatArray) -> FloatArray:
    return poses @ level_poses(0.0, 0.0, np.pi / 2)


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("written", mirrored, "with left and right exchanged"),
        ("written", scaled(0.3), "The poses move 0.3"),
        ("written", scaled(3.28), "The poses move 3."),
        ("written", late(5), "scans later"),
        ("written", late(1), "1 scan later"),
        ("written", turned, "with the points turned by 90 degrees"),
        ("written", lambda poses: poses[::-1], ""),
        ("ground", mirrored, ""),
        ("ground", late(1), ""),
        ("ground", turned, ""),
    ],
)
def test_poses_that_the_scans_contradict(
    tmp_path: Path, request: pytest.FixtureRequest, kind: str, change: Callable[[FloatArray], FloatArray], words: str
) -> None:
    text = with_poses(request.getfixturevalue(kind), tmp_path / "street", change(streets.poses()))
    assert "the scans do not move as the poses do" in text
    assert words in text


@pytest.mark.parametrize(
    ("kind", "factor"),
    [*(("written", factor) for factor in (0.7, 0.9, 1.1, 1.2, 1.5)), ("ground", 0.7), ("ground", 1.1)],
)
def test_a_wrong_scale_is_told_by_its_number(
    tmp_path: Path, request: pytest.FixtureRequest, kind: str, factor: float
) -> None:
    text = with_poses(request.getfixturevalue(kind), tmp_path / "street", scaled(factor)(streets.poses()))
    (found,) = re.findall(r"The poses move (\d\.\d\d) times as far as the scans", text)
    assert float(found) == pytest.approx(factor, rel=0.05)


@pytest.mark.parametrize(("text", "is_told"), [("{:.6e}", True), ("{:.9e}", False)])
def test_projected_poses_of_few_digits_are_told(tmp_path: Path, written: Path, text: str, is_told: bool) -> None:
    streets.linked(written, tmp_path / "street")
    poses = streets.poses().copy()
    poses[:, :2, 3] += [456_789.3, 5_428_123.4]
    lines = (" ".join(map(text.format, pose[:3].ravel())) for pose in poses)
    (tmp_path / "street" / "poses.txt").write_text("\n".join(lines))
    told = " ".join(each.message for each in inspect_drive(tmp_path / "street").problems)
    assert ("grid of half a metre" in told) == is_told


@pytest.mark.parametrize("is_computed", [False, True])
def test_where_road_is_all_there_is_the_scale_cannot_be_told(tmp_path: Path, ground: Path, is_computed: bool) -> None:
    """In front of the result, but where the poses were computed from the points."""
    shutil.copytree(ground, tmp_path / "road")
    for file in (tmp_path / "road" / "labels").iterdir():
        labels = np.fromfile(file, np.uint32)
        np.where(labels == 40, 40, 50).astype(np.uint32).tofile(file)
    drive = open_drive(tmp_path / "road", check=False)
    findings = Findings(stop_at_first=False)
    check_scan_motion(drive, drive.scans.usable, "poses.txt", findings, is_computed=is_computed)
    told = [(found.severity, "scale of the poses is right cannot be told" in found.message) for found in findings.found]
    assert told == ([] if is_computed else [("warning", True)])


@pytest.mark.parametrize(
    ("kind", "rows"),
    [
        *(("written", rows) for rows in (slice(0, 100), slice(0, 30), slice(25, 70), slice(60, 100), slice(0, 100, 4))),
        ("ground", slice(0, 100)),
        ("ground", slice(25, 70)),
    ],
)
def test_a_sound_drive_is_sound_in_any_part(
    tmp_path: Path, request: pytest.FixtureRequest, kind: str, rows: slice
) -> None:
    source, path = request.getfixturevalue(kind), tmp_path / "part"
    for folder, suffix in (("velodyne", ".bin"), ("labels", ".label")):
        (path / folder).mkdir(parents=True)
        for number, frame in enumerate(range(100)[rows]):
            os.link(source / folder / f"{frame:06d}{suffix}", path / folder / f"{number:06d}{suffix}")
    (path / "poses.txt").write_text(streets.pose_text(streets.poses()[rows]))
    assert [p for p in inspect_drive(path).problems if p.severity != "note"] == []
