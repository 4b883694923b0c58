"""Decompression of LZF against a plain twin, and of damaged data."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.kernels.lzf import decompress_lzf
from tests.pcd_files import compress_lzf


def plainly(data: bytes) -> bytes:
    out = bytearray()
    at = 0
    while at < len(data):
        control = data[at]
        at += 1
        if control < 32:
            out += data[at : at + control + 1]
            at += control + 1
            continue
        count = control >> 5
        if count == 7:
            count += data[at]
            at += 1
        source = len(out) - ((control & 31) << 8) - data[at] - 1
        at += 1
        for k in range(count + 2):
            out.append(out[source + k])
    return bytes(out)


def unpacked(data: bytes, size: int) -> tuple[bytes, int]:
    out, written = decompress_lzf(np.frombuffer(data, np.uint8), size)
    return out.tobytes(), written


@given(st.lists(st.binary(min_size=1, max_size=12), max_size=60).map(lambda parts: b"".join(parts * 3)))
def test_what_was_packed_comes_back(raw: bytes) -> None:
    packed = compress_lzf(raw)
    assert plainly(packed) == raw
    assert unpacked(packed, len(raw)) == (raw, len(raw))


def test_a_reference_may_reach_into_what_it_writes() -> None:
    packed = bytes([0, 65, 0x60, 0])  # "A", then 3 + 2 bytes from 1 back
    assert unpacked(packed, 6) == (b"AAAAAA", 6)


def test_long_references_have_a_length_byte() -> None:
    raw = b"ab" * 150
    packed = compress_lzf(raw)
    assert len(packed) < 20
    assert unpacked(packed, len(raw)) == (raw, len(raw))


@pytest.mark.parametrize(
    ("packed", "size", "written"),
    [
        (bytes([3, 1, 2]), 4, -1),  # four bytes announced, two there
        (bytes([0, 1, 0x20]), 4, -1),  # a reference without its distance
        (bytes([0, 1, 0xE0]), 40, -1),  # nor its length
        (bytes([0, 1, 0x20, 5]), 4, -1),  # before the beginning
        (bytes([3, 1, 2, 3, 4]), 3, 4),  # more than promised
        (bytes([0, 65, 0x60, 0]), 5, 6),
        (bytes([0, 65]), 5, 1),  # less than promised
    ],
)
def test_damaged_data(packed: bytes, size: int, written: int) -> None:
    assert unpacked(packed, size)[1] == written


@given(st.binary(max_size=80), st.integers(0, 200))
def test_no_bytes_lead_out_of_bounds(data: bytes, size: int) -> None:
    out, written = unpacked(data, size)
    assert len(out) == size
    assert -1 <= written <= size + 1
