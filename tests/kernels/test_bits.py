"""Packed images against plain arrays."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import UInt8Array, UInt64Array
from interloc.kernels import bits
from tests.images import images

WIDTHS = [1, 2, 63, 64, 65, 127, 128, 129, 750]


def packed(image: UInt8Array) -> UInt64Array:
    """Row r of the image is row r + 1, column c is bit c % 64 of word c // 64."""
    words = [[0] * (image.shape[1] // 64 + 1) for _ in range(image.shape[0] + 2)]
    for r, c in np.argwhere(image).tolist():
        words[r + 1][c // 64] |= 1 << (c % 64)
    return np.array(words, np.uint64)


def plain_nearest_clear(image: UInt8Array, row: int, col: int, limit: int) -> float:
    rows, cols = np.nonzero(image == 0)
    return min([math.hypot(r - row, c - col) for r, c in zip(rows.tolist(), cols.tolist(), strict=True)] + [limit])


@pytest.mark.parametrize("width", WIDTHS)
def test_every_row_ends_with_an_empty_column(width: int) -> None:
    assert bits.words_for(width) * 64 > width
    assert (bits.words_for(width) - 1) * 64 <= width


@given(st.integers(0, 2**64 - 1))
@settings(deadline=None)
def test_bits_of_a_word_are_counted(x: int) -> None:
    assert bits.popcount(np.uint64(x)) == x.bit_count()


@given(st.integers(1, 2**64 - 1) | st.integers(0, 63).map(lambda i: 1 << i))
@settings(deadline=None)
def test_lowest_and_highest_bit_of_a_word_are_found(x: int) -> None:
    assert bits.lowest_bit(np.uint64(x)) == (x & -x).bit_length() - 1
    assert bits.highest_bit(np.uint64(x)) == x.bit_length() - 1


@given(images(9, WIDTHS, few=0.05))
@settings(deadline=None)
def test_images_are_packed_by_the_layout_and_unpacked_again(image: UInt8Array) -> None:
    np.testing.assert_array_equal(bits.pack(image), packed(image))
    np.testing.assert_array_equal(bits.unpack(packed(image), image.shape[1]), image)


@given(images(9, WIDTHS, few=0.05))
@settings(deadline=None)
def test_set_pixels_come_in_row_major_order(image: UInt8Array) -> None:
    rows, cols = bits.set_pixels(packed(image))
    assert (rows.dtype, cols.dtype, bits.count_pixels(packed(image))) == (np.int32, np.int32, np.count_nonzero(image))
    np.testing.assert_array_equal(np.column_stack([rows, cols]), np.argwhere(image))


@given(images(9, WIDTHS, few=0.05), st.integers(1, 80), st.data())
@settings(deadline=None)
def test_nearest_clear_pixel_is_that_of_the_plain_search(image: UInt8Array, limit: int, data: st.DataObject) -> None:
    set_pixels = np.argwhere(image).tolist()
    if not set_pixels:
        return
    row, col = data.draw(st.sampled_from(set_pixels))
    distance = bits.nearest_clear(packed(image), row, col, *image.shape, limit)
    assert distance == plain_nearest_clear(image, row, col, limit)
