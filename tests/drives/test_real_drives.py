"""Real drives: they open, their dialect is told, their road is flat; read otherwise, they are refused."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.drives.checks import check_flat_road
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.drives.poses.files import read_poses
from interloc.errors import DriveError
from interloc.geometry import invert_transform

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


@pytest.mark.parametrize(("name", "labels", "frame"), SAMPLES)
def test_the_road_alone_betrays_the_other_dialect(
    data: Callable[[str], Path], name: str, labels: str, frame: str
) -> None:
    root = data(name)
    drive = open_drive(root, labels=labels)
    raw = read_poses(SourceFile(root / "poses.txt", root)).poses[: len(drive.frames)]
    line = next(s for s in data("kitti/calib/00.txt").read_text().splitlines() if s.startswith("Tr:"))
    T_cam_lidar = np.vstack([np.array(line.split()[1:], float).reshape(3, 4), [0, 0, 0, 1]])
    wrong = raw if frame == "camera" else invert_transform(T_cam_lidar) @ raw @ T_cam_lidar
    with pytest.raises(DriveError, match=r"the road is not flat"):
        check_flat_road(
            dataclasses.replace(drive, T_world_lidar=wrong),
            np.arange(len(raw)),
            "poses.txt",
            Findings(stop_at_first=True),
        )


def test_oxts_rows_of_the_sequence(data: Callable[[str], Path]) -> None:
    root = data("semantickitti_mini/sequences/00")
    drive = open_drive(root, oxts=data("kitti/oxts/00.txt.gz"))
    assert len(drive.georeference.lat_deg) == len(drive.frames) == 10
    assert drive.georeference.lat_deg[0] == pytest.approx(48.98, abs=0.02)


def test_reading_a_scan_selects_what_a_mask_selects(data: Callable[[str], Path]) -> None:
    root = data("semantickitti_mini/sequences/07")
    drive = open_drive(root)
    points = np.fromfile(root / "velodyne" / "000005.bin", np.float32).reshape(-1, 4)
    ids = np.fromfile(root / "labels" / "000005.label", np.uint32) & 0xFFFF
    np.testing.assert_array_equal(drive.ground_points(5).road, points[np.isin(ids, [40, 60]), :3])
    np.testing.assert_array_equal(drive.ground_points(5).confusable, points[np.isin(ids, [44, 48, 49]), :3])
