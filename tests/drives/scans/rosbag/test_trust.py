"""What a bag says is not taken on trust: clocks, owners of poses, frames of scans, rare transforms, poor fixes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.inspect import inspect_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.rosbag.bag import open_bag, why_no_fixes
from interloc.drives.scans.rosbag.open import open_rosbag
from interloc.errors import DriveError
from tests.bags import BagWriter, cells_of, write_bag
from tests.drives.scans.rosbag.test_open import (
    COUNT,
    START,
    drive_with_fixes,
    opened,
    places_of,
    poses_of,
    refused,
    said,
    scans_of,
    straight,
    times_of,
)
from tests.small_drives import level_poses


@pytest.mark.parametrize(("ahead_s", "words"), [
    (37.0, "TAI, as PTP gives it, is 37 s ahead"),
    (-37.0, "TAI"),
    (18.0, "GPS time is 18 s ahead"),
    (7200.0, "time zone"),
    (3.4, "not synchronised"),
])  # fmt: skip
def test_a_clock_that_is_ahead_is_put_right(tmp_path: Path, ahead_s: float, words: str) -> None:
    """Poses last long enough that wrong times have poses, too."""
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row in range(-50, 50):
            bag.odometry("/odom", START + row, level_poses(0.5 * row**2))
        for row in range(COUNT):
            bag.cloud("/points", START + row + 0.02, cells_of(scans_of()[row]), header_s=START + row + ahead_s)
    _, trajectory, findings = opened(tmp_path / "drive")
    assert words in said(findings)
    assert np.allclose(poses_of(trajectory)[:, 0, 3], 0.5 * np.arange(COUNT) ** 2, atol=0.7)


def test_poses_that_were_recorded_late_are_left_as_they_are(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time + 2.5, straight()[row], header_s=time)
            bag.cloud("/points", time + 0.02, cells_of(scans_of()[row]), header_s=time)
    _, trajectory, findings = opened(tmp_path / "drive")
    assert "clock" not in said(findings)
    assert np.allclose(poses_of(trajectory), straight())


@pytest.mark.parametrize(
    ("stamped_s", "recorded_s", "off_m", "words"),
    [
        (18.0, 0.0, 0.01, "GPS time is 18 s ahead"),
        # Recorded late, too: only the shape of the path tells, to 0.1 s.
        (2.0, 2.0, 1.0, "s late against the poses"),
        (-1.5, -1.5, 1.0, "s early against the poses"),
        (0.5, 0.5, 1.0, "s late against the poses"),
    ],
)
def test_fixes_of_another_time_are_put_right(
    tmp_path: Path, stamped_s: float, recorded_s: float, off_m: float, words: str
) -> None:
    def written(bag: BagWriter, time: float, p: Any) -> None:
        bag.fix("/fix", time + recorded_s, p, header_s=time + stamped_s)

    path, enu, _ = drive_with_fixes(tmp_path / "drive", written=written)
    _, trajectory, findings = opened(path)
    assert np.linalg.norm(places_of(trajectory) - enu, axis=1).max() < off_m
    assert words in said(findings)


def test_fixes_that_stand_still_are_left_out(tmp_path: Path) -> None:
    frozen: dict[str, Any] = {}

    def written(bag: BagWriter, time: float, p: Any) -> None:
        stands = 12.0 <= time - START < 24.0
        bag.fix("/fix", time, frozen.setdefault("at", p) if stands else p)

    path, enu, _ = drive_with_fixes(tmp_path / "drive", written=written)
    _, trajectory, findings = opened(path)
    assert np.linalg.norm(places_of(trajectory) - enu, axis=1).max() < 0.1
    assert "11 of 40 fixes stand still while the vehicle drives (12.0 to 23.0 s, " in said(findings)


def test_transforms_come_before_poses_without_an_owner(tmp_path: Path) -> None:
    mount = np.diag([-1.0, -1.0, 1.0, 1.0])
    mount[:3, 3] = 1.2, 0.0, 1.9
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        bag.transforms("/tf_static", START, {("base_link", "velodyne"): mount})
        for row, time in enumerate(times_of()):
            body = straight()[row] @ np.linalg.inv(mount)
            bag.pose_stamped("/ndt_pose", time, body)
            bag.transforms("/tf", time, {("map", "base_link"): body})
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    _, trajectory, _ = opened(tmp_path / "drive")
    assert np.allclose(poses_of(trajectory), straight(), atol=1e-9)
    assert "/tf" in trajectory.poses.reason


def test_transforms_that_change_rarely_hold_until_the_next(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for time in (START, START + 7.5):
            bag.transforms("/tf", time, {("map", "odom"): np.eye(4)})
        for row, time in enumerate(times_of()):
            bag.transforms("/tf", time, {("odom", "velodyne"): straight()[row]})
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    _, trajectory, findings = opened(tmp_path / "drive")
    assert np.allclose(poses_of(trajectory), straight(), atol=1e-9)
    assert "warning" not in said(findings)


def test_one_scan_of_many_is_no_drive(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.cloud("/points", time, cells_of(scans_of()[row]))
        for row, time in enumerate((START - 6.0, START, START + 60.0)):
            bag.odometry("/odom", time, straight()[row])
    assert "11 of 12 scans are left out" in refused(tmp_path / "drive")


def test_a_mounting_that_jitters_is_fixed(tmp_path: Path) -> None:
    mount = np.eye(4)
    mount[:3, 3] = 1.2, 0.0, 1.7
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            mount[0, 3] += 1e-6
            bag.transforms("/tf", time, {("base_link", "velodyne"): mount})
            bag.odometry("/odom", time, straight()[row], child="base_link")
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    assert "no transform between the two" not in said(opened(tmp_path / "drive")[2])


def test_scans_of_two_sensors_on_one_topic_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight()[row], child="base_link")
            bag.cloud("/points", time, cells_of(scans_of()[row]), frame="left" if row % 2 else "front")
    assert "/points holds scans in 2 frames (front, left)" in refused(tmp_path / "drive")


def test_empty_scans_are_counted(tmp_path: Path) -> None:
    scans = scans_of()
    scans[2] = scans[3] = scans[0][:0]
    scans[9][:] = np.nan
    path = write_bag(tmp_path / "drive", "mcap", scans, times_of(), poses=straight())
    assert "3 of 12 scans of /points hold no points" in said(opened(path)[2])


def test_an_empty_scan_is_not_one_without_labels(tmp_path: Path) -> None:
    scans = [scans_of()[0][:0], *scans_of()[1:]]
    labels = [np.full(len(scan), 40, np.uint32) for scan in scans]
    path = write_bag(tmp_path / "drive", "mcap", scans, times_of(), poses=straight(), labels=labels)
    assert not [each for each in inspect_drive(path).problems if "no label" in each.message]


def test_the_uncertainty_of_fixes_counts(tmp_path: Path) -> None:
    """RTK falls back to a single fix for 30 m, 15 m off, and says so."""

    def written(bag: BagWriter, time: float, p: Any) -> None:
        poor = 18 < time - START < 21
        bag.fix("/fix", time, (p[0] + 1.35e-4 * poor, *p[1:]), status=0 if poor else 2, std_m=10.0 if poor else 0.02)

    path, enu, _ = drive_with_fixes(tmp_path / "drive", written=written)
    _, trajectory, _ = opened(path)
    off = np.linalg.norm(places_of(trajectory) - enu, axis=1)
    assert off.max() < 1.0
    found = trajectory.georeference
    assert (off < 3 * found.position_std_m + 0.1).all()


@pytest.mark.parametrize("is_unknown", [False, True])
def test_an_antenna_whose_place_is_not_known_widens_the_uncertainty(tmp_path: Path, is_unknown: bool) -> None:
    path, _, _ = drive_with_fixes(
        tmp_path / "drive",
        antenna=None if is_unknown else np.eye(4),
        written=lambda bag, time, p: bag.fix("/fix", time, p, status=2, std_m=0.02),
    )
    _, trajectory, findings = opened(path)
    std_m = trajectory.georeference.position_std_m
    assert ("where the antenna is on the vehicle is not known" in said(findings)) == is_unknown
    assert (std_m > 0.9).all() if is_unknown else (std_m < 0.5).all()


def test_a_jump_of_the_odometry_cuts_the_drive(tmp_path: Path) -> None:
    """After two thirds of the drive the odometry starts anew, somewhere else."""
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row in range(60):
            pose = level_poses(row) if row < 40 else level_poses(row - 40.0, 12.0)
            bag.odometry("/odom", START + 0.1 * row, pose, child="velodyne")
            bag.cloud("/points", START + 0.1 * row, cells_of(scans_of()[row % COUNT]))
    recording, trajectory, findings = opened(tmp_path / "drive")
    assert "jump: by 41 m after scan 39 (39 m on)" in said(findings)
    assert recording.frames.tolist() == list(range(40))
    assert np.allclose(poses_of(trajectory)[:, 0, 3], np.arange(40.0))


def test_the_next_topic_of_fixes_counts_where_the_first_has_none(tmp_path: Path) -> None:
    def written(bag: BagWriter, time: float, p: Any) -> None:
        for _ in range(2):
            bag.fix("/broken", time, (np.nan, np.nan, np.nan), status=-1)
        bag.fix("/gnss", time, p)

    path, *_ = drive_with_fixes(tmp_path / "drive", written=written)
    _, trajectory, findings = opened(path)
    assert trajectory.georeference.source.startswith("/gnss")
    assert "the fixes are taken from /gnss" in said(findings)


def test_a_flag_that_contradicts_the_points_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            cells = cells_of(scans_of()[row])
            bag.odometry("/odom", time, straight()[row])
            bag.cloud("/points", time, cells.astype(cells.dtype.newbyteorder(">")), data=np.frombuffer(cells, np.uint8))
    recording = opened(tmp_path / "drive")[0]
    with pytest.raises(DriveError, match="says is_bigendian = true"):
        recording.points.read(0)


def test_a_transform_without_a_rotation_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        with monkeypatch.context() as patch:
            patch.setattr("tests.bags.quaternions_from_rotations", lambda _: np.zeros((1, 4)))
            bag.transforms("/tf_static", START, {("base_link", "velodyne"): np.eye(4)})
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight()[row], child="base_link")
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    assert "base_link -> velodyne of the transforms has no rotation" in said(opened(tmp_path / "drive")[2])


def test_what_is_like_fixes_poses_and_labels_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive.bag", "bag") as bag:
        others = {"/nmea": "nmea_msgs/msg/Sentence", "/path": "nav_msgs/msg/Path"}
        for topic, kind in others.items():
            connection = bag.writer.add_connection(topic, kind, msgdef="string sentence", md5sum="0" * 32)
            bag.writer.write(connection, round(START * 1e9), b"\0" * 4)
        for row, time in enumerate(times_of()):
            cells = cells_of(scans_of()[row], np.full(30, 7))
            cells.dtype.names = ("x", "y", "z", "intensity", "ObjTag")
            bag.cloud("/points", time, cells)
    lines = [f"{time:.6f} {row} 0 0 0 0 0 1" for row, time in enumerate(times_of())]
    (tmp_path / "poses.tum").write_text("\n".join(lines) + "\n")
    findings = Findings(stop_at_first=False)
    assert open_rosbag(tmp_path / "drive.bag", DriveOptions(), findings) is not None
    assert "/path (nav_msgs/msg/Path) holds poses" in said(findings)
    assert "ObjTag, the labels of CARLA" in said(findings)
    bag_of = open_bag((SourceFile(tmp_path / "drive.bag", tmp_path),))
    assert "but /nmea (nmea_msgs/msg/Sentence), which is not read" in why_no_fixes(bag_of)


def test_scans_that_are_parts_of_a_turn_are_told(tmp_path: Path) -> None:
    angle = np.radians(np.arange(0.0, 360.0, 0.5))
    turn = np.column_stack([20 * np.cos(angle), 20 * np.sin(angle), np.full(720, -1.7), np.ones(720)])
    parts = np.array_split(turn.astype(np.float32), 8)
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row in range(48):
            bag.odometry("/odom", START + 0.0125 * row, np.eye(4) + 0.05 * row * np.eye(4, k=3))
            bag.cloud("/points", START + 0.0125 * row, cells_of(parts[row % 8], np.tile([40, 48], 45)))
    told = [each.message for each in inspect_drive(tmp_path / "drive").problems]
    assert any("a scan sees 50 degrees around" in each and "they see 360" in each for each in told)


@pytest.mark.parametrize(("wheels", "bends", "words"), [
    ("/odom", 0.01, "the poses are taken from /slam"),  # in a plane, while those of the other are not
    ("/wheel_odom", 0.0, "the poses are taken from /slam"),
    ("/odom", 0.0, "which poses are better cannot be told: on 26 m those of /odom and /slam part by"),
])  # fmt: skip
def test_odometry_of_wheels_comes_after_others(tmp_path: Path, wheels: str, bends: float, words: str) -> None:
    poses = straight(step_m=2.0)
    poses[:, 2, 3] = bends * np.arange(len(poses)) ** 2
    drifting = poses.copy()
    drifting[:, :3, 3] *= (1.2, 1.0, 0.0 if bends else 1.0)
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry(wheels, time, drifting[row])
            bag.odometry(wheels, time + 0.01, drifting[row])
            bag.odometry("/slam", time, poses[row])
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    assert words in said(opened(tmp_path / "drive")[2])
