"""A scan as a binary message: it comes out as it went in, and what is no scan is refused with the reason."""

import json
import struct
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.drives.folder import FolderDrive
from interloc.errors import DriveError, InterLocError
from interloc.live.scan import LiveScan, live_scan
from interloc.live.session import LiveSession
from interloc.live.wire import decode_scan, encode_scan


def scan_of(crossing: FolderDrive) -> LiveScan:
    scan = live_scan(crossing, 7)
    assert scan.fix is not None
    return scan


def test_to_the_last_digit(crossing: FolderDrive) -> None:
    scan = scan_of(crossing)
    pose = scan.T_world_lidar + np.array([[0, 0, 0, np.pi], [0, 0, 0, 1 / 3], [0, 0, 0, 0], [0, 0, 0, 0]])
    again = decode_scan(encode_scan(replace(scan, T_world_lidar=pose, time_s=1.1)))
    np.testing.assert_array_equal(again.T_world_lidar, pose)
    np.testing.assert_array_equal(again.points, scan.ground.xyz)
    assert (again.frame, again.road_count, again.time_s) == (scan.frame, scan.road_count, 1.1)
    np.testing.assert_array_equal(again.fix.R_enu_lidar, scan.fix.R_enu_lidar)
    assert (again.fix.lat_deg, again.fix.lon_deg) == (scan.fix.lat_deg, scan.fix.lon_deg)


def test_what_has_labels_is_sorted_by_the_sender() -> None:
    points, labels = np.eye(4, dtype=np.float32), np.array([40, 48, 70, 40], np.uint32)
    again = decode_scan(encode_scan(LiveScan(0, np.eye(4), points, labels)))
    np.testing.assert_array_equal(again.road_points, points[[0, 3], :3])
    np.testing.assert_array_equal(again.other_points, points[[1], :3])


def message(**changes: Any) -> bytes:
    head = {"frame": 1, "pose": np.eye(4).ravel().tolist(), "points": 2, "road_count": 1, **changes}
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    return b"ILS1" + struct.pack("<I", len(text)) + text + bytes(24)


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"", "does not begin with ILS1"),
        (b"GET / HTTP/1.1\r\n\r\n", "does not begin with ILS1"),
        (b"ILS1" + struct.pack("<I", 0xFFFFFFFC), "4,294,967,292 bytes, in a message of 8"),
        (b"ILS1" + struct.pack("<I", 3) + b"{} ", "a multiple of 4"),
        (b"ILS1" + struct.pack("<I", 4) + b"\xff\xfe{}", "head"),
        (message(points=3), "announces 3 points of 12 bytes"),
        (message(labels=True), "labels"),
        (message(points=2**40), "points: Input should be less"),
        (message(points=-1), "points"),
        (message(frame="1"), "frame"),
        (message(pose=[float("nan")] * 16), "pose.0"),
        (message(pose=[0.0]), "pose"),
        (message(road_count=3), "road_count is 3 of 2"),
        (message(more=1), "more"),
        (message(fix={"lat_deg": 91, "lon_deg": 0, "R_enu_lidar": [0.0] * 9}), "fix.lat_deg"),
    ],
)
def test_what_is_no_scan_is_refused(data: bytes, text: str) -> None:
    with pytest.raises(DriveError, match=text):
        decode_scan(data)
    assert decode_scan(message()).frame == 1


@given(st.binary(max_size=200), st.integers(0, 200), st.integers(0, 2**32 - 1))
def test_whatever_comes_is_a_scan_or_an_error_with_a_reason(noise: bytes, at: int, length: int) -> None:
    whole = message()
    for data in (whole[:at] + noise, b"ILS1" + struct.pack("<I", length) + noise, whole[:at] + whole[at + 1 :]):
        with suppress(InterLocError):
            LiveSession().push(decode_scan(data))
