"""Messages as bytes, in the serialization of ROS 1 or in CDR, that of ROS 2: points, poses, transforms, GNSS fixes.

Only standard messages are read, and their layout is the same in all distributions of ROS 1 and of ROS 2; so nothing
depends on the definitions that a bag holds or lacks, nor on the types of other topics. The decoders of rosbags read
whole messages only, where here the beginning of a scan is enough, and make an object of every point of a Livox.
"""

import math
import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np

from interloc.arrays import Float32Array, StructuredArray, UInt32Array
from interloc.drives.scans.deskewed import TIME_FIELDS, point_times
from interloc.drives.scans.recording import LABEL_FIELDS, REMISSION_FIELDS, ScanPoints

Encoding = Literal["ros1", "cdr"]

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
            if len(data) < 4 or data[0] != 0 or data[1] > 1:
                raise WireError(f"starts with {data[:4].hex(' ') or 'nothing'}, which is not plain CDR")
            self.order = "<" if data[1] else ">"
            self._start = self._at = 4

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
    """A std_msgs/Header; 0 is a stamp that was not set, and the frame comes without the slash of old drivers."""

    stamp_ns: int
    frame_id: str


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


@dataclass(frozen=True)
class StampedPose:
    """A pose in the frame of the header at its time, or a transform between two frames."""

    header: Header
    child_frame: str
    """The frame whose pose this is; empty where the message does not name it."""
    values: tuple[float, ...]
    """x y z in metres, quaternion x y z w."""


@dataclass(frozen=True)
class Fix:
    """A position of a GNSS receiver; the frame of the header is that of the antenna."""

    header: Header
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
    return [
        StampedPose(read_header(wire), wire.text().lstrip("/"), wire.numbers("d", 7)) for _ in range(wire.count(68))
    ]


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
    known = kind != 0 and 0 < variance < math.inf
    return Fix(header, status, position, math.sqrt(variance) if known else math.nan)


# Points: PointCloud2, with fields of any order and type, and Livox's own message


POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg", "livox_interfaces/msg/CustomMsg")

MAX_POINTS = 4_000_000

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_MAX_FIELDS, _MAX_POINT_BYTES = 1000, 65_536
_LIVOX_FIELDS = (("time", "u4", 0), ("x", "f4", 4), ("y", "f4", 8), ("z", "f4", 12), ("remission", "u1", 16))
_LIVOX_BYTES = 19  # offset_time, x y z, reflectivity, tag, line


@dataclass(frozen=True)
class CloudLayout:
    """What a message says of its points; steps are bytes from point to point and from row to row."""

    header: Header
    height: int
    width: int
    dtype: np.dtype[np.void]
    """Fields x, y, z, and remission, label and time where the points have them."""
    point_step: int
    row_step: int
    data: memoryview
    """The points; of the beginning of a message, what there is of them."""
    names: tuple[str, ...] = ()
    """Of all fields, in lower case."""

    @property
    def count(self) -> int:
        """Number of points, those without a return included."""
        return self.height * self.width

    def has(self, field: Literal["remission", "label", "time"]) -> bool:
        """Return whether each point carries a remission, a label, or the time at which it was measured."""
        return field in (self.dtype.names or ())


