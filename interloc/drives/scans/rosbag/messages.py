"""Messages as bytes: the serialization of ROS 1, and CDR, that of ROS 2; poses, transforms and GNSS fixes.

Only standard messages are read, and their layout is the same in all distributions of ROS 1 and of ROS 2; so nothing
depends on the definitions that a bag holds or lacks, nor on the types of other topics. The decoders of rosbags read
whole messages only, where here the beginning of a scan is enough, and make an object of every point of a Livox.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Literal

Encoding = Literal["ros1", "cdr"]

_CDR_HEADER = 4
_SIZES = {"b": 1, "B": 1, "H": 2, "i": 4, "I": 4, "f": 4, "d": 8, "Q": 8}


class WireError(ValueError):
    """Bytes that are not the message that they should be; its text says what was found."""


class Wire:
    """Reads one message, or its beginning, from its first byte on; `order` is the byte order of its numbers.

    Whatever contradicts that is a `WireError`, here and below.
    """

    def __init__(self, data: bytes, encoding: Encoding) -> None:
        self.data = data
        self.ros1 = encoding == "ros1"
        self.order = "<"
        self._start = self._at = 0
        if not self.ros1:
            if len(data) < _CDR_HEADER or data[0] != 0 or data[1] > 1:
                raise WireError(f"starts with {data[:_CDR_HEADER].hex(' ') or 'nothing'}, which is not plain CDR")
            self.order = "<" if data[1] else ">"
            self._start = self._at = _CDR_HEADER

    def numbers(self, code: str, count: int) -> tuple[float, ...]:
        """Read numbers of one type: b B H i I f d Q, as in `struct`."""
        size = _SIZES[code]
        self._align(size)
        if self._at + size * count > len(self.data):
            raise WireError(f"ends after {len(self.data):,} bytes, in the middle of its fields")
        values = struct.unpack_from(f"{self.order}{count}{code}", self.data, self._at)
        self._at += size * count
        return values

    def integer(self, code: str) -> int:
        """Read one integer."""
        return int(self.numbers(code, 1)[0])

    def count(self, bytes_each: int = 1) -> int:
        """Read how many elements a sequence has, each of at least some bytes."""
        count = self.integer("I")
        if count * bytes_each > len(self.data) - self._at:
            raise WireError(f"announces {count:,} elements, and only {len(self.data) - self._at:,} bytes follow")
        return count

    def text(self) -> str:
        """Read a string."""
        size = self.count()
        raw = self.data[self._at : self._at + size]
        self._at += size
        return raw.rstrip(b"\0").decode("utf-8", "replace")

    def block(self, *, complete: bool = True) -> memoryview:
        """Read a sequence of bytes; what there is of it, where it need not be complete."""
        size = self.count() if complete else self.integer("I")
        block = memoryview(self.data)[self._at : self._at + size]
        self._at += size
        return block

    def rest(self) -> memoryview:
        """Return what follows, aligned to four bytes in CDR."""
        self._align(4)
        return memoryview(self.data)[self._at :]

    def _align(self, size: int) -> None:
        if not self.ros1:
            self._at += -(self._at - self._start) % size


@dataclass(frozen=True)
class Header:
    """A std_msgs/Header."""

    stamp_ns: int
    """0 where it was not set."""
    frame_id: str
    """Without the slash in front of it that old drivers write."""


def read_header(wire: Wire) -> Header:
    """Read the header that stamped messages start with."""
    if wire.ros1:
        wire.integer("I")  # seq
    seconds, nanoseconds = (wire.integer("I" if wire.ros1 else "i"), wire.integer("I"))
    return Header(seconds * 1_000_000_000 + nanoseconds, wire.text().lstrip("/"))


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
    """Read an Odometry, a PoseStamped or a PoseWithCovarianceStamped."""
    wire = Wire(data, encoding)
    header = read_header(wire)
    child = wire.text().lstrip("/") if kind == ODOMETRY else ""
    return StampedPose(header, child, wire.numbers("d", 7))


def read_transforms(data: bytes, encoding: Encoding) -> list[StampedPose]:
    """Read a TFMessage: transforms that lead from their child frame into the frame of their header."""
    wire = Wire(data, encoding)
    transforms = []
    for _ in range(wire.count(_TRANSFORM_BYTES)):
        header = read_header(wire)
        child = wire.text().lstrip("/")
        transforms.append(StampedPose(header, child, wire.numbers("d", 7)))
    return transforms


def read_fix(data: bytes, encoding: Encoding) -> Fix:
    """Read a NavSatFix."""
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
