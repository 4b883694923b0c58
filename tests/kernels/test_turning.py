"""Turned images against looking up each pixel."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from interloc.arrays import BoolArray
from interloc.kernels import bits
from interloc.kernels.turning import turn


def turned(image: BoolArray, size: int, angle_rad: float) -> BoolArray:
    words = np.zeros((size + 2, bits.words_for(size)), np.uint64)
    turn(bits.pack(image), len(image), angle_rad, words)
    assert not words[[0, -1]].any()
    return bits.unpack(words, size) > 0


def looked_up(image: BoolArray, size: int, angle_rad: float) -> BoolArray:
    row, col = np.mgrid[:size, :size]
    x, y, middle = col - (size - 1) / 2, (size - 1) / 2 - row, (len(image) - 1) / 2
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    places = np.rint([middle - sin * x - cos * y, middle + cos * x - sin * y]).astype(int) + 1
    return np.pad(image, 1)[tuple(np.clip(places, 0, len(image) + 1))]


@given(st.integers(0, 2**32 - 1), st.sampled_from([(70, 40), (129, 127), (200, 64), (64, 128)]), st.floats(-45, 45))
@settings(deadline=None)
def test_a_pixel_is_off_by_less_than_one(seed: int, sizes: tuple[int, int], angle_deg: float) -> None:
    image = binary_dilation(np.random.default_rng(seed).random((sizes[0], sizes[0])) < 0.003, np.ones((7, 7)))
    mine, plain = (each(image, sizes[1], math.radians(angle_deg)) for each in (turned, looked_up))
    around = np.ones((3, 3))
    edge = np.arange(sizes[1])[[0, -1]]  # what lies near comes from beyond
    for one, other in ((mine, plain), (plain, mine)):
        missing = one & ~binary_dilation(other, around)
        missing[edge] = missing[:, edge] = False
        assert not missing.any()


@pytest.mark.parametrize("angle_deg", [-45.0, -17.0, 0.0, 3.0, 45.0])
def test_turned_back_an_image_is_as_it_was(angle_deg: float) -> None:
    row, col = np.mgrid[:150, :150] - 74.5
    image = (np.random.default_rng(0).random((150, 150)) < 0.5) & (np.hypot(row, col) < 72)
    there = turned(image, 150, math.radians(angle_deg))
    np.testing.assert_array_equal(turned(there, 150, -math.radians(angle_deg)), image)
    assert there.sum() == image.sum()
    assert angle_deg == 0.0 or (there != image).any()
