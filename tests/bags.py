"""Bags for the tests: scans, poses and fixes written by rosbags in all formats."""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Self

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from interloc.drives.poses.motion import quaternions_from_rotations

FORMATS = ("bag", "db3", "mcap")
"""All formats; "bag" is ROS 1."""

LIVOX = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
livox_ros_driver2/CustomPoint[] points
================================================================================
MSG: livox_ros_driver2/CustomPoint
uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""

_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


@cache
def _types(ros1: bool) -> Any:
    """Return the messages of ROS 1 or 2; making them takes longer than a small bag."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store


class BagWriter:
    """Writes messages of standard types to a bag of one format.

    The path is that of the .bag file (ROS 1), or of the folder of the bag (ROS 2).
    """

    def __init__(self, path: Path, form: str, *, compression: Any = None) -> None:
        self.ros1 = form == "bag"
        self.store = _types(self.ros1)
        self.writer: Any
        if self.ros1:
            self.writer = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
            self.writer = Writer2(path, version=9, storage_plugin=plugin)
        if compression is not None:
            self.writer.set_compression(*compression)
        self.connections: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def make(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def header(self, time_s: float, frame: str) -> Any:
        ns = round(time_s * 1e9)
        stamp = self.make("builtin_interfaces/msg/Time", ns // 10**9, ns % 10**9)
        return self.make("std_msgs/msg/Header", *((0,) if self.ros1 else ()), stamp, frame)

    def pose(self, pose: Any) -> Any:
        quaternion = quaternions_from_rotations(np.asarray(pose)[None, :3, :3])[0]
        return self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *map(float, pose[:3, 3])),
            self.make("geometry_msgs/msg/Quaternion", *map(float, quaternion)),
        )

    def write(self, topic: str, kind: str, time_s: float, message: Any) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], round(time_s * 1e9), serialize(message, kind))

    def cloud(self, topic: str, time_s: float, cells: np.ndarray, *, frame: str = "velodyne", **changes: Any) -> None:
        """Write a structured array of points: its fields, their offsets and its size are those of the message.

        `changes` replaces what the message says: header_s, height, width, row_step, point_step, data, fields.
        """
        cells = np.atleast_2d(cells)
        step = cells.dtype.itemsize
        order = next((cells.dtype[name].byteorder for name in cells.dtype.names or ()), "<")
        fields = [
            self.make("sensor_msgs/msg/PointField", name, offset, _CODES[kind.str[1:]], 1)
            for name, (kind, offset, *_) in (cells.dtype.fields or {}).items()
        ]
        message = self.make(
            "sensor_msgs/msg/PointCloud2",
            self.header(changes.get("header_s", time_s), frame),
            changes.get("height", cells.shape[0]),
            changes.get("width", cells.shape[1]),
            changes.get("fields", fields),
            order == ">",
            changes.get("point_step", step),
            changes.get("row_step", cells.shape[1] * step),
            changes.get("data", np.frombuffer(cells.tobytes(), np.uint8)),
            False,
        )
        self.write(topic, "sensor_msgs/msg/PointCloud2", time_s, message)

    def odometry(self, topic: str, time_s: float, pose: Any, child: str = "velodyne", **changes: Any) -> None:
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/msg/Twist", zero, zero)
        message = self.make(
            "nav_msgs/msg/Odometry",
            self.header(changes.get("header_s", time_s), "odom"),
            child,
            self.make("geometry_msgs/msg/PoseWithCovariance", self.pose(pose), np.zeros(36)),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
        )
        self.write(topic, "nav_msgs/msg/Odometry", time_s, message)

    def pose_stamped(self, topic: str, time_s: float, pose: Any) -> None:
        message = self.make("geometry_msgs/msg/PoseStamped", self.header(time_s, "map"), self.pose(pose))
        self.write(topic, "geometry_msgs/msg/PoseStamped", time_s, message)

    def transforms(self, topic: str, time_s: float, transforms: Mapping[tuple[str, str], Any]) -> None:
        """Write T_parent_child by (parent, child)."""
        messages = []
        for (parent, child), transform in transforms.items():
            pose = self.pose(transform)
            vector = self.make("geometry_msgs/msg/Vector3", *map(float, transform[:3, 3]))
            moved = self.make("geometry_msgs/msg/Transform", vector, pose.orientation)
            messages.append(self.make("geometry_msgs/msg/TransformStamped", self.header(time_s, parent), child, moved))
        self.write(topic, "tf2_msgs/msg/TFMessage", time_s, self.make("tf2_msgs/msg/TFMessage", messages))

    def fix(
        self,
        topic: str,
        time_s: float,
        position: Sequence[float],
        *,
        status: int = 0,
        header_s: float | None = None,
        std_m: float | None = None,
    ) -> None:
        """Write a fix: latitude, longitude in degrees, altitude in metres; its uncertainty, where it is known."""
        message = self.make(
            "sensor_msgs/msg/NavSatFix",
            self.header(time_s if header_s is None else header_s, "gnss"),
            self.make("sensor_msgs/msg/NavSatStatus", status, 1),
            *map(float, position),
            np.zeros(9) if std_m is None else np.diag([std_m**2] * 3).ravel(),
            0 if std_m is None else 2,
        )
        self.write(topic, "sensor_msgs/msg/NavSatFix", time_s, message)


def cells_of(points: np.ndarray, labels: np.ndarray | None = None) -> np.ndarray:
    """Return (N, 4) points, and labels where there are any, as a structured array, padded as drivers do."""
    names, formats, offsets = ["x", "y", "z", "intensity"], ["<f4"] * 4, [0, 4, 8, 16]
    if labels is not None:
        names, formats, offsets = [*names, "label"], [*formats, "<u4"], [*offsets, 20]
    layout: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": 32}
    cells = np.zeros(len(points), dtype=layout)
    for column, name in enumerate(("x", "y", "z", "intensity")):
        cells[name] = points[:, column]
    if labels is not None:
        cells["label"] = labels
    return cells


def write_bag(
    path: Path,
    form: str,
    scans: Sequence[np.ndarray],
    times: Sequence[float],
    *,
    labels: Sequence[np.ndarray] | None = None,
    poses: Sequence[Any] = (),
    pose_times: Sequence[float] | None = None,
    fixes: Sequence[tuple[float, Sequence[float]]] = (),
    compression: Any = None,
) -> Path:
    """Write a drive as a bag: points on /points, Odometry of the LiDAR on /odom, fixes on /fix.

    The path has no suffix; poses are T_world_lidar at `pose_times`, or else at `times`; fixes are (time, (latitude,
    longitude, altitude)). Returns the .bag file, or the folder of the bag.
    """
    target = path.with_suffix(".bag") if form == "bag" else path
    with BagWriter(target, form, compression=compression) as bag:
        events: list[tuple[float, int, Any]] = []
        events += [(time, 0, row) for row, time in enumerate(times)]
        events += [(time, 1, pose) for time, pose in zip(pose_times or times, poses, strict=False)]
        events += [(time, 2, position) for time, position in fixes]
        for time, what, content in sorted(events, key=lambda event: event[:2]):
            if what == 0:
                bag.cloud("/points", time, cells_of(scans[content], labels[content] if labels else None))
            elif what == 1:
                bag.odometry("/odom", time, content)
            else:
                bag.fix("/fix", time, content)
    return target
