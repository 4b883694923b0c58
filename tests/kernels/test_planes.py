"""Coordinates as byte planes, against their plain twin."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from interloc.arrays import UInt32Array
from interloc.kernels.planes import join_planes, split_planes

ROWS = st.integers(0, 40).flatmap(lambda n: arrays.arrays(np.uint32, (n, 3)))


def plain_planes(bits: UInt32Array) -> bytes:
    steps = np.diff(bits, axis=0, prepend=np.zeros((1, 3), np.uint32)).view(np.int32)
    folded = ((steps << 1) ^ (steps >> 31)).astype(">i4")
    return folded.view(np.uint8).reshape(-1, 3, 4).transpose(2, 1, 0).tobytes()


def test_small_steps_of_either_sign_become_small_numbers() -> None:
    bits = np.array([[0, 5, 0x01020304], [1, 4, 0x01020304], [0, 4, 0x01020303]], np.uint32)
    low = split_planes(bits).reshape(4, 3, 3)[3]
    assert low.tolist() == [[0, 2, 1], [10, 1, 0], [8, 0, 1]]
    assert split_planes(bits).reshape(4, 3, 3)[0].tolist() == [[0, 0, 0], [0, 0, 0], [2, 0, 0]]


@given(ROWS)
def test_split_is_its_plain_twin(bits: UInt32Array) -> None:
    assert split_planes(bits).tobytes() == plain_planes(bits)


@given(ROWS)
def test_join_undoes_split(bits: UInt32Array) -> None:
    again, bad_point = join_planes(split_planes(bits))
    np.testing.assert_array_equal(again, bits)
    finite = np.isfinite(bits.view(np.float32)).all(axis=1)
    assert bad_point == (-1 if finite.all() else int(np.argmin(finite)))
