"""Scans are laid onto each other: poses that move otherwise are refused, and the usual mistake is named."""

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
from interloc.drives.open import open_drive
from interloc.drives.scan_motion import check_scan_motion
from interloc.geometry import invert_transform, rotation_from_rpy
from tests import streets


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
    mounting = np.eye(4)
    mounting[:3, :3] = rotation_from_rpy(0.0, 0.0, np.pi / 2)
    return poses @ mounting


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
