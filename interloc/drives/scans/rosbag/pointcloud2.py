"""Points of a message: sensor_msgs/PointCloud2, with fields of any order and type, and Livox's own message."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, StructuredArray, UInt32Array
from interloc.drives.scans.deskewed import TIME_FIELDS, point_times
from interloc.drives.scans.recorded import ScanPoints
from interloc.drives.scans.rosbag.messages import Encoding, Header, Wire, WireError, read_header

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg", "livox_interfaces/msg/CustomMsg")

MAX_POINTS = 4_000_000
"""Of one scan."""

REMISSION_FIELDS = ("intensity", "intensities", "remission", "reflectivity", "reflectance", "i")
LABEL_FIELDS = (
    "label",
    "labels",
    "semantic",
    "semantic_label",
    "semantic_id",
    "classification",
    "class",
    "class_id",
    "seg_label",
)

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TYPE_NAMES = {1: "int8", 2: "uint8", 3: "int16", 4: "uint16", 5: "int32", 6: "uint32", 7: "float32", 8: "float64"}
_MAX_FIELDS = 1000
_LOOKED_AT, _TINY_M, _HUGE_M, _MOST = 200, 1e-6, 1e4, 0.5
_MAX_POINT_BYTES = 65_536
_LIVOX_FIELDS = (("time", "u4", 0), ("x", "f4", 4), ("y", "f4", 8), ("z", "f4", 12), ("remission", "u1", 16))
_LIVOX_BYTES = 19  # offset_time, x y z, reflectivity, tag, line


@dataclass(frozen=True)
class CloudLayout:
    """What a message says of its points, before they are looked at."""

    header: Header
    height: int
    width: int
    """Rows and points per row."""
    dtype: np.dtype[np.void]
    """Fields x, y, z, and remission, label and time where the points have them."""
    point_step: int
    row_step: int
    """Bytes from point to point, and from row to row."""
    data: memoryview
    """The points; of the beginning of a message, what there is of them."""

    @property
    def count(self) -> int:
        """Number of points, those without a return included."""
        return self.height * self.width

    @property
    def has_labels(self) -> bool:
        """True where each point carries a label."""
        return "label" in (self.dtype.names or ())

    @property
    def has_remission(self) -> bool:
        """True where each point carries a remission."""
        return "remission" in (self.dtype.names or ())

    @property
    def has_times(self) -> bool:
        """True where each point carries the time at which it was measured."""
        return "time" in (self.dtype.names or ())


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
    layout = CloudLayout(header, height, width, dtype, point_step, row_step, block)
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
            given = _TYPE_NAMES.get(kind, f"number {kind}")
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
    if layout.has_remission:
        values[~np.isfinite(values[:, 3]), 3] = 0.0
    labels = _labels(cells["label"])[returned] if layout.has_labels else None
    times_s = None
    if layout.has_times:
        times_s = point_times(cells["time"][returned], layout.header.stamp_ns / 1e9)
    return ScanPoints(values if returned.all() else values[returned], labels, times_s)


def first_points(head: bytes, kind: str, encoding: Encoding) -> bytes | None:
    """Return the points at the beginning of a message, as they stand there.

    b"" where it has none, or none with a return; None where that cannot be told.
    """
    try:
        layout = read_layout(head, kind, encoding, complete=False)
    except WireError:
        return None
    if not layout.count:
        return b""
    points = _whole_points(layout)
    if not len(points):
        return None
    with np.errstate(invalid="ignore"):
        returned = any((np.isfinite(points[axis]) & (points[axis] != 0)).any() for axis in "xyz")
    if returned:
        return bytes(layout.data)
    return b"" if len(points) == layout.count else None


def _whole_points(layout: CloudLayout) -> StructuredArray:
    """Return the points of the first row of which all bytes are there."""
    step = layout.point_step
    count = min(layout.width, len(layout.data) // step if step else 0)
    points: StructuredArray = np.ndarray((count,), dtype=layout.dtype, buffer=layout.data, strides=(step,))
    return points


def _refuse_other_order(layout: CloudLayout) -> None:
    """Refuse points that are metres only in the other byte order than the message says."""
    told = _whole_points(layout)[:_LOOKED_AT]

    def sound(points: StructuredArray) -> bool:
        with np.errstate(invalid="ignore", over="ignore"):
            values = np.abs(np.stack([points[axis].astype(np.float64) for axis in "xyz"]))
            values = values[np.isfinite(values) & (values > 0)]
            return len(values) > 0 and float(np.mean((values > _TINY_M) & (values < _HUGE_M))) > _MOST

    if len(told) and not sound(told) and sound(told.view(told.dtype.newbyteorder())):
        big = layout.dtype["x"].byteorder == ">"
        raise WireError(
            f"says is_bigendian = {str(big).lower()}, but its coordinates are metres only in the other byte order"
        )


def _labels(ids: StructuredArray) -> UInt32Array:
    """Return label ids as they stand in a .label file; what is no id is 0, unlabelled."""
    if ids.dtype.kind == "f":
        sound = np.isfinite(ids) & (np.abs(ids) < 2**31)
        ids = np.where(sound, np.rint(np.where(sound, ids, 0)), 0)
    return (ids.astype(np.int64) & 0xFFFFFFFF).astype(np.uint32)
