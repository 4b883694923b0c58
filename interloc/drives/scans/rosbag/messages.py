"""The small messages of a bag: poses, transforms between frames, GNSS fixes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from interloc.drives.scans.rosbag.wire import Encoding, Header, Wire, WireError, read_header

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSES = (ODOMETRY, POSE, POSE_WITH_COVARIANCE)
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FIX = "sensor_msgs/msg/NavSatFix"

NO_FIX = -1
"""Status of a receiver without a position."""

_TRANSFORM_BYTES = 68
_UNKNOWN_COVARIANCE = 0


@dataclass(frozen=True)
class StampedPose:
    """A pose, or a transform between two frames."""

    header: Header
    """Time, and the frame that the pose is in."""
    child_frame: str
    """The frame whose pose this is; empty where the message does not name it."""
    values: tuple[float, ...]
    """x y z in metres, quaternion x y z w."""


@dataclass(frozen=True)
class Fix:
    """A position of a GNSS receiver."""

    header: Header
    """Time, and the frame of the antenna."""
    status: int
    """`NO_FIX`, or better."""
    position: tuple[float, ...]
    """Latitude and longitude in degrees, altitude over the ellipsoid in metres."""
    std_m: float = float("nan")
    """One-sigma uncertainty of the position along each horizontal axis, metres; NaN where it is not known."""


def read_pose(data: bytes, kind: str, encoding: Encoding) -> StampedPose:
    """Read an Odometry, a PoseStamped or a PoseWithCovarianceStamped.

    Raises
    ------
    WireError
    """
    wire = Wire(data, encoding)
    header = read_header(wire)
    child = wire.text().lstrip("/") if kind == ODOMETRY else ""
    return StampedPose(header, child, wire.numbers("d", 7))


def read_transforms(data: bytes, encoding: Encoding) -> list[StampedPose]:
    """Read a TFMessage: transforms that lead from their child frame into the frame of their header.

    Raises
    ------
    WireError
    """
    wire = Wire(data, encoding)
    transforms = []
    for _ in range(wire.count(_TRANSFORM_BYTES)):
        header = read_header(wire)
        child = wire.text().lstrip("/")
        transforms.append(StampedPose(header, child, wire.numbers("d", 7)))
    return transforms


def read_fix(data: bytes, encoding: Encoding) -> Fix:
    """Read a NavSatFix.

    Raises
    ------
    WireError
    """
    wire = Wire(data, encoding)
    header = read_header(wire)
    status = wire.integer("b")
    wire.integer("H")
    position = wire.numbers("d", 3)
    try:
        covariance, kind = wire.numbers("d", 9), wire.integer("B")
    except WireError:  # the position is what counts
        return Fix(header, status, position)
    variance = (covariance[0] + covariance[4]) / 2
    known = kind != _UNKNOWN_COVARIANCE and 0 < variance < math.inf
    return Fix(header, status, position, math.sqrt(variance) if known else math.nan)
