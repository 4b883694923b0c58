"""Packed images of arrays."""

import numpy as np
from numpy.typing import ArrayLike

from interloc.arrays import UInt8Array
from interloc.detection.image import BinaryImage
from interloc.kernels.bits import pack


def binary_image(image: ArrayLike, resolution_m: float = 1.0) -> BinaryImage:
    """Pack a (H, W) array; non-zero is set. A pixel is a metre, unless given."""
    is_set = np.asarray(image) != 0
    return BinaryImage(pack(is_set), is_set.shape[0], is_set.shape[1], resolution_m)


def cross(size: int = 201) -> UInt8Array:
    """Draw two lines through the middle of an array."""
    image = np.zeros((size, size), np.uint8)
    image[size // 2, :] = 1
    image[:, size // 2] = 1
    return image
