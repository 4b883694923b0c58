"""Pose lines: every form that is read, and every one that is refused."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from interloc.drives.files import SourceFile
from interloc.drives.poses.files import PoseLines, read_poses
from interloc.errors import DriveError


def read(tmp_path: Path, text: str) -> PoseLines:
    (tmp_path / "poses.txt").write_text(text)
    return read_poses(SourceFile(tmp_path / "poses.txt", tmp_path))


def complaint(tmp_path: Path, text: str) -> str:
    with pytest.raises(DriveError) as caught:
        read(tmp_path, text)
    return str(caught.value)


@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize("frames", [None, [5, 6, 9]])
def test_all_four_forms_give_the_same_poses(
    tmp_path: Path, make: ModuleType, rows: int, frames: list[int] | None
) -> None:
    poses = make.lidar_poses(3)
    lines = read(tmp_path, make.pose_text(poses, frames=frames, rows=rows))
    np.testing.assert_allclose(lines.poses, poses, atol=1e-8)
    assert (None if lines.frames is None else lines.frames.tolist()) == frames


def test_numbered_lines_are_sorted(tmp_path: Path, make: ModuleType) -> None:
    poses = make.lidar_poses(2)
    lines = read(tmp_path, make.pose_text(poses, frames=[9, 4]))
    assert lines.frames is not None
    assert lines.frames.tolist() == [4, 9]
    np.testing.assert_allclose(lines.poses[0], poses[1], atol=1e-8)


def test_blank_lines_comments_and_a_byte_order_mark_are_skipped(tmp_path: Path) -> None:
    assert len(read(tmp_path, "\ufeff# a comment\n\n1 0 0 0 0 1 0 0 0 0 1 0\n\n").poses) == 1


def test_rounded_rotations_are_made_proper(tmp_path: Path) -> None:
    rotation = read(tmp_path, "0.9998 -0.02 0 1 0.02 0.9998 0 2 0 0 1 3\n").poses[0, :3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_eleven_numbers(tmp_path: Path) -> None:
    text = complaint(tmp_path, "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1\n")
    assert text.startswith("poses.txt: line 2: 11 numbers; expected 12")
    assert "Usual cause" in text


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 2 3 4 5 6 7 8", "TUM"),
        ("1,0,0,0,0,1,0,0,0,0,1,0", "commas"),
        ("1 0 0 0 0 1 0 0 0 0 1 zero", "'zero' is not a number"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0", "not finite"),
        ("1 0 0 inf 0 1 0 0 0 0 1 0", "not finite"),
        ("1 0 0 2e7 0 1 0 0 0 0 1 0", "10,000 km"),
        ("2 0 0 0 0 1 0 0 0 0 1 0", "not a rotation"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "mirrors"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 5 5 5 1", "0 0 0 1"),
        ("0.5 1 0 0 0 0 1 0 0 0 0 1 0", "frame number"),
        ("0 0 0 0 0 0 0 0 0 0 0 0", "not a rotation"),
    ],
)
def test_bad_lines_are_named(tmp_path: Path, line: str, words: str) -> None:
    text = complaint(tmp_path, line + "\n")
    assert text.startswith("poses.txt: line 1: ")
    assert words in text


def test_two_poses_of_one_frame(tmp_path: Path, make: ModuleType) -> None:
    assert "frame 3 has two poses" in complaint(tmp_path, make.pose_text(make.lidar_poses(2), frames=[3, 3]))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DriveError, match=r"poses\.txt: is missing"):
        read_poses(SourceFile(tmp_path / "poses.txt", tmp_path))
