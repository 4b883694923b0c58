"""The real node and real messages, in a network of their own with nothing but a loopback."""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from interloc.config import preset
from interloc.detection.scan import Scan
from interloc.drives.scans.rosbag.messages import Header, StampedPose
from interloc.pipeline import stream
from interloc.ros.node import Frames
from tests.crossing import SPACING_M, road_at
from tests.small_drives import level_poses

ROOT = Path(__file__).resolve().parents[2]
SCANS = 48
ALONE = ("unshare", "--map-root-user", "--net")

BOTH = """
ip link set lo up
"{python}" -m interloc ros points --odom odom --lookahead 4 &
node=$!
"{python}" -m tests.ros.played
code=$?
kill -INT $node
wait $node
exit $((code + $?))
"""


def why_not() -> str:
    """Why the node cannot be tried here; empty where it can."""
    wheels = ("rclpy", "nav_msgs", "sensor_msgs", "std_msgs", "visualization_msgs")
    if not all(importlib.util.find_spec(each) for each in wheels):
        return "rclpy of ROS 2 is not installed"
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        return "no unshare or ip on the PATH, for a network of its own"
    alone = subprocess.run([*ALONE, "ip", "link", "set", "lo", "up"], capture_output=True, check=False)
    return "" if alone.returncode == 0 else "no network namespace can be made here"


def test_the_node_finds_what_the_library_finds(tmp_path: Path) -> None:
    if reason := why_not():
        pytest.skip(reason)
    scans = [Scan(row, level_poses(SPACING_M * row), road_at(SPACING_M * row)) for row in range(SCANS)]
    expected = list(stream(scans, preset("default", "keyframes.lookahead=4")))
    environment = {**os.environ, "ROS_LOG_DIR": str(tmp_path), "ROS_DOMAIN_ID": "45", "PYTHONPATH": str(ROOT)}
    played = subprocess.run(
        [*ALONE, "sh", "-c", BOTH.format(python=sys.executable)],
        capture_output=True, text=True, env=environment, cwd=ROOT, timeout=100, check=False,
    )  # fmt: skip
    assert played.returncode == 0, played.stderr
    said = json.loads(played.stdout.splitlines()[-1])
    assert len(said["keyframes"]) >= SCANS - 8  # the first ones may be lost, as long as the two have not met
    for keyframe in said["keyframes"]:
        found = [(each["x_m"], each["y_m"]) for each in keyframe["detections"]]
        row = round(keyframe["time_s"]) - 100
        np.testing.assert_array_equal(np.reshape(found, (-1, 2)), expected[row].lidar_xy)
    assert SCANS <= said["processing_times"] <= said["sent"]  # what is not answered in time is sent again
    assert (said["frame_id"], said["types"]) == ("odom", [7, 5])  # SPHERE_LIST, LINE_LIST
    assert said["points"] == [1, 8]
    np.testing.assert_allclose(said["place"], [60, 0], atol=0.3)
    (intersection,) = said["intersections"]["intersections"]
    assert intersection["confirmed"]
    assert len(intersection["position_cov_m2"]) == 3
    assert len(intersection["branch_bearings_deg"]) == 4


def pose(parent: str, child: str, time_s: float, x_m: float) -> StampedPose:
    return StampedPose(Header(round(1e9 * time_s), parent), child, (x_m, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


def test_poses_are_interpolated_along_the_chain_and_never_extrapolated() -> None:
    frames = Frames()
    frames.put(pose("base", "lidar", 0.0, 1.5), is_fixed=True)
    assert frames.pose("lidar", 1.0, "odom") is None
    frames.put(pose("odom", "base", 1.0, 10.0))
    frames.put(pose("odom", "base", 2.0, 20.0))
    frames.put(pose("odom", "base", 1.5, 99.0))  # late
    found = frames.pose("lidar", 1.25)
    np.testing.assert_allclose(found[0][:3, 3], [14.0, 0.0, 0.0])
    assert found[1] == "odom"
    assert frames.pose("lidar", 2.5) is None
    assert frames.pose("lidar", 0.5) is None
    assert frames.pose("lidar", 1.5, "map") is None
    frames.put(pose("map", "odom", 0.0, 100.0), is_fixed=True)
    found = frames.pose("lidar", 1.5, "map")
    np.testing.assert_allclose(found[0][:3, 3], [116.5, 0.0, 0.0])
    assert frames.pose("camera", 1.5, "map") is None
