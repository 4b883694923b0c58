"""Drives whose poses are computed from their points."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.drives import odometry as module
from interloc.drives.findings import Findings
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import DriveReading, open_drive, read_drive
from interloc.drives.options import DriveOptions
from interloc.drives.trajectory import Trajectory
from interloc.errors import DriveError
from interloc.geometry import invert_transform
from interloc.reduction.convert import write_poses
from tests.bags import BagWriter
from tests.street_points import TURN_S, poses_along, seen, seen_driving, street, write_scans

pytest.importorskip("small_gicp", reason="poses from points need small_gicp")


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for each test."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    return folder


def reading_of(root: Path, findings: Findings | None = None) -> DriveReading:
    options = DriveOptions.of(poses="odometry")
    (reading,) = read_drive(root, options, findings or Findings(stop_at_first=True), needs_labels=False).values()
    return reading


def trajectory_of(root: Path) -> Trajectory:
    return reading_of(root).trajectory


def test_scans_alone_make_a_drive(tmp_path: Path) -> None:
    poses = poses_along(np.full(5, 1.5), turn_rad=0.02)
    root = write_scans(tmp_path / "drive", [seen(street(), pose) for pose in poses])
    for row in range(6):
        (root / "labels").mkdir(exist_ok=True)
        count = len(np.fromfile(root / f"velodyne/{row:06d}.bin", np.float32)) // 4
        np.full(count, 40, np.uint32).tofile(root / f"labels/{row:06d}.label")
    drive = open_drive(root, poses="odometry", check=False)
    assert (drive.pose_frame, drive.pose_frame_reason) == ("lidar", "odometry over the points of 6 scans")
    np.testing.assert_allclose(drive.T_world_lidar, invert_transform(poses[0]) @ poses, atol=0.05)
    (root / "poses_slam.txt").touch()
    assert any("Not read: poses_slam.txt" in problem.message for problem in inspect_drive(root).problems)


def test_a_track_is_computed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scans = [seen(street(), pose) for pose in poses_along(np.full(2, 1.5))]
    root = write_scans(tmp_path / "drive", scans)
    first = trajectory_of(root)
    monkeypatch.setattr(module, "Odometry", None)
    np.testing.assert_array_equal(trajectory_of(root).poses.T_world_lidar, first.poses.T_world_lidar)
    (root / "velodyne/000001.bin").write_bytes((root / "velodyne/000001.bin").read_bytes()[:-160])
    with pytest.raises(TypeError):  # other scans are followed anew
        trajectory_of(root)


def test_scans_far_apart_are_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = write_scans(tmp_path / "drive", [seen(street(), pose) for pose in poses_along(np.full(3, 14.0))])
    monkeypatch.setattr(module, "Odometry", None)
    with pytest.raises(DriveError, match=r"the scans lie about 14 m apart.*Give all scans"):
        trajectory_of(root)


def test_a_lost_track_is_told_with_its_place(tmp_path: Path) -> None:
    poses = poses_along(np.array([1.0, 1.0, 14.0]))
    root = write_scans(tmp_path / "drive", [seen(street(), pose) for pose in poses])
    report = inspect_drive(root, poses="odometry")
    assert report.scans == 4
    messages = {problem.path: problem.message for problem in report.problems if problem.severity == "error"}
    assert messages["velodyne/000003.bin"].startswith("the odometry lost track here, after 3 scans and 2 m: it ")


def write_broken(root: Path) -> Path:
    """Five scans in one street, 12 in another, as if those between were missing; labelled, and placed by geo.csv."""
    ways = [(street(), poses_along(np.full(4, 1.0))), (street(1)[:, [1, 0, 2]], poses_along(np.full(11, 2.0)))]
    ways[1][1][:, :3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    ways[1][1][:, :2, 3] = ways[1][1][:, 1::-1, 3]
    write_scans(root, [seen(world, pose) for world, poses in ways for pose in poses])
    rows = "".join(f"{row},49.0,{8.0 + row * 2.72e-5:.7f},100,0,0,0\n" for row in range(17))
    (root / "geo.csv").write_text(f"frame,lat_deg,lon_deg,alt_m,roll_rad,pitch_rad,yaw_rad\n{rows}")
    return root


def test_the_parts_before_and_after_a_break_are_named_and_can_be_followed(tmp_path: Path) -> None:
    broken = write_broken(tmp_path / "drive")
    with pytest.raises(DriveError, match=r"000005\.bin: the odometry lost track.*--frames 0:5 .*--frames 5: "):
        write_poses(broken, tmp_path / "poses.txt")
    assert not (tmp_path / "poses.txt").exists()
    findings = Findings(stop_at_first=True)
    options = DriveOptions.of(poses="odometry", frames="5:")
    (reading,) = read_drive(broken, options, findings, needs_labels=False).values()
    assert reading.drive is None  # it has no labels
    assert reading.trajectory.poses.reason == "odometry over the points of 12 scans"
    assert reading.scans.frames.tolist() == list(range(5, 17))
    assert [each for each in findings.found if each.severity == "warning"] == []
    np.testing.assert_allclose(reading.trajectory.georeference.lon_deg, 8.0 + np.arange(5, 17) * 2.72e-5, atol=1e-7)


def write_bag_of(path: Path, *, speed_mps: float, scans: int = 6, is_bent: bool = True) -> Path:
    """A bag of points with times, without any poses."""
    poses = poses_along(np.full(scans - 1, speed_mps * TURN_S))
    with BagWriter(path, "mcap") as bag:
        for row, pose in enumerate(poses):
            xyz, times_s = seen_driving(street(), pose, speed_mps)
            xyz = xyz if is_bent else seen(street(), pose)
            cells = np.zeros(len(xyz), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("t", "u4")])
            for column, name in enumerate("xyz"):
                cells[name] = xyz[:, column]
            cells["t"] = times_s * 1e9
            bag.cloud("/points", 1000.0 + TURN_S * row, cells, frame="lidar")
    return path


def test_motion_within_scans_is_found_and_taken_out(tmp_path: Path) -> None:
    root = write_bag_of(tmp_path / "bag", speed_mps=18.0)
    findings = Findings(stop_at_first=True)
    reading = reading_of(root, findings)
    assert reading.trajectory.poses.reason == "odometry over the points of 6 scans, deskewed"
    assert reading.trajectory.poses.length_m == pytest.approx(9.0, abs=0.1)
    assert any("motion within each scan is taken out" in finding.message for finding in findings.found)
    here = reading.scans.recording.points.read(3).values[:, :3]
    np.testing.assert_allclose(here, seen(street(), poses_along(np.full(3, 1.8))[3]), atol=0.1)


def test_motion_that_was_taken_out_before_stays_out(tmp_path: Path) -> None:
    root = write_bag_of(tmp_path / "bag", speed_mps=18.0, is_bent=False)
    findings = Findings(stop_at_first=True)
    reading = reading_of(root, findings)
    assert reading.trajectory.poses.reason == "odometry over the points of 6 scans"
    assert any("taken out before" in finding.message for finding in findings.found)
    np.testing.assert_array_equal(
        reading.scans.recording.points.read(2).values[:, :3], seen(street(), poses_along(np.full(2, 1.8))[2])
    )


def test_real_scans_go_where_their_poses_say(data: Callable[[str], Path]) -> None:
    root = data("semantickitti_mini/sequences/00")
    found, given = trajectory_of(root).poses, open_drive(root, check=False).T_world_lidar
    assert np.linalg.norm(found.T_world_lidar[:, :3, 3] - given[:, :3, 3], axis=1).max() < 0.1


def test_a_real_drive_at_speed_has_no_slip_at_its_start(data: Callable[[str], Path], tmp_path: Path) -> None:
    drive = data("kitti_raw_0926_0001")
    for scan in sorted(drive.glob("*.laz"))[:4]:
        (tmp_path / scan.name).symlink_to(scan)
    found = trajectory_of(tmp_path).poses
    given = open_drive(drive, check=False).T_world_lidar[:4]
    np.testing.assert_allclose(found.steps_m, np.linalg.norm(np.diff(given[:, :3, 3], axis=0), axis=1), atol=0.15)


def test_without_a_home_tracks_are_kept_for_the_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    root = write_scans(tmp_path / "drive", [seen(street(), pose) for pose in poses_along(np.full(2, 1.5))])
    assert trajectory_of(root).poses is not None
