"""Bags: opened in all formats, with their times, poses and fixes; what is chosen, and what is refused."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode

import interloc
from interloc.drives.findings import Findings
from interloc.drives.options import DriveOptions
from interloc.drives.scans.recording import Recording
from interloc.drives.scans.rosbag.open import open_rosbag
from interloc.drives.trajectory import Trajectory
from interloc.errors import DriveError
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d, rotation_from_rpy, wrap_angle, yaw_of
from tests.bags import FORMATS, BagWriter, cells_of, write_bag
from tests.small_drives import level_poses, refusal_of

START = 1.6e9
COUNT = 12


def scans_of(count: int = COUNT, points: int = 30) -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [rng.normal(size=(points, 4)).astype(np.float32) for _ in range(count)]


def straight(count: int = COUNT, step_m: float = 1.0) -> np.ndarray:
    return level_poses(step_m * np.arange(count))


def times_of(count: int = COUNT, step_s: float = 0.1) -> list[float]:
    return [START + step_s * row for row in range(count)]


def opened(path: Path, **options: Any) -> tuple[Recording, Trajectory, Findings]:
    findings, chosen = Findings(stop_at_first=True), DriveOptions.of(None, **options)
    recording = open_rosbag(path, chosen, findings)
    return recording, recording.read_trajectory(recording.frames, chosen, findings), findings


refused = partial(refusal_of, opened)


def poses_of(trajectory: Trajectory) -> np.ndarray:
    return trajectory.poses.T_world_lidar


def said(findings: Findings) -> str:
    return "\n".join(f"{each.severity}: {each.message}" for each in findings.found)


IN_ALL_FORMS = pytest.mark.parametrize(
    ("form", "compression"),
    [
        ("bag", None),
        ("bag", (Writer1.CompressionFormat.BZ2,)),
        ("bag", (Writer1.CompressionFormat.LZ4,)),
        ("db3", None),
        ("db3", (CompressionMode.MESSAGE, CompressionFormat.ZSTD)),
        ("mcap", None),
        ("mcap", (CompressionMode.MESSAGE, CompressionFormat.ZSTD)),
        ("mcap", (CompressionMode.STORAGE, CompressionFormat.ZSTD)),
    ],
)


@IN_ALL_FORMS
def test_a_bag_gives_back_what_was_written(tmp_path: Path, form: str, compression: Any) -> None:
    scans, poses = scans_of(), straight()
    labels = [np.arange(30, dtype=np.uint32) + row for row in range(COUNT)]
    path = write_bag(tmp_path / "drive", form, scans, times_of(), labels=labels, poses=poses, compression=compression)
    recording, trajectory, _ = opened(path)
    assert recording.parts.layout == "rosbag"
    assert recording.parts.drive_name == "drive"
    assert recording.carries_labels
    assert recording.has_remission
    assert recording.frames.tolist() == list(range(COUNT))
    for frame in (5, 0, 11, 5):
        points = recording.points.read(frame)
        assert np.array_equal(points.values, scans[frame])
        assert np.array_equal(points.labels, labels[frame])
    assert np.allclose(poses_of(trajectory), poses, atol=1e-12)
    assert np.allclose(trajectory.times_s, times_of(), atol=1e-6)
    assert trajectory.georeference is None
    assert "no GNSS fixes" in trajectory.georeference_reason
    assert {(topic.name, topic.role, topic.messages) for topic in recording.topics} == {
        ("/odom", "poses", COUNT),
        ("/points", "points", COUNT),
    }


@pytest.mark.parametrize("form", FORMATS)
def test_scans_are_read_by_other_processes_and_several_threads(tmp_path: Path, form: str) -> None:
    scans = scans_of()
    bag = write_bag(tmp_path / "drive", form, scans, times_of(), poses=straight())
    file = bag if bag.is_file() else next(bag.glob(f"*.{form}"))
    recording, *_ = opened(file.rename(tmp_path / f"drive.{form.upper()}"))
    source = pickle.loads(pickle.dumps(recording.points))  # noqa: S301 - our own
    with ThreadPoolExecutor(4) as threads:
        read = list(threads.map(source.read, list(range(COUNT)) * 5))
    assert all(np.array_equal(points.values, scans[row % COUNT]) for row, points in enumerate(read))


# Poses and times


@pytest.mark.parametrize("form", FORMATS)
def test_poses_are_interpolated_and_moved_from_the_vehicle_to_the_lidar(tmp_path: Path, form: str) -> None:
    mount = np.eye(4)
    mount[:3, :3] = rotation_from_rpy(0.0, 0.1, 0.5)
    mount[:3, 3] = 1.2, 0.0, 1.8
    target = tmp_path / ("drive.bag" if form == "bag" else "drive")
    rows = np.arange(COUNT)
    vehicle = level_poses(rows, 0.0, 0.2 * rows)
    with BagWriter(target, form) as bag:
        for known in (np.eye(4), mount):  # the last one holds
            bag.transforms("/tf_static", START, {("base_link", "velodyne"): known})
        for row in range(COUNT):
            bag.odometry("/odom", START + row, vehicle[row], child="base_link")
            if row < COUNT - 1:
                bag.cloud("/points", START + row + 0.5, cells_of(scans_of()[row]))
    recording, trajectory, findings = opened(target)
    between = level_poses(rows[:-1] + 0.5, 0.0, 0.2 * rows[:-1] + 0.1)
    expected = np.linalg.inv(between[0] @ mount) @ between @ mount
    assert np.allclose(poses_of(trajectory), expected, atol=1e-6)
    assert "warning" not in said(findings)
    assert {topic.name: topic.role for topic in recording.topics}["/tf_static"] == "extrinsics"


def test_transforms_lead_from_the_points_to_the_fixed_frame(tmp_path: Path) -> None:
    mount, poses = np.eye(4), straight()
    mount[:3, 3] = 0.5, 0.0, 2.0
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        bag.transforms("/tf_static", START, {("base_link", "velodyne"): mount, ("map", "odom"): np.eye(4)})
        for row, time in enumerate(times_of()):
            bag.transforms("/tf", time, {("odom", "base_link"): poses[row], ("base_link", "wheel"): poses[row]})
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    recording, trajectory, _ = opened(tmp_path / "drive")
    assert np.allclose(poses_of(trajectory), poses, atol=1e-9)
    assert "map -> odom -> base_link -> velodyne" in trajectory.poses.reason
    assert {topic.name: topic.role for topic in recording.topics} == {
        "/points": "points",
        "/tf": "poses",
        "/tf_static": "extrinsics",
    }


def test_an_unknown_mount_is_taken_as_none_with_a_warning(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "db3") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight()[row], child="base_link")
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    _, trajectory, findings = opened(tmp_path / "drive")
    assert np.allclose(poses_of(trajectory), straight())
    assert "warning: the poses of /odom are those of base_link, the points are in velodyne" in said(findings)


def test_a_split_bag_is_one_drive_and_static_transforms_are_in_its_first_part(tmp_path: Path) -> None:
    mount = level_poses(0.0, 0.0, np.pi / 2)
    folder = tmp_path / "drive"
    folder.mkdir()
    for part in range(11):  # 10 comes after 9, not after 1
        with BagWriter(tmp_path / f"part{part}", "db3") as bag:
            if part == 0:
                bag.transforms("/tf_static", START, {("base_link", "velodyne"): mount})
            bag.odometry("/odom", START + part, straight()[part], child="base_link")
            bag.cloud("/points", START + part, cells_of(scans_of()[part]))
        (tmp_path / f"part{part}/part{part}.db3").rename(folder / f"drive_{part}.db3")
    recording, trajectory, _ = opened(folder)
    assert len(recording.frames) == 11
    assert np.allclose(poses_of(trajectory)[:, 1, 3], -np.arange(11), atol=1e-9)  # to the right of a turned LiDAR
    assert np.array_equal(recording.points.read(10).values, scans_of()[10])
    assert recording.points.name(10) == "drive_10.db3, /points, message 10"
    parts = [f"  - drive_{part}.db3\n" for part in range(11)]
    (folder / "metadata.yaml").write_text("".join(["  relative_file_paths:\n", *parts]))
    (folder / "drive_5.db3").unlink()
    with pytest.raises(DriveError, match=r"metadata\.yaml: names drive_5\.db3, which is missing"):
        opened(folder)


def test_scans_without_a_pose_are_left_out_and_keep_their_numbers(tmp_path: Path) -> None:
    path = write_bag(
        tmp_path / "drive", "mcap", scans_of(), times_of(), poses=straight()[3:10], pose_times=times_of()[3:10]
    )
    recording, trajectory, findings = opened(path)
    assert recording.frames.tolist() == [3, 4, 5, 6, 7, 8, 9]
    assert np.allclose(poses_of(trajectory), straight(7))
    assert np.array_equal(recording.points.read(4).values, scans_of()[4])
    with pytest.raises(DriveError, match="holds no scan 1"):
        recording.points.read(1)
    assert "5 of 12 scans are left out" in said(findings)


def test_scans_in_a_long_gap_of_the_poses_are_left_out(tmp_path: Path) -> None:
    times = times_of(step_s=1.0)
    kept = [0, 1, 2, 3, 8, 9, 10, 11]
    path = write_bag(
        tmp_path / "drive", "bag", scans_of(), times, poses=straight()[kept], pose_times=[times[row] for row in kept]
    )
    recording, *_ = opened(path)
    assert recording.frames.tolist() == kept


def odd_stamps(path: Path, stamps: list[float]) -> Path:
    with BagWriter(path, "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight()[row])
            bag.cloud("/points", time, cells_of(scans_of()[row]), header_s=stamps[row])
    return path


def test_scans_are_numbered_by_their_stamps(tmp_path: Path) -> None:
    stamps = times_of()
    stamps[4], stamps[7] = stamps[7], stamps[4]
    recording, trajectory, findings = opened(odd_stamps(tmp_path / "drive", stamps))
    assert np.array_equal(recording.points.read(4).values, scans_of()[7])
    assert np.allclose(poses_of(trajectory), straight(), atol=1e-5)
    assert "run backwards 2 times" in said(findings)


SINCE_BOOT = [100.0 + time - START for time in times_of()]


@pytest.mark.parametrize(("stamps", "words"), [
    ([0.0] * COUNT, "the times at which they were recorded are used"),
    ([1234.5] * COUNT, "the times at which they were recorded are used"),
    (SINCE_BOOT, "without time synchronisation"),
])  # fmt: skip
def test_stamps_that_were_not_set_or_are_of_another_clock(tmp_path: Path, stamps: list[float], words: str) -> None:
    recording, trajectory, findings = opened(odd_stamps(tmp_path / "drive", stamps))
    assert len(recording.frames) == COUNT
    assert np.allclose(poses_of(trajectory), straight(), atol=1e-5)
    assert words in said(findings)


# Fixes


def drive_with_fixes(
    path: Path, *, noise_m: float = 0.0, drift: float = 0.0, antenna: Any = None, written: Any = None, count: int = 200
) -> Any:
    """Write a drive along an S of 400 m; return the bag and the true position and heading of every scan."""
    rng = np.random.default_rng(5)
    distance = 2.0 * np.arange(count)
    heading = 0.7 + 1.2 * np.sin(distance / 80.0)
    steps = 2.0 * np.column_stack([np.cos(heading), np.sin(heading)])
    enu = np.concatenate([[[0.0, 0.0]], np.cumsum(steps[:-1], axis=0)])
    turned = drift * distance
    odometry_heading = heading - heading[0] + turned
    moved = 2.0 * np.column_stack([np.cos(odometry_heading), np.sin(odometry_heading)])
    poses = level_poses(*np.cumsum([[0.0, 0.0], *moved[:-1]], axis=0).T, odometry_heading)
    lever = np.zeros(3) if antenna is None else antenna[:3, 3]
    at_antenna = enu + rotate_2d(lever[:2], heading)
    lonlat = lonlat_from_enu(49.0, 8.4, at_antenna + rng.normal(0, noise_m, enu.shape) if noise_m else at_antenna)
    with BagWriter(path, "mcap") as bag:
        if antenna is not None:
            bag.transforms("/tf_static", START, {("velodyne", "gnss"): antenna})
        for row in range(count):
            time = START + 0.2 * row
            bag.odometry("/odom", time, poses[row])
            bag.cloud("/points", time, cells_of(scans_of(1, 5)[0]))
            if row % 5 == 0:
                position = (lonlat[row, 1], lonlat[row, 0], 110.0 + lever[2])
                bag.fix("/fix", time, position) if written is None else written(bag, time, position)
            if row % 50 == 1:
                bag.fix("/fix", time, (np.nan, np.nan, np.nan))
                bag.fix("/fix", time + 0.01, (48.0, 8.0, 0.0), status=-1)
    return path, enu, heading


def places_of(trajectory: Trajectory) -> np.ndarray:
    """Return (N, 2) east and north of the scans of `drive_with_fixes`, by the georeference that was found."""
    found = trajectory.georeference
    return enu_from_lonlat(49.0, 8.4, np.stack([found.lon_deg, found.lat_deg], axis=-1))


@pytest.mark.parametrize(("settings", "metres", "degrees"), [
    ({}, 0.01, 0.02),
    ({"drift": 2e-4}, 0.4, 0.8),
    ({"noise_m": 0.5}, 0.6, 1.5),
    ({"antenna": -1.0}, 0.01, 0.02),
    ({"antenna": -2.5}, 0.01, 0.02),
])  # fmt: skip
def test_fixes_and_motion_make_a_georeference(
    tmp_path: Path, settings: dict[str, Any], metres: float, degrees: float
) -> None:
    if "antenna" in settings:
        ahead_m, settings = settings["antenna"], {"antenna": np.eye(4)}
        settings["antenna"][:3, 3] = ahead_m, 0.4, 0.3
    path, enu, heading = drive_with_fixes(tmp_path / "drive", **settings)
    _, trajectory, _ = opened(path)
    found = trajectory.georeference
    assert np.linalg.norm(places_of(trajectory) - enu, axis=1).max() < metres
    assert np.degrees(np.abs(wrap_angle(yaw_of(found.R_enu_lidar) - heading))).max() < degrees
    assert np.allclose(found.alt_m, 110.0, atol=0.01)


@pytest.mark.parametrize(("written", "words"), [
    (lambda bag, time, p: bag.fix("/fix", time, (p[1], p[0], p[2])), "latitude and longitude are exchanged"),
    (lambda bag, time, p: bag.fix("/fix", time, (p[0] * 1e7, p[1] * 1e7, p[2])), "multiples of 1e-7 degrees"),
    (lambda bag, time, p: bag.fix("/fix", time, (p[0], p[1] - 360.0, p[2])), ""),
    (lambda bag, time, p: bag.fix("/fix", time, p, status=-2), ""),
])  # fmt: skip
def test_fixes_in_other_forms_are_read_as_what_they_are(tmp_path: Path, written: Any, words: str) -> None:
    path, enu, _ = drive_with_fixes(tmp_path / "drive", written=written)
    _, trajectory, findings = opened(path)
    assert np.linalg.norm(places_of(trajectory) - enu, axis=1).max() < 0.01
    assert words in said(findings)
    assert bool(words) == any(each.severity == "warning" and "/fix" in each.message for each in findings.found)


@pytest.mark.parametrize("count", [30, 45, 60])
def test_exchanged_fixes_of_one_bend_are_read_the_other_way_round(tmp_path: Path, count: int) -> None:
    def exchanged(bag: BagWriter, time: float, position: tuple[float, float, float]) -> None:
        bag.fix("/fix", time, (position[1], position[0], position[2]))

    path, enu, _ = drive_with_fixes(tmp_path / "drive", written=exchanged, noise_m=0.3, count=count)
    assert np.linalg.norm(places_of(opened(path)[1]) - enu, axis=1).max() < 1.0


def test_fixes_in_metres_are_named(tmp_path: Path) -> None:
    path, *_ = drive_with_fixes(tmp_path / "drive", written=lambda bag, time, _: bag.fix("/fix", time, (5.4e6, 4e5, 1)))
    assert "metres of UTM" in opened(path)[1].georeference_reason


@pytest.mark.parametrize(("fixes", "reason"), [
    ([(START, (49.0, 8.0, 0.0))], "1 of 1 fixes have a position while the pose is known"),
    ([(time, (np.nan, 8.0, 0.0)) for time in times_of()], "none of 12 fixes has a position"),
    ([(time, (49.0, 8.0, 0.0)) for time in times_of()], "the fixes reach over 0.0 m"),
    ([(time + 100, (49.0, 8.0, 0.0)) for time in times_of()], "0 of 12 fixes have a position"),
    ([(time, (49.0 + 1e-4 * row**2, 8.0, 0.0)) for row, time in enumerate(times_of())], "another motion"),
])  # fmt: skip
def test_fixes_that_show_no_heading_make_no_georeference(tmp_path: Path, fixes: Any, reason: str) -> None:
    _, trajectory, _ = opened(
        write_bag(tmp_path / "drive", "db3", scans_of(), times_of(), poses=straight(step_m=3.0), fixes=fixes)
    )
    assert trajectory.georeference is None
    assert reason in trajectory.georeference_reason
    assert trajectory.poses is not None


# Topics


def test_the_topic_with_labels_is_chosen_and_the_option_overrules_it(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight()[row])
            bag.cloud("/raw", time, cells_of(scans_of()[row]))
            bag.cloud("/labelled", time, cells_of(scans_of()[row][:9], np.ones(9)))
            bag.cloud("/registered", time, cells_of(scans_of(points=90)[row]), frame="odom")
    recording, _, findings = opened(tmp_path / "drive")
    assert recording.carries_labels
    assert "the scans are taken from /labelled" in said(findings)
    recording, *_ = opened(tmp_path / "drive", points="/raw")
    assert not recording.carries_labels
    message = refused(tmp_path / "drive", points="/odom")
    assert "'/odom' is of type nav_msgs/msg/Odometry" in message
    assert "/raw (12 messages)" in message
    assert "is not in the bag" in refused(tmp_path / "drive", points="/nothing")
    assert "--poses can name: /odom (12 messages)" in refused(tmp_path / "drive", poses="/nothing")
    assert "--fix can name: none" in refused(tmp_path / "drive", fix="/nothing")
    assert "the fixed frame of /odom" in refused(tmp_path / "drive", points="/registered")


def test_two_topics_that_are_as_good_are_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive.bag", "bag") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight()[row])
            bag.cloud("/left", time, cells_of(scans_of()[row]))
            bag.cloud("/right", time, cells_of(scans_of()[row]))
    assert "--points /" in refused(tmp_path / "drive.bag")
    recording, *_ = opened(tmp_path / "drive.bag", points="right")
    assert {topic.name: topic.role for topic in recording.topics}["/right"] == "points"


def test_raw_packets_are_refused_with_their_driver(tmp_path: Path) -> None:
    with Writer1(tmp_path / "drive.bag") as writer:
        connection = writer.add_connection(
            "/packets", "velodyne_msgs/msg/VelodyneScan", msgdef="std_msgs/Header header", md5sum="0" * 32
        )
        writer.write(connection, 5, b"")
    message = refused(tmp_path / "drive.bag")
    assert "raw packets of the sensor (velodyne_msgs/msg/VelodyneScan)" in message
    assert "velodyne_pointcloud" in message


def test_types_that_nobody_knows_do_not_matter(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive.bag", "bag") as bag:
        strange = bag.writer.add_connection(
            "/strange", "of_us/msg/Strange", msgdef="never/Heard of this\nthat[ 3", md5sum="0" * 32
        )
        for row, time in enumerate(times_of()):
            bag.writer.write(strange, round(time * 1e9), b"\xff" * 9)
            bag.odometry("/odom", time, straight()[row])
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    recording, *_ = opened(tmp_path / "drive.bag")
    assert len(recording.frames) == COUNT


def test_a_bag_without_poses_says_so_and_lists_its_topics(tmp_path: Path) -> None:
    path = write_bag(
        tmp_path / "drive", "mcap", scans_of(), times_of(), fixes=[(time, (49.0, 8.0, 0.0)) for time in times_of()]
    )
    message = refused(path)
    assert "holds no poses. It has GNSS fixes" in message
    assert "/points (sensor_msgs/msg/PointCloud2, 12)" in message
    findings = Findings(stop_at_first=False)
    recording = open_rosbag(path, DriveOptions(), findings)
    assert recording.read_trajectory(recording.frames, DriveOptions(), findings).poses is None
    assert {topic.name: topic.role for topic in recording.topics} == {"/points": "points", "/fix": "fix"}
    assert [each.severity for each in findings.found] == ["error"]


def test_poses_may_come_from_a_file(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "drive", "mcap", scans_of(), times_of())
    lines = [f"{time:.6f} {row} 0 0 0 0 0 1" for row, time in enumerate(times_of())]
    (tmp_path / "poses.tum").write_text("\n".join(lines) + "\n")
    _, trajectory, _ = opened(path, poses=str(tmp_path / "poses.tum"))
    assert np.allclose(poses_of(trajectory), straight(), atol=1e-5)


def test_poses_of_no_use_are_passed_over(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            lost = straight()[row]
            lost[:3, 3] = np.nan
            bag.odometry("/gps/odom", time, lost, child="base_link")
            bag.odometry("/gps/odom", time + 0.01, lost, child="base_link")
            bag.pose_stamped("/slam", time, straight()[row])
            bag.cloud("/points", time, cells_of(scans_of()[row]))
    _, trajectory, findings = opened(tmp_path / "drive")
    assert np.allclose(poses_of(trajectory), straight())
    assert "none of 24 poses is one" in said(findings)
    assert "the poses are taken from /slam" in said(findings)
    assert "without a frame of their own" in said(findings)


def labelled_bag(path: Path, form: str, labels: list[np.ndarray]) -> Path:
    road = np.column_stack([np.random.default_rng(1).uniform(-20, 20, (400, 2)), np.full((400, 2), -1.7)])
    return write_bag(path, form, [road.astype(np.float32)] * COUNT, times_of(), labels=labels, poses=straight())


def test_a_lone_file_is_a_drive(tmp_path: Path) -> None:
    path = labelled_bag(tmp_path / "d", "bag", [np.repeat(np.array([40, 48], np.uint32), 200)] * COUNT)
    drive = interloc.open_drive(path)
    assert (drive.name, drive.layout, len(drive.frames)) == ("d", "rosbag", COUNT)
    assert len(drive.ground_points(3).road) == 200
    report = interloc.inspect_drive(path)
    assert report.ok
    assert {topic.name: topic.role for topic in report.topics} == {"/odom": "poses", "/points": "points"}


def test_scans_whose_points_have_no_label_are_counted(tmp_path: Path) -> None:
    labels = [np.full(400, 40 if row else 0, np.uint32) for row in range(COUNT)]
    report = interloc.inspect_drive(labelled_bag(tmp_path / "d", "mcap", labels))
    assert any("1 of 5 scans looked at have no label" in each.message for each in report.problems)


def test_a_missing_package_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_bag(tmp_path / "drive", "db3", scans_of(), times_of(), poses=straight())
    find = util.find_spec
    monkeypatch.setattr(
        "interloc.drives.scans.rosbag.bag.find_spec", lambda name: None if name == "rosbags" else find(name)
    )
    assert '"rosbags>=' in refused(path)


def test_fixes_of_another_clock_are_put_right(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "drive", "mcap") as bag:
        for row, time in enumerate(times_of()):
            bag.odometry("/odom", time, straight(step_m=3.0)[row])
            bag.cloud("/points", time, cells_of(scans_of()[row]))
            bag.fix("/fix", time, (49.0, 8.0 + 4e-5 * row, 100.0), header_s=time - START + 5.0)
    _, trajectory, findings = opened(tmp_path / "drive")
    assert np.allclose(yaw_of(trajectory.georeference.R_enu_lidar), 0.0, atol=1e-3)
    assert "the fixes are put right by that. Usual cause: a LiDAR or receiver without time" in said(findings)
