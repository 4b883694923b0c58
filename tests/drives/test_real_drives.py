"""Real drives: they open, their dialect is told, their road is flat; read otherwise, they are refused."""

from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.drives.inspect import inspect_drive

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
