"""Coordinates as byte planes, against the loops of the format's description."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from interloc.arrays import UInt32Array
from interloc.drives.scans.reduced_format import from_planes, to_planes

ROWS = st.integers(0, 40).flatmap(lambda n: arrays.arrays(np.uint32, (n, 3)))


def described_planes(bits: UInt32Array) -> bytes:
    n = len(bits)
    planes = bytearray(12 * n)
    for c in range(3):
        before = 0
        for i, value in enumerate(bits[:, c].tolist()):
            step = (value - before) % 2**32
            before = value
            folded = ((step << 1) % 2**32) ^ (2**32 - 1 if step >> 31 else 0)
            for k in range(4):
                planes[(3 * k + c) * n + i] = folded >> (24 - 8 * k) & 0xFF
    return bytes(planes)


def test_small_steps_of_either_sign_become_small_numbers() -> None:
    bits = np.array([[0, 5, 0x01020304], [1, 4, 0x01020304], [0, 4, 0x01020303]], np.uint32)
    planes = np.frombuffer(to_planes(bits), np.uint8).reshape(4, 3, 3)
    assert planes[3].tolist() == [[0, 2, 1], [10, 1, 0], [8, 0, 1]]
    assert planes[0].tolist() == [[0, 0, 0], [0, 0, 0], [2, 0, 0]]


@given(ROWS)
def test_planes_are_as_described(bits: UInt32Array) -> None:
    assert to_planes(bits) == described_planes(bits)


@given(ROWS)
def test_planes_give_back_their_coordinates(bits: UInt32Array) -> None:
    np.testing.assert_array_equal(from_planes(to_planes(bits)), bits)
