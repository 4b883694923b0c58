"""Packed images of arrays."""

import numpy as np
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from interloc.arrays import UInt8Array
from interloc.detection.image import BinaryImage
from interloc.kernels.bits import pack


def binary_image(image: ArrayLike, resolution_m: float = 1.0) -> BinaryImage:
    """Pack a (H, W) array; non-zero is set. A pixel is a metre, unless given."""
    is_set = np.asarray(image) != 0
    return BinaryImage(pack(is_set), is_set.shape[0], is_set.shape[1], resolution_m)


@st.composite
def images(draw: st.DrawFn, most_rows: int, widths: list[int], *, few: float) -> UInt8Array:
    """Draw images of which no pixel is set, a few, half, all but a few, or all."""
    height, width = draw(st.integers(1, most_rows)), draw(st.sampled_from(widths))
    share = draw(st.sampled_from([0.0, few, 0.5, 1.0 - few, 1.0]))
    return (np.random.default_rng(draw(st.integers(0, 2**32 - 1))).random((height, width)) < share).astype(np.uint8)


def cross(size: int = 201) -> UInt8Array:
    """Draw two lines through the middle of an array."""
    image = np.zeros((size, size), np.uint8)
    image[size // 2, :] = 1
    image[:, size // 2] = 1
    return image
