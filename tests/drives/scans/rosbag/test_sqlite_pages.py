"""Rows of an SQLite database of which some pages are known."""

from __future__ import annotations

import struct

import pytest

from interloc.drives.scans.rosbag.sqlite_pages import Pages

PAGE = 512


def test_pages_that_name_each_other_over_and_over_are_damage() -> None:
    head = b"SQLite format 3\0" + struct.pack(">H", PAGE)
    data = bytearray(head.ljust(PAGE, b"\0"))
    for child in range(3, 20):  # each page names the next one 200 times, and the last one has no rows
        cells = struct.pack(">200H", *[PAGE - 4] * 200)
        data += struct.pack(">BHHHBI", 5, 0, 200, 0, 0, child) + cells + bytes(PAGE - 416) + struct.pack(">I", child)
    data += struct.pack(">BHHHB", 13, 0, 0, 0, 0).ljust(PAGE, b"\0")
    with pytest.raises(ValueError, match="no page of a table"):
        list(Pages(lambda start, count: bytes(data[start : start + count]), len(data)).rows(2))
