"""The node: point clouds and poses in, intersections out.

Messages come in serialized and are read by the readers of bags, so that a drive that is played from a bag gives what
the bag gives.
"""

import json
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rclpy
from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, Float64, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from interloc.arrays import Float32Array, FloatArray, JsonObject
from interloc.config import DetectorConfig
from interloc.detection.warm import warm_up
from interloc.drives.labels import LabelScheme
from interloc.drives.poses.motion import TimedPoses, rotations_from_quaternions
from interloc.drives.scans.rosbag.messages import (
    ODOMETRY,
    POINT_CLOUD,
    StampedPose,
    WireError,
    read_layout,
    read_points,
    read_pose,
    read_transforms,
)
from interloc.errors import ConfigError
from interloc.labelling.networks import remission_scale
from interloc.live.scan import Label, LiveScan
from interloc.live.session import Answer, LiveSession, MapIntersection
from interloc.live.worker import Document, LiveWorker, intersection_document

# Where the LiDAR is, from odometry and /tf as they come in: nothing is extrapolated.

_KEPT = 1000  # poses of each frame: ten seconds at 100 Hz
_MAX_DEPTH = 20


class Frames:
    """A tree of frames, each with the poses that it lately had in the frame above it."""

    def __init__(self) -> None:
        self._moves: dict[str, tuple[str, deque[tuple[float, FloatArray]], bool]] = {}

    def put(self, pose: StampedPose, *, is_fixed: bool = False) -> None:
        """Take a pose of its `child_frame` in the frame of its header."""
        x, y, z, *quaternion = pose.values
        T = np.eye(4)
        T[:3, 3] = x, y, z
        T[:3, :3] = rotations_from_quaternions(np.array([quaternion]))[0]
        parent, time_s = pose.header.frame_id, pose.header.stamp_ns / 1e9
        known = self._moves.get(pose.child_frame)
        was_set_back = known is not None and bool(known[1]) and time_s < known[1][-1][0] - _LATE_S  # the clock
        if known is None or known[0] != parent or is_fixed or was_set_back:
            known = (parent, deque(maxlen=_KEPT), is_fixed)
            self._moves[pose.child_frame] = known
        elif known[1] and time_s <= known[1][-1][0]:
            return  # sent again, or late
        known[1].append((time_s, T))

    def knows(self, frame: str) -> bool:
        """Return whether a frame lies in another one."""
        return frame in self._moves

    def pose(self, frame: str, time_s: float, world: str | None = None) -> tuple[FloatArray, str] | None:
        """Find the pose (4, 4) of a frame in another one above it, by default the topmost, and return that, too.

        None where it is not known, or not yet.
        """
        T = np.eye(4)
        for _ in range(_MAX_DEPTH):
            if frame == world or (world is None and frame not in self._moves and self._moves):
                return T, frame
            if frame not in self._moves:
                return None
            frame, poses, is_fixed = self._moves[frame]
            times = np.array([each for each, _ in poses])
            if is_fixed:
                T = poses[-1][1] @ T
            elif times[0] <= time_s <= times[-1]:
                T = TimedPoses(times, np.array([each for _, each in poses])).at([time_s])[0] @ T
            else:
                return None
        return None


_WAITING = 8  # clouds whose poses have not come yet
_LATE_S = 1.0  # a cloud that waits for longer goes
_SIGNALS_S = 0.5  # in between Python sees that it is to stop
_TOLD_EVERY_S = 5.0
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_BRANCH_M = 15.0
_SIZE_M = 3.0
_SURE, _UNSURE = ColorRGBA(r=0.94, g=0.89, b=0.26, a=1.0), ColorRGBA(r=0.94, g=0.89, b=0.26, a=0.35)


