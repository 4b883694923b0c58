"""Where the LiDAR is, from poses as they come in."""

import numpy as np

from interloc.drives.scans.rosbag.messages import Header, StampedPose
from interloc.ros.node import Frames


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
