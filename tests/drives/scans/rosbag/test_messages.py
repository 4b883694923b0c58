"""Points of messages: any fields, padding, rows and no returns; and messages that contradict themselves."""

import struct
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from interloc.drives.scans.rosbag.messages import (
    LIVOX,
    POINT_CLOUD,
    Encoding,
    Wire,
    WireError,
    read_fix,
    read_header,
    read_points,
    read_pose,
)
from tests.bags import LIVOX as LIVOX_DEFINITION
from tests.bags import BagWriter

XYZ = np.array([[1, 2, 3], [-4, 5, -6], [7, -8, 9]], dtype=np.float32)


@pytest.fixture(params=["bag", "db3"])
def maker(request: pytest.FixtureRequest, tmp_path: Any) -> BagWriter:
    return BagWriter(tmp_path / "unused.bag", request.param)


def encoding(maker: BagWriter) -> Encoding:
    return "ros1" if maker.ros1 else "cdr"


def serialized(maker: BagWriter, cells: np.ndarray, **changes: Any) -> bytes:
    sent = []
    maker.write = lambda _topic, kind, _time, message: sent.append(  # type: ignore[method-assign]
        (maker.store.serialize_ros1 if maker.ros1 else maker.store.serialize_cdr)(message, kind)
    )
    maker.cloud("/points", 12.5, cells, **changes)
    return bytes(sent[0])


def cells(names: list[str], formats: list[str], offsets: list[int], size: int) -> np.ndarray:
    layout: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
    made = np.zeros(3, dtype=layout)
    for column, axis in enumerate("xyz"):
        made[axis] = XYZ[:, column]
    return made


def test_fields_may_stand_in_any_order_with_gaps_and_end_padding(maker: BagWriter) -> None:
    made = cells(
        ["ring", "z", "reflectivity", "x", "y", "t"],
        ["<u2", "<f4", "<u2", "<f4", "<f4", "<u4"],
        [40, 8, 30, 16, 0, 20],
        48,
    )
    made["reflectivity"] = [100, 200, 65535]
    points = read_points(serialized(maker, made), POINT_CLOUD, encoding(maker))
    assert np.array_equal(points.values, np.column_stack([XYZ, [100, 200, 65535]]).astype(np.float32))
    assert points.labels is None


def test_points_may_be_big_endian_and_double(maker: BagWriter) -> None:
    made = cells(["x", "y", "z", "I"], [">f8", ">f8", ">f8", ">i2"], [0, 8, 16, 24], 26)
    made["I"] = [-1, 2, 300]
    points = read_points(serialized(maker, made), POINT_CLOUD, encoding(maker))
    assert points.values.dtype == np.float32
    assert np.array_equal(points.values, np.column_stack([XYZ, [-1, 2, 300]]).astype(np.float32))


@pytest.mark.parametrize("kind", ["<u1", "<u4", "<i4", "<f4", "<f8"])
def test_labels_may_have_any_type(maker: BagWriter, kind: str) -> None:
    made = cells(["x", "y", "z", "label"], ["<f4", "<f4", "<f4", kind], [0, 4, 8, 16], 24)
    made["label"] = [40, 48, 255]
    points = read_points(serialized(maker, made), POINT_CLOUD, encoding(maker))
    assert points.labels.dtype == np.uint32
    assert points.labels.tolist() == [40, 48, 255]
    assert not points.values[:, 3].any()


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, 0.0])
def test_points_without_a_return_are_left_out_with_their_labels(maker: BagWriter, nothing: float) -> None:
    made = cells(["x", "y", "z", "label"], ["<f4", "<f4", "<f4", "<u2"], [0, 4, 8, 12], 14)
    made["label"] = [1, 2, 3]
    for axis in "xyz":
        made[axis][1] = nothing
    points = read_points(serialized(maker, made), POINT_CLOUD, encoding(maker))
    assert np.array_equal(points.values[:, :3], XYZ[[0, 2]])
    assert points.labels.tolist() == [1, 3]


