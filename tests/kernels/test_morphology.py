"""Dilation and erosion against the definition."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import UInt8Array
from interloc.detection.image import BinaryImage
from interloc.kernels.morphology import dilate, disc_half_widths, erode
from tests.images import binary_image, images

WIDTHS = [1, 63, 64, 65, 128, 131]


def disc(diameter: int) -> UInt8Array:
    """Draw the pixels whose centres lie within half a diameter of the middle."""
    offset = np.arange(diameter) - diameter // 2
    inside: UInt8Array = (4 * (offset[:, None] ** 2 + offset**2) <= diameter**2).astype(np.uint8)
    return inside


def plain_dilate(image: UInt8Array, diameter: int) -> UInt8Array:
    """Set what the disc around any set pixel covers."""
    radius = diameter // 2
    height, width = image.shape
    result = np.zeros((height + 2 * radius, width + 2 * radius), np.uint8)
    for dr, dc in np.argwhere(disc(diameter)):
        result[dr : dr + height, dc : dc + width] |= image
    return result[radius : radius + height, radius : radius + width]


def plain_erode(image: UInt8Array, diameter: int) -> UInt8Array:
    """Keep where the disc covers no clear pixel of the image."""
    return (1 - plain_dilate((1 - image).astype(np.uint8), diameter)).astype(np.uint8)


@pytest.mark.parametrize("diameter", range(1, 64, 2))
def test_half_widths_describe_the_disc(diameter: int) -> None:
    rows = disc(diameter)[diameter // 2 :].sum(axis=1)
    np.testing.assert_array_equal(2 * disc_half_widths(diameter) + 1, rows)


@pytest.mark.parametrize("diameter", [-1, 0, 2, 14])
def test_disc_of_even_diameter_is_refused(diameter: int) -> None:
    with pytest.raises(ValueError, match=f"odd number of pixels, not {diameter}"):
        disc_half_widths(diameter)


@pytest.mark.parametrize(("ours", "plain"), [(dilate, plain_dilate), (erode, plain_erode)])
@given(images(40, WIDTHS, few=0.01), st.sampled_from([1, 3, 5, 15, 31]))
@settings(deadline=None)
def test_result_is_that_of_the_definition(ours: Callable, plain: Callable, image: UInt8Array, diameter: int) -> None:
    packed = binary_image(image)
    words = ours(packed.words, disc_half_widths(diameter), packed.width)
    found = BinaryImage(words, packed.height, packed.width, 1.0).to_array()
    np.testing.assert_array_equal(found, plain(image, diameter))
