"""`interloc ros`; the node itself: tests/ros."""

import ast
from pathlib import Path

from tests.cli.conftest import Interloc


def test_the_files_for_ros_are_told(interloc: Interloc) -> None:
    folder = Path(interloc("ros", "--files").out.strip())
    ast.parse((folder / "interloc.launch.py").read_text())
    assert "/interloc/markers" in (folder / "interloc.rviz").read_text()


def test_a_topic_is_needed(interloc: Interloc) -> None:
    outcome = interloc("ros")
    assert (outcome.code, "interloc ros /velodyne_points" in outcome.err) == (2, True)