def test_rows_of_an_organised_cloud_may_be_padded(maker: BagWriter) -> None:
    made = cells(["x", "y", "z"], ["<f4", "<f4", "<f4"], [0, 4, 8], 16)
    row = made.tobytes() + b"\xff" * 20
    data = np.frombuffer(row * 2, np.uint8)
    message = serialized(maker, made, height=2, width=3, row_step=len(row), data=data)
    points = read_points(message, POINT_CLOUD, encoding(maker))
    assert np.array_equal(points.values[:, :3], np.concatenate([XYZ, XYZ]))


@pytest.mark.parametrize(("changes", "words"), [
    ({"width": 4}, "1 x 4 points of 12 bytes need 48"),
    ({"width": 2**32 - 1, "height": 2**32 - 1}, "no scan has more than"),
    ({"width": 5_000_000}, "no scan has more than"),
    ({"point_step": 8}, "field z at byte 8 of points of 8 bytes"),
    ({"height": 3, "width": 1, "row_step": 4}, "rows of 4 bytes for 1 points of 12 bytes"),
    ({"point_step": 2**32 - 1}, "points of 4,294,967,295 bytes"),
    ({"point_step": 1000}, "need 3,000"),
    ({"fields": []}, "no field x, y, z"),
])  # fmt: skip
def test_a_cloud_that_contradicts_itself_is_refused(maker: BagWriter, changes: dict[str, Any], words: str) -> None:
    made = cells(["x", "y", "z"], ["<f4", "<f4", "<f4"], [0, 4, 8], 12)
    with pytest.raises(WireError, match=words):
        read_points(serialized(maker, made, **changes), POINT_CLOUD, encoding(maker))


def test_integers_as_coordinates_are_refused(maker: BagWriter) -> None:
    made = cells(["x", "y", "z"], ["<i2", "<i2", "<i2"], [0, 2, 4], 6)
    with pytest.raises(WireError, match="field x of type int16; expected float32"):
        read_points(serialized(maker, made), POINT_CLOUD, encoding(maker))


def test_a_message_cut_anywhere_is_refused(maker: BagWriter) -> None:
    message = serialized(maker, cells(["x", "y", "z"], ["<f4", "<f4", "<f4"], [0, 4, 8], 12))
    for length in range(len(message) - 5):
        with pytest.raises(WireError):
            read_points(message[:length], POINT_CLOUD, encoding(maker))


def test_the_message_of_livox_is_read(maker: BagWriter) -> None:
    store = get_typestore(Stores.ROS1_NOETIC if maker.ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(LIVOX_DEFINITION, LIVOX[1]))
    point = store.types["livox_ros_driver2/msg/CustomPoint"]
    points = [point(10 * row, *map(float, xyz), 50 + row, 0, 1) for row, xyz in enumerate(XYZ)]
    header = store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"](12, 5)
    message = store.types[LIVOX[1]](
        header(*((0,) if maker.ros1 else ()), stamp, "livox"), 7, 3, 0, np.zeros(3, np.uint8), points
    )
    raw = bytes((store.serialize_ros1 if maker.ros1 else store.serialize_cdr)(message, LIVOX[1]))
    read = read_points(raw, LIVOX[1], encoding(maker))
    assert np.array_equal(read.values, np.column_stack([XYZ, [50, 51, 52]]).astype(np.float32))
    with pytest.raises(WireError, match="points need"):
        read_points(raw[:-8], LIVOX[1], encoding(maker))


def test_cdr_may_be_big_endian() -> None:
    head = b"\0\0\0\0" + struct.pack(">iII", 12, 500, 4) + b"map\0"
    header = read_header(Wire(head, "cdr"))
    assert (header.stamp_ns, header.frame_id) == (12_000_000_500, "map")
    fix = read_fix(head + struct.pack(">bxH4x3d", -1, 1, 49.0, 8.0, 100.0), "cdr")
    assert (fix.status, fix.position) == (-1, (49.0, 8.0, 100.0))


@pytest.mark.parametrize("data", [b"", b"\1", b"\0\3\0\0", b"PK\3\4"])
def test_other_encodings_are_refused(data: bytes) -> None:
    with pytest.raises(WireError, match="not plain CDR"):
        read_pose(data, "nav_msgs/msg/Odometry", "cdr")
