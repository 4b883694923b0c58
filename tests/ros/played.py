"""Plays a street to the node and prints what it publishes, as JSON: a process of its own, beside that of the node."""

import array
import json
import sys
import time
from typing import Any

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Float64, Header, String
from visualization_msgs.msg import MarkerArray

from tests.crossing import SPACING_M, road_at

SCANS = 48
PATIENCE_S = 60.0


def cloud(header: Header, points: np.ndarray, labels: np.ndarray | int = 40) -> PointCloud2:
    cells = np.zeros(len(points), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("label", "u2"), ("", "u2")])
    for column, name in enumerate("xyz"):
        cells[name] = points[:, column]
    cells["label"] = labels
    offsets = {"x": (0, 7), "y": (4, 7), "z": (8, 7), "label": (12, 4)}
    fields = [PointField(name=n, offset=at, datatype=kind, count=1) for n, (at, kind) in offsets.items()]
    message = PointCloud2(header=header, height=1, width=len(points), fields=fields, point_step=16, is_dense=True)
    message.row_step = 16 * len(points)
    message.data = array.array("B", cells.tobytes())
    return message


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("street")
    got: dict[str, list[Any]] = {"detections": [], "markers": [], "intersections": [], "ms": []}
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(String, "interloc/detections", lambda m: got["detections"].append(m.data), 100)
    node.create_subscription(String, "interloc/intersections", lambda m: got["intersections"].append(m.data), latched)
    node.create_subscription(Float64, "interloc/processing_time_ms", lambda m: got["ms"].append(m.data), 100)
    node.create_subscription(MarkerArray, "interloc/markers", got["markers"].append, latched)
    clouds = node.create_publisher(PointCloud2, "points", qos_profile_sensor_data)
    poses = node.create_publisher(Odometry, "odom", qos_profile_sensor_data)
    end = time.monotonic() + PATIENCE_S
    while not all(publisher.get_subscription_count() for publisher in (clouds, poses)):
        rclpy.spin_once(node, timeout_sec=0.05)
        assert time.monotonic() < end, "the node did not come"
    sent = 0
    for frame in range(SCANS):
        x_m = SPACING_M * frame
        header = Header(frame_id="odom")
        header.stamp.sec, header.stamp.nanosec = 100 + frame, 0
        odometry = Odometry(header=header, child_frame_id="base_link")
        odometry.pose.pose.position.x, odometry.pose.pose.orientation.w = x_m, 1.0
        answers = len(got["ms"])
        poses.publish(bytes(20))  # what is damaged is left out
        while len(got["ms"]) == answers and time.monotonic() < end:  # before they met it may be lost
            sent += 1
            clouds.publish(cloud(Header(stamp=header.stamp, frame_id="lidar"), road_at(x_m)))
            poses.publish(odometry)
            # Once the two have met only patience helps: a scan that is sent twice is counted twice.
            again = time.monotonic() + (20.0 if got["ms"] else 2.0)
            while len(got["ms"]) == answers and time.monotonic() < again:
                rclpy.spin_once(node, timeout_sec=0.05)
    while len(got["markers"]) < len(got["detections"]) and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
    last = got["markers"][-1]
    sys.stdout.write(
        json.dumps(
            {
                "keyframes": [json.loads(each)["keyframe"] for each in got["detections"]],
                "intersections": json.loads(got["intersections"][-1]),
                "frame_id": last.markers[0].header.frame_id,
                "types": [each.type for each in last.markers],
                "points": [len(each.points) for each in last.markers],
                "place": [last.markers[0].points[0].x, last.markers[0].points[0].y],
                "processing_times": len(got["ms"]),
                "sent": sent,
            }
        )
    )
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