def map_markers(header: Header, intersections: Sequence[MapIntersection], z_m: float) -> MarkerArray:
    """Return the intersections as spheres, those that are not confirmed yet paler, and their branches as lines.

    They are drawn at a height in metres, in the frame of the poses, which the header names.
    """
    spheres = _marker(header, "intersections", Marker.SPHERE_LIST, _SIZE_M)
    lines = _marker(header, "branches", Marker.LINE_LIST, _SIZE_M / 6)
    for each in intersections:
        x, y = each.world_xy.tolist()
        colour = _SURE if each.is_confirmed else _UNSURE
        spheres.points.append(Point(x=x, y=y, z=z_m))
        spheres.colors.append(colour)
        for bearing in np.radians(each.bearings_deg).tolist():  # clockwise from +y
            end = Point(x=x + _BRANCH_M * math.sin(bearing), y=y + _BRANCH_M * math.cos(bearing), z=z_m)
            lines.points.extend([Point(x=x, y=y, z=z_m), end])
            lines.colors.extend([colour, colour])
    for marker in (spheres, lines):
        marker.action = Marker.ADD if marker.points else Marker.DELETE  # RViz complains of empty lists
    return MarkerArray(markers=[spheres, lines])


def map_json(header: Header, intersections: Sequence[MapIntersection]) -> str:
    """Return the intersections with covariances and branches, as JSON: no message of ROS has a place for them."""
    stamp = header.stamp.sec + header.stamp.nanosec / 1e9
    document: JsonObject = {"stamp": stamp, "frame_id": header.frame_id}
    return json.dumps(document | {"intersections": [intersection_document(each) for each in intersections]})


def _marker(header: Header, namespace: str, kind: int, size_m: float) -> Marker:
    marker = Marker(header=header, ns=namespace, id=0, type=kind)
    marker.scale.x = marker.scale.y = marker.scale.z = size_m
    marker.pose.orientation.w = 1.0
    return marker


@dataclass(frozen=True)
class NodeOptions:
    """What the node is told."""

    points: str
    """Topic of the clouds."""
    odometry: str | None
    """Topic of the poses; None: /tf."""
    world_frame: str | None
    """Frame of the map; None: the topmost frame of the poses."""
    config: DetectorConfig
    scheme: LabelScheme
    """Of the labels of the points."""
    label: Label | None = None
    """Gives labels to points that have none; their remission is brought to 0..1 before."""


