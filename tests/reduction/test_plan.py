"""Planning from the small files alone, as for a browser that sends its scans afterwards."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from interloc.config import KeyframeConfig
from interloc.drives.files import SourceFile
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.drives.scans.raw import count_ids, read_labels
from interloc.drives.scans.reduced_format import ReducedLabels, ground_path
from interloc.errors import DriveError
from interloc.reduction.plan import judge_counts, plan_reduction
from interloc.reduction.reduce import prepare_reduction, reduce_drive, reduce_scan

LABELS = "labels"


@pytest.fixture
def small_files(drive: Path, tmp_path: Path) -> Path:
    """The drive without its scans and labels."""
    leave = shutil.ignore_patterns("velodyne", "labels")
    return Path(shutil.copytree(drive, tmp_path / "uploads" / "07", ignore=leave))


def test_the_plan_needs_no_scans(drive: Path, small_files: Path) -> None:
    plan = plan_reduction(small_files, range(12))
    whole = prepare_reduction(drive, keyframes=KeyframeConfig()).plan
    assert plan.ok
    assert plan.problems == []
    assert plan.frames_to_send.tolist() == [0, 3, 6, 9]
    assert plan.frames_to_look_into.tolist() == [0, 3, 6, 8, 11]
    assert plan.scans == 12
    assert plan.manifest == whole.manifest
    assert plan.length_m == pytest.approx(11 * 0.9, abs=0.01)
    for name in ("layout", "pose_frame", "pose_frame_reason", "georeference", "georeference_reason", "length_m"):
        assert getattr(plan, name) == getattr(whole, name)


def test_a_drive_sent_scan_by_scan(drive: Path, small_files: Path, tmp_path: Path) -> None:
    """From the plan to the same folder that `reduce_drive` writes, but for the facts about the scans."""
    plan = plan_reduction(small_files, range(12))
    counts: dict[int, int] = {}
    for frame in plan.frames_to_look_into:
        ids = count_ids(read_labels(SourceFile(drive / f"labels/{frame:06d}.label", drive)))
        for label, count in ids.items():
            counts[label] = counts.get(label, 0) + count
    judged, problems = judge_counts(plan, LABELS, counts)
    assert judged.scheme is not None
    assert problems == []
    scans = prepare_reduction(drive).scans[LABELS]
    for frame in map(int, plan.frames_to_send):
        path = small_files / ground_path(LABELS, frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(reduce_scan(scans, frame))
    assert plan.manifest is not None
    manifest = plan.manifest.with_labels([ReducedLabels.of(LABELS, judged.scheme, counts)])
    (small_files / "reduced.json").write_bytes(manifest.to_bytes())

    reduce_drive(drive, tmp_path / "reduced", keyframes=KeyframeConfig())
    ours, theirs = open_drive(small_files), open_drive(tmp_path / "reduced")
    assert ours.T_world_lidar.tobytes() == theirs.T_world_lidar.tobytes()
    assert ours.scheme == theirs.scheme
    for path in (tmp_path / "reduced" / "ground").rglob("*.ground"):
        assert (small_files / path.relative_to(tmp_path / "reduced")).read_bytes() == path.read_bytes()


def test_every_scan(small_files: Path) -> None:
    plan = plan_reduction(small_files, range(12), keyframes=None)
    assert plan.frames_to_send.tolist() == list(range(12))
    assert plan.manifest is not None
    assert plan.manifest.keyframes is None


def test_scans_in_any_order(small_files: Path) -> None:
    plan = plan_reduction(small_files, [5, 3, 0, 1, 2, 4])
    assert plan.frames.tolist() == list(range(6))
    assert plan.frames_to_send.tolist() == [0, 3]


def test_kitti_raw(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_kitti_raw(tmp_path / "2011_09_26_drive_0001_sync")
    kept = prepare_reduction(root, keyframes=KeyframeConfig()).plan.frames_to_send.tolist()
    shutil.rmtree(root / "velodyne_points" / "data")
    shutil.rmtree(root / "labels")
    for _ in range(2):  # without times too: then only oxts/ tells the layout
        plan = plan_reduction(root, range(12))
        assert (plan.ok, plan.layout, plan.pose_frame) == (True, "kitti_raw", "oxts")
        assert plan.georeference == "oxts/data, lever arm of calib_imu_to_velo.txt"
        assert plan.frames_to_send.tolist() == kept
        shutil.rmtree(root / "velodyne_points", ignore_errors=True)


@pytest.mark.parametrize("scan_folder", [None, "velodyne", "velodyne_points/data"])
def test_kitti360(tmp_path: Path, make: ModuleType, scan_folder: Any) -> None:
    poses, frames = make.lidar_poses(), [*range(100, 106), *range(110, 116)]
    tmp_path.joinpath("poses.txt").write_text(make.pose_text(poses, frames=frames))
    plan = plan_reduction(tmp_path, frames, scan_folder=scan_folder)
    assert (plan.ok, plan.layout, plan.pose_frame) == (True, "kitti360", "lidar")
    assert plan.manifest is not None
    assert plan.manifest.scans == [(100, 6), (110, 6)]
    assert plan.georeference is None
    assert plan.georeference_reason == "the drive has neither oxts/ nor geo.csv"


def test_rows_of_oxts_among_the_small_files(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_semantickitti(tmp_path / "files")
    shutil.rmtree(root / "velodyne")
    rows = make.oxts_lines(make.lidar_poses(), T_lidar_imu=np.eye(4))
    (root / "gnss.txt").write_text("\n".join(rows) + "\n")
    plan = plan_reduction(root, range(12), DriveOptions(oxts=root / "gnss.txt", name="08"))
    assert plan.manifest is not None
    assert (plan.manifest.name, plan.manifest.files.oxts) == ("08", "gnss.txt")
    assert plan.georeference == "gnss.txt, lever arm as published by KITTI"


def test_problems_are_listed_not_raised(small_files: Path) -> None:
    (small_files / "poses.txt").write_text("1 2 3\n")
    (small_files / "geo.csv").write_text("frame\n")
    plan = plan_reduction(small_files, range(12))
    assert not plan.ok
    assert sorted(problem.path for problem in plan.problems) == ["geo.csv", "poses.txt"]
    assert plan.manifest is None
    assert len(plan.frames_to_send) == 0
    assert plan.length_m is None


def test_a_bad_georeference_leaves_the_rest_of_the_plan(small_files: Path) -> None:
    (small_files / "geo.csv").write_text("frame\n")
    plan = plan_reduction(small_files, range(12))
    assert [problem.path for problem in plan.problems] == ["geo.csv"]
    assert plan.frames_to_send.tolist() == [0, 3, 6, 9]
    assert plan.georeference is None
    assert "no column lat_deg" in (plan.georeference_reason or "")


def test_a_scan_without_a_fix_is_one_problem(tmp_path: Path, make: ModuleType) -> None:
    root = make.write_kitti_raw(tmp_path / "raw")
    (root / "poses.txt").write_text(make.pose_text(make.lidar_poses()))
    (root / "oxts/data/0000000004.txt").unlink()
    plan = plan_reduction(root, range(12))
    assert [problem.message.split(":")[0] for problem in plan.problems] == ["1 of 12 scans have no fix"]
    assert len(plan.frames_to_send) > 4


def test_a_small_file_that_has_gone(small_files: Path, tmp_path: Path) -> None:
    plan = plan_reduction(small_files, range(12))
    (small_files / "times.txt").unlink()
    with pytest.raises(DriveError, match=r"times\.txt: cannot be read: no such file"):
        plan.copies.write_to(tmp_path)


def test_nothing_sent_so_far(tmp_path: Path) -> None:
    plan = plan_reduction(tmp_path, range(3))
    assert [problem.path for problem in plan.problems] == ["poses.txt"]
    assert not plan_reduction(tmp_path / "gone", range(3)).ok


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ([], "0 scans; expected 1 to 1,000,000"),
        ([0, 1, 1], "scan 1 comes twice"),
        ([-1, 0], "a scan number is negative"),
        ([0, 10**30], "negative or larger than any"),
        (range(1_000_001), "1,000,001 scans; expected 1 to 1,000,000"),
        (range(13), "12 poses for the scans 0 to 12"),
    ],
)
def test_scan_numbers_that_cannot_be(small_files: Path, frames: Any, words: str) -> None:
    plan = plan_reduction(small_files, frames)
    assert not plan.ok
    assert any(words in problem.message for problem in plan.problems)
    assert plan.manifest is None


def test_a_reduced_drive_has_nothing_to_plan(reduced: Path) -> None:
    plan = plan_reduction(reduced, range(12))
    assert [problem.path for problem in plan.problems] == ["reduced.json"]


def test_what_label_ids_mean(small_files: Path) -> None:
    plan = plan_reduction(small_files, range(12))
    judged, problems = judge_counts(plan, LABELS, {9: 100, 11: 60, 15: 40})
    assert judged.scheme is not None
    assert judged.scheme.name == "learning"
    assert (judged.road_share, judged.ground_share) == (0.5, 0.8)
    assert [problem.severity for problem in problems] == ["note"]
    judged, problems = judge_counts(plan, LABELS, {})
    assert (judged.scheme, judged.road_share, problems) == (None, None, [])
    judged, problems = judge_counts(plan, LABELS, {70: 5})
    assert judged.road_share == 0
    assert [problem.severity for problem in problems] == ["error"]


def test_real_drives(data: Callable[[str], Path]) -> None:
    plan = plan_reduction(data("semantickitti_mini/sequences/07"), range(10), scan_folder="velodyne")
    assert (plan.ok, plan.layout, plan.pose_frame) == (True, "semantickitti", "camera")
    with pytest.raises(DriveError, match="is missing"):
        reduce_drive(data("semantickitti_mini/sequences/07"), "/nowhere", label_folders=["predictions"])
