"""Packed images of arrays."""

import numpy as np
from numpy.typing import ArrayLike

from interloc.detection.image import BinaryImage


def binary_image(image: ArrayLike, resolution_m: float = 1.0) -> BinaryImage:
    """Pack a (H, W) array; non-zero is set. A pixel is a metre, unless given."""
    is_set = np.asarray(image, order="C") != 0
    found = BinaryImage.empty(*is_set.shape, resolution_m)
    wide = np.pad(is_set, ((1, 1), (0, 64 * found.words.shape[1] - found.width)))
    found.words[:] = np.packbits(wide, axis=1, bitorder="little").view("<u8")
    return found