class InterlocNode(Node):  # type: ignore[misc]  # rclpy has no types
    """Subscribes to clouds and poses, publishes below `interloc/`."""

    def __init__(self, options: NodeOptions) -> None:
        super().__init__("interloc")
        self._options = options
        self._frames = Frames()
        self._clouds: deque[tuple[bytes, float, str]] = deque()
        self._frame = 0
        self._lost = 0
        self._body: str | None = None  # frame whose poses the odometry gives
        self._under_way: dict[int, tuple[float, str, float]] = {}  # of scans: time, world frame, height
        self._remission_scale: float | None = None
        self._markers = self.create_publisher(MarkerArray, "interloc/markers", _LATCHED)
        self._intersections = self.create_publisher(String, "interloc/intersections", _LATCHED)
        self._answers = self.create_publisher(String, "interloc/detections", 10)
        self._processing_ms = self.create_publisher(Float64, "interloc/processing_time_ms", 10)
        self._latency_ms = self.create_publisher(Float64, "interloc/latency_ms", 10)
        self.worker = LiveWorker(LiveSession(options.config), self._say)
        self._subscribe(options)

    def _subscribe(self, options: NodeOptions) -> None:
        self._hear(PointCloud2, options.points, self._on_cloud, qos_profile_sensor_data)
        try:
            from tf2_msgs.msg import TFMessage  # noqa: PLC0415 - not among the wheels; every ROS has it
        except ImportError:
            if options.odometry is None:
                raise ConfigError(
                    "poses from /tf need tf2_msgs of a ROS (source its setup.bash); --odom TOPIC does without"
                ) from None
        else:
            self._hear(TFMessage, "/tf_static", self._on_static, _STATIC)
            if options.odometry is None:
                self._hear(TFMessage, "/tf", self._on_tf, 100)
        if options.odometry is not None:
            self._hear(Odometry, options.odometry, self._on_odometry, qos_profile_sensor_data)

    def _hear(self, kind: type, topic: str, take: Callable[[bytes], None], qos: QoSProfile | int) -> None:
        """Take the messages of a topic as they are on the wire; a damaged one is left out, and said."""

        def take_raw(data: bytes) -> None:
            try:
                take(data)
            except WireError as error:
                self._warn(f"a message of {topic} {error}")

        self.create_subscription(kind, topic, take_raw, qos, raw=True)

    def _on_cloud(self, data: bytes) -> None:
        header = read_layout(data, POINT_CLOUD, "cdr").header
        self._clouds.append((data, header.stamp_ns / 1e9, header.frame_id))
        if len(self._clouds) > _WAITING:
            self._lose("too many clouds wait for their poses")
        self._take_clouds()

    def _on_odometry(self, data: bytes) -> None:
        pose = read_pose(data, ODOMETRY, "cdr")
        self._body = pose.child_frame or "base_link"
        self._frames.put(replace(pose, child_frame=self._body))
        self._take_clouds()

    def _on_tf(self, data: bytes) -> None:
        for pose in read_transforms(data, "cdr"):
            self._frames.put(pose)
        self._take_clouds()

    def _on_static(self, data: bytes) -> None:
        for pose in read_transforms(data, "cdr"):
            self._frames.put(pose, is_fixed=True)

    def _take_clouds(self) -> None:
        """Hand on the clouds whose poses are known, in their order."""
        while self._clouds:
            data, time_s, frame = self._clouds[0]
            if self._body is not None and not self._frames.knows(frame):
                frame = self._body  # nothing says where on the vehicle the LiDAR is
            found = self._frames.pose(frame, time_s, self._options.world_frame)
            if found is None:
                if self._clouds[-1][1] - time_s < _LATE_S:
                    return
                self._lose(f"no pose of {frame} at {time_s:.3f} s")
                continue
            self._clouds.popleft()
            self._put(data, time_s, *found)

    def _put(self, data: bytes, time_s: float, T_world_lidar: FloatArray, world: str) -> None:
        try:
            points = read_points(data, POINT_CLOUD, "cdr")
        except WireError as error:
            self._warn(f"a cloud {error}")
            return
        options, self._frame = self._options, self._frame + 1
        self._under_way[self._frame] = (time_s, world, float(T_world_lidar[2, 3]))
        self.worker.put(
            LiveScan(
                frame=self._frame,
                T_world_lidar=T_world_lidar,
                points=points.values if options.label is None else self._scaled(points.values),
                labels=points.labels if options.label is None else None,
                time_s=time_s,
                scheme=options.scheme,
                label=options.label,
            )
        )

    def _scaled(self, points: Float32Array) -> Float32Array:
        """Bring the remission to 0..1, as networks take it."""
        if self._remission_scale is None and points[:, 3].any():  # a scan may be empty or dark
            self._remission_scale = remission_scale(points[:, 3])
        points[:, 3] /= self._remission_scale or 1.0
        return points

    def _say(self, document: Document, answer: Answer | None) -> None:
        """Publish what the session says; called by its thread, and for dropped scans by that of the node."""
        time_s, world, z_m = self._under_way.pop(document["frame"] or 0, (0.0, "map", 0.0))
        if document["type"] == "dropped":
            self._warn(f"it is too slow: {document['dropped']} scans dropped so far, the oldest first")
        elif document["type"] in ("refused", "failed"):
            self._warn(document["reason"])
        if answer is None or document["type"] != "scan":
            return
        header = Header(frame_id=world)
        header.stamp.sec, header.stamp.nanosec = math.floor(time_s), round(time_s % 1.0 * 1e9)
        self._processing_ms.publish(Float64(data=document["processing_time_ms"]))
        self._latency_ms.publish(Float64(data=self.get_clock().now().nanoseconds / 1e6 - 1e3 * time_s))
        if answer.keyframes is None:
            return
        intersections = self.worker.session.map.intersections
        self._answers.publish(String(data=json.dumps(document)))
        self._markers.publish(map_markers(header, intersections, z_m))
        self._intersections.publish(String(data=map_json(header, intersections)))

    def _lose(self, why: str) -> None:
        """Leave the oldest cloud out that waits for its pose."""
        self._clouds.popleft()
        self._lost += 1
        self._warn(f"{why}; {self._lost} clouds left out so far")

    def _warn(self, text: str) -> None:
        self.get_logger().warning(text, throttle_duration_sec=_TOLD_EVERY_S)


def run(options: NodeOptions, arguments: list[str]) -> None:
    """Run the node until it is stopped, with arguments of ROS: ``--ros-args -p use_sim_time:=true``.

    A `ConfigError` says that the poses are to come from /tf, and this installation does not know its messages.
    """
    warm_up(options.config)
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = InterlocNode(options)
        node.get_logger().info(f"waits for {options.points}")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=_SIGNALS_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
