"""The report on a drive: everything at a glance, and every problem."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.config import KeyframeConfig
from interloc.drives.inspect import DriveReport, inspect_drive
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.errors import ConfigError, DriveError
from interloc.geometry import invert_transform
from interloc.reduction.reduce import reduce_drive


def errors(report: DriveReport) -> dict[str, str]:
    return {problem.path: problem.message for problem in report.problems if problem.severity == "error"}


def test_sound_drive(sequence: Path) -> None:
    report = inspect_drive(sequence)
    assert report.ok
    assert report.problems == []
    assert (report.name, report.layout, report.scans, report.poses) == ("07", "semantickitti", 12, 12)
    assert (report.first_frame, report.last_frame, report.points_per_scan) == (0, 11, 1725)
    assert report.length_m == pytest.approx(22, abs=0.1)
    assert report.spacing_m == pytest.approx(2, abs=0.01)
    assert report.duration_s == pytest.approx(1.1)
    assert (report.pose_frame, report.label_scheme, report.label_folder) == ("camera", "semantickitti", "labels")
    assert report.road_share == pytest.approx(61 * 17 / 1725)
    assert report.georeference is None
    assert report.georeference_reason == "the drive has neither oxts/ nor geo.csv"
    assert report.flatness_m == pytest.approx(0, abs=1e-3)


def test_every_problem_is_listed(sequence: Path) -> None:
    for name in ("velodyne/000002.bin", "velodyne/000005.bin", "labels/000007.label"):
        path = sequence / name
        path.write_bytes(path.read_bytes()[:-6])
    (sequence / "labels" / "000009.label").unlink()
    (sequence / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1\n")
    (sequence / "geo.csv").write_text("frame\n")
    report = inspect_drive(sequence)
    assert not report.ok
    assert set(errors(report)) == {
        "velodyne/000002.bin",
        "velodyne/000005.bin",
        "labels/000007.label",
        "labels/000009.label",
        "poses.txt",
        "geo.csv",
    }
    assert report.road_share is not None
    assert "geo.csv" in report.georeference_reason


def test_thorough_reads_every_scan(sequence: Path) -> None:
    for name in ("000000", "000001"):  # the first is looked into in any case, and listed once
        path = sequence / "velodyne" / f"{name}.bin"
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        points[505, 0] = np.nan
        points.tofile(path)
    report = inspect_drive(sequence)
    assert (report.looked_into, len(report.problems)) == (5, 1)
    report = inspect_drive(sequence, thorough=True)
    assert report.looked_into == 12
    assert "velodyne/000001.bin" in errors(report)


def test_unknown_ids_are_listed(sequence: Path) -> None:
    for path in (sequence / "labels").iterdir():
        labels = np.fromfile(path, np.uint32)
        labels[:100] = 77
        labels.tofile(path)
    report = inspect_drive(sequence)
    assert report.unknown_ids == [77]
    assert [(problem.severity, problem.path) for problem in report.problems] == [("warning", "labels")]
    assert "(77)" in report.problems[0].message


def test_notes_and_warnings_come_after_errors(sequence: Path, make: ModuleType) -> None:
    (sequence / "poses.txt").write_text(make.pose_text(make.camera_poses(make.lidar_poses(20))))
    (sequence / "times.txt").write_text("0.0\n")
    (sequence / "labels" / "000009.label").unlink()
    severities = [problem.severity for problem in inspect_drive(sequence).problems]
    assert severities == ["error", "warning", "warning", "note"]


@pytest.mark.parametrize("kind", ["gone", "file", "empty", "scans only", "no scans"])
def test_nothing_raises(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "drive"
    if kind == "file":
        path.touch()
    elif kind != "gone":
        path.mkdir()
    if kind == "scans only":
        (path / "velodyne").mkdir()
        (path / "velodyne" / "000000.bin").write_bytes(b"\0" * 32)
    if kind == "no scans":
        (path / "velodyne").mkdir()
        (path / "labels").mkdir()
    report = inspect_drive(path)
    assert not report.ok
    json.dumps(report.to_dict())


def test_single_scan(tmp_path: Path, make: ModuleType) -> None:
    report = inspect_drive(make.write_semantickitti(tmp_path / "one", poses=make.lidar_poses(1)))
    assert report.ok
    assert report.spacing_m is None
    assert report.pose_frame == "camera"


def test_without_poses_they_are_computed_from_the_points(tmp_path: Path, data: Callable[[str], Path]) -> None:
    shutil.copytree(data("semantickitti_mini/sequences/07") / "velodyne", tmp_path / "07/velodyne")
    report = inspect_drive(tmp_path / "07")
    assert report.ok
    assert report.pose_frame_reason == "odometry over the points of 10 scans"
    warned = [str(each.path) for each in report.problems if each.severity == "warning"]
    assert warned[:2] == ["poses", "labels"]


@pytest.mark.parametrize(
    ("frames", "numbers"), [("3:9", range(3, 9)), (":2", range(2)), ("7:", range(7, 12)), (":", range(12))]
)
def test_scans_keep_their_numbers_and_w_is_the_first_of_them(drive: Path, frames: str, numbers: range) -> None:
    whole, part = open_drive(drive), open_drive(drive, frames=frames)
    rows = slice(numbers.start, numbers.stop)
    assert part.frames.tolist() == list(numbers)
    expected = invert_transform(whole.T_world_lidar[numbers.start]) @ whole.T_world_lidar[rows]
    np.testing.assert_allclose(part.T_world_lidar, expected, atol=1e-9)
    np.testing.assert_array_equal(part.times_s, whole.times_s[rows])
    np.testing.assert_array_equal(part.georeference.lat_deg, whole.georeference.lat_deg[rows])
    np.testing.assert_array_equal(part.ground_points(0).road, whole.ground_points(numbers.start).road)


def test_what_is_wrong_outside_of_it_does_not_matter(drive: Path) -> None:
    (drive / "velodyne/000001.bin").write_bytes(b"cut off")
    (drive / "labels/000010.label").unlink()
    assert len(inspect_drive(drive).problems) == 2
    report = inspect_drive(drive, frames="2:10")
    assert (report.problems, report.scans, report.first_frame, report.last_frame) == ([], 8, 2, 9)


@pytest.mark.parametrize("frames", ["12:20", "5:5", "8:3"])
def test_a_part_without_a_scan_is_refused_with_those_that_there_are(drive: Path, reduced: Path, frames: str) -> None:
    for root in (drive, reduced):
        with pytest.raises(DriveError, match=rf"has no scan in the part {frames} .* its scans are 0 to 11\."):
            open_drive(root, frames=frames)
        (problem,) = inspect_drive(root, frames=frames).problems
        assert problem.severity == "error"


@pytest.mark.parametrize("frames", ["5", "1-4", "-3:", "1:2:3", "a:b"])
def test_another_form_is_refused(frames: str) -> None:
    with pytest.raises(ConfigError, match=r"frames '.*': expected one such as 200:1400\."):
        DriveOptions.of(frames=frames)


def test_numbers_that_begin_later_with_one_pose_per_scan(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_semantickitti(tmp_path / "late", frames=list(range(1000, 1012)))
    assert open_drive(root, frames="1004:1010").frames.tolist() == [1004, 1005, 1006, 1007, 1008, 1009]
    reduce_drive(root, tmp_path / "small", DriveOptions(frames="1004:1010"))
    assert open_drive(tmp_path / "small").frames.tolist() == [1004, 1005, 1006, 1007, 1008, 1009]


def test_reduced_drives(drive: Path, reduced: Path, tmp_path: Path) -> None:
    """A part of a reduced drive, and a drive of which a part was reduced."""
    part = open_drive(drive, frames="3:9")
    reduce_drive(drive, tmp_path / "small", DriveOptions(frames="3:9"), keyframes=KeyframeConfig())
    for found in (open_drive(reduced, frames="3:9"), open_drive(tmp_path / "small")):
        assert found.frames.tolist() == part.frames.tolist()
        np.testing.assert_allclose(found.T_world_lidar, part.T_world_lidar, atol=1e-6)
        np.testing.assert_allclose(found.georeference.lon_deg, part.georeference.lon_deg, atol=1e-9)
        np.testing.assert_array_equal(found.ground_points(0).road, part.ground_points(0).road)
    for given in ({"poses": "odometry"}, {"poses": "poses.txt"}, {"model": tmp_path}):
        with pytest.raises(DriveError, match="whose poses and labels are fixed"):
            open_drive(reduced, **given)
