"""KITTI raw has a timestamps.txt for scans and one for OXTS: rows of other times are not taken by their numbers."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.drives.inspect import inspect_drive


def with_oxts(root: Path, make: ModuleType, times_s: np.ndarray, poses: np.ndarray) -> Path:
    """Write a raw drive with a scan per 0.1 s, and with rows of OXTS at other times."""
    make.write_kitti_raw(root)
    arm = np.eye(4)
    arm[:3, 3] = -0.8, 0.3, -0.8
    for row, text in enumerate(make.oxts_lines(poses, T_lidar_imu=arm)):
        (root / "oxts" / "data" / f"{row:010d}.txt").write_text(text)
    stamps = np.datetime64("2011-09-26T13:02:25", "us") + np.round(times_s * 1e6).astype("timedelta64[us]")
    (root / "oxts" / "timestamps.txt").write_text("\n".join(str(stamp).replace("T", " ") for stamp in stamps))
    return root


def test_rows_of_the_same_times_are_taken_by_their_numbers(tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses()
    jitter = np.random.default_rng(1).uniform(-0.02, 0.02, len(poses))
    report = inspect_drive(with_oxts(tmp_path / "raw", make, 0.1 * np.arange(len(poses)) + jitter, poses))
    assert not [problem for problem in report.problems if problem.severity != "note"]


def test_rows_that_start_earlier_are_taken_by_their_times(tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses()
    rows = np.concatenate([np.repeat(poses[:1], 7, axis=0), poses])  # it stood still for seven rows
    root = with_oxts(tmp_path / "raw", make, 0.1 * np.arange(-7, len(poses)), rows)
    report = inspect_drive(root)
    (told,) = [problem for problem in report.problems if problem.severity == "warning"]
    assert "rows nearest in time" in told.message
    assert report.length_m == pytest.approx(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum(), rel=0.01)


def test_a_clock_of_another_zone_is_named(tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses()
    report = inspect_drive(with_oxts(tmp_path / "raw", make, 7200 + 0.1 * np.arange(len(poses)), poses))
    (told,) = [problem for problem in report.problems if problem.severity == "warning"]
    assert "+7,200.0 s off the scans" in told.message
    assert "time zone" in told.message