def read_layout(data: bytes, kind: str, encoding: Encoding, *, complete: bool = True) -> CloudLayout:
    """Read what a message of some kind, or where it need not be `complete` its beginning, says of its points.

    A `WireError` where it contradicts itself, is cut short, has no x y z, or more points than any scan.
    """
    wire = Wire(data, encoding)
    header = read_header(wire)
    if kind in LIVOX:
        return _livox_layout(wire, header, complete=complete)
    height, width = wire.integer("I"), wire.integer("I")
    fields: dict[str, tuple[int, int, int]] = {}
    number = wire.count(13)
    if number > _MAX_FIELDS:
        raise WireError(f"has {number:,} fields per point; expected x, y, z and a few more")
    for _ in range(number):
        name, offset, kind_of_field, count = wire.text(), wire.integer("I"), wire.integer("B"), wire.integer("I")
        fields.setdefault(name.lower(), (offset, kind_of_field, count))
    order = ">" if wire.integer("B") else "<"
    point_step, row_step = wire.integer("I"), wire.integer("I")
    if height * width > MAX_POINTS:
        raise WireError(f"announces {height:,} x {width:,} points; no scan has more than {MAX_POINTS:,}")
    if point_step > _MAX_POINT_BYTES:
        raise WireError(f"has points of {point_step:,} bytes; expected at most {_MAX_POINT_BYTES:,}")
    block = wire.block(complete=complete)
    dtype = _dtype_of(fields, order, point_step)
    if height <= 1:
        row_step = width * point_step  # some drivers leave the field at zero
    layout = CloudLayout(header, height, width, dtype, point_step, row_step, block, tuple(fields))
    _check_sizes(layout, complete=complete)
    return layout


def _dtype_of(fields: dict[str, tuple[int, int, int]], order: str, point_step: int) -> np.dtype[np.void]:
    """Return where x, y, z, remission, label and time stand in a point."""
    missing = [axis for axis in "xyz" if axis not in fields]
    if missing:
        raise WireError(f"has no field {', '.join(missing)}; its fields are {', '.join(fields) or 'none'}")
    chosen = {axis: axis for axis in "xyz"}
    for ours, theirs in (("remission", REMISSION_FIELDS), ("label", LABEL_FIELDS), ("time", TIME_FIELDS)):
        found = next((name for name in theirs if name in fields), None)
        if found is not None:
            chosen[ours] = found
    formats, offsets = [], []
    for ours, name in chosen.items():
        offset, kind, _ = fields[name]
        if kind not in _TYPES or (ours in "xyz" and kind not in {7, 8}):
            given = np.dtype(_TYPES[kind]).name if kind in _TYPES else f"number {kind}"
            expected = "float32 or float64" if ours in "xyz" else "one of the 8 types of sensor_msgs/PointField"
            raise WireError(f"has a field {name} of type {given}; expected {expected}")
        dtype = np.dtype(order + _TYPES[kind])
        if offset + dtype.itemsize > point_step:
            raise WireError(f"has a field {name} at byte {offset:,} of points of {point_step:,} bytes")
        formats.append(dtype)
        offsets.append(offset)
    return np.dtype({"names": list(chosen), "formats": formats, "offsets": offsets, "itemsize": point_step})


def _check_sizes(layout: CloudLayout, *, complete: bool) -> None:
    """Refuse rows that are shorter than their points, and data that is shorter than its rows."""
    if not layout.count:
        return
    row = layout.width * layout.point_step
    if layout.row_step < row:
        raise WireError(
            f"has rows of {layout.row_step:,} bytes for {layout.width:,} points of {layout.point_step:,} bytes"
        )
    needed = (layout.height - 1) * layout.row_step + row
    if complete and len(layout.data) < needed:
        raise WireError(
            f"holds {len(layout.data):,} bytes of points; {layout.height:,} x {layout.width:,} points of "
            f"{layout.point_step:,} bytes need {needed:,}"
        )


def _livox_layout(wire: Wire, header: Header, *, complete: bool) -> CloudLayout:
    """Read a CustomMsg of Livox: time, number of points, device, then points of 19 bytes each."""
    wire.numbers("Q", 1)
    announced = wire.integer("I")
    wire.numbers("B", 4)
    count = wire.integer("I")
    if max(count, announced) > MAX_POINTS:
        raise WireError(f"announces {max(count, announced):,} points; no scan has more than {MAX_POINTS:,}")
    step = _LIVOX_BYTES if wire.ros1 else _LIVOX_BYTES + 1
    block = wire.rest()
    if complete and len(block) < count * step - (step - _LIVOX_BYTES):
        raise WireError(f"holds {len(block):,} bytes of points; {count:,} points need {count * step:,}")
    dtype = np.dtype(
        {
            "names": [name for name, *_ in _LIVOX_FIELDS],
            "formats": [np.dtype(wire.order + kind) for _, kind, _ in _LIVOX_FIELDS],
            "offsets": [offset for *_, offset in _LIVOX_FIELDS],
            "itemsize": _LIVOX_BYTES,
        }
    )
    return CloudLayout(header, 1, count, dtype, step, count * step, block)


def read_points(data: bytes, kind: str, encoding: Encoding) -> ScanPoints:
    """Read the points of a message; those without a return (not finite, or zero) are left out, with their labels."""
    layout = read_layout(data, kind, encoding)
    _refuse_other_order(layout)
    cells: StructuredArray = (
        np.ndarray(
            (layout.height, layout.width),
            dtype=layout.dtype,
            buffer=layout.data,
            strides=(layout.row_step, layout.point_step),
        ).reshape(-1)
        if layout.count
        else np.empty(0, layout.dtype)
    )
    values: Float32Array = np.zeros((len(cells), 4), dtype=np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for column, name in enumerate(("x", "y", "z", "remission")):
            if name in (layout.dtype.names or ()):
                values[:, column] = cells[name]
        size = np.abs(values[:, 0]) + np.abs(values[:, 1]) + np.abs(values[:, 2])
        returned = np.isfinite(size) & (size > 0)
    if layout.has("remission"):
        values[~np.isfinite(values[:, 3]), 3] = 0.0
    labels = _labels(cells["label"])[returned] if layout.has("label") else None
    times_s = point_times(cells["time"][returned], layout.header.stamp_ns / 1e9) if layout.has("time") else None
    return ScanPoints(values if returned.all() else values[returned], labels, times_s)


def is_empty(head: bytes, kind: str, encoding: Encoding) -> bool:
    """Tell by the beginning of a message whether it has no points, or none with a return."""
    try:
        layout = read_layout(head, kind, encoding, complete=False)
    except WireError:
        return False
    points = _whole_points(layout)
    with np.errstate(invalid="ignore"):
        returned = any((np.isfinite(points[axis]) & (points[axis] != 0)).any() for axis in "xyz")
    return len(points) == layout.count and not returned


def _whole_points(layout: CloudLayout) -> StructuredArray:
    """Return the points of the first row of which all bytes are there."""
    step = layout.point_step
    count = min(layout.width, len(layout.data) // step if step else 0)
    return np.ndarray((count,), dtype=layout.dtype, buffer=layout.data, strides=(step,))


def _refuse_other_order(layout: CloudLayout) -> None:
    """Refuse points that are metres only in the other byte order than the message says."""
    sample = _whole_points(layout)[:200]

    def valid(points: StructuredArray) -> bool:
        with np.errstate(invalid="ignore", over="ignore"):
            values = np.abs(np.stack([points[axis].astype(np.float64) for axis in "xyz"]))
            values = values[np.isfinite(values) & (values > 0)]
            return len(values) > 0 and float(np.mean((values > 1e-6) & (values < 1e4))) > 0.5

    if len(sample) and not valid(sample) and valid(sample.view(sample.dtype.newbyteorder())):
        big = layout.dtype["x"].byteorder == ">"
        raise WireError(
            f"says is_bigendian = {str(big).lower()}, but its coordinates are metres only in the other byte order"
        )


def _labels(ids: StructuredArray) -> UInt32Array:
    """Return label ids as they stand in a .label file; what is no id is 0, unlabelled."""
    if ids.dtype.kind == "f":
        valid = np.isfinite(ids) & (np.abs(ids) < 2**31)
        ids = np.where(valid, np.rint(np.where(valid, ids, 0)), 0)
    return (ids.astype(np.int64) & 0xFFFFFFFF).astype(np.uint32)
