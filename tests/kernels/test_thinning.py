"""Zhang-Suen thinning against the published definition."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import UInt8Array
from interloc.kernels.skeleton import thin
from tests.images import binary_image

WIDTHS = [1, 2, 3, 63, 64, 65, 128]


def our_thin(image: UInt8Array) -> UInt8Array:
    packed = binary_image(image)
    thin(packed.words)
    return packed.to_array()


def plain_thin(image: UInt8Array) -> UInt8Array:
    """Thin by the definition: two sub-iterations in turn, each deletes at once, until neither deletes any.

    Zhang and Suen, "A fast parallel algorithm for thinning digital patterns", CACM 27 (1984). P2 is above the pixel P1,
    then clockwise. Delete P1 if 2 <= B(P1) <= 6, A(P1) = 1, and P2 P4 P6 = P4 P6 P8 = 0 in the first,
    P2 P4 P8 = P2 P6 P8 = 0 in the second sub-iteration.
    """
    padded = np.pad(image.astype(np.int64), 1)
    while True:
        deleted = 0
        for first in (True, False):
            p2, p3, p4 = padded[:-2, 1:-1], padded[:-2, 2:], padded[1:-1, 2:]
            p5, p6, p7 = padded[2:, 2:], padded[2:, 1:-1], padded[2:, :-2]
            p8, p9 = padded[1:-1, :-2], padded[:-2, :-2]
            ring = [p2, p3, p4, p5, p6, p7, p8, p9, p2]
            neighbours = np.sum(ring[:8], axis=0)
            transitions = np.sum([(ring[i] == 0) & (ring[i + 1] == 1) for i in range(8)], axis=0)
            sides = (p2 * p4 * p6, p4 * p6 * p8) if first else (p2 * p4 * p8, p2 * p6 * p8)
            doomed = (padded[1:-1, 1:-1] == 1) & (neighbours >= 2) & (neighbours <= 6) & (transitions == 1)
            doomed &= (sides[0] == 0) & (sides[1] == 0)
            deleted += int(doomed.sum())
            padded[1:-1, 1:-1][doomed] = 0
        if deleted == 0:
            return padded[1:-1, 1:-1].astype(np.uint8)


def blobs(seed: int, height: int, width: int, level: float) -> UInt8Array:
    """Draw smooth shapes that run over the border."""
    noise = np.random.default_rng(seed).normal(size=(height + 60, width + 60)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 5)
    return (smooth[30:-30, 30:-30] > level * smooth.std()).astype(np.uint8)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 40),
    st.sampled_from(WIDTHS),
    st.sampled_from([0, 0.1, 0.5, 0.8, 0.97, 1]),
)
@settings(deadline=None, max_examples=60)
def test_equals_the_definition_on_noise(seed: int, height: int, width: int, share: float) -> None:
    image = (np.random.default_rng(seed).random((height, width)) < share).astype(np.uint8)
    np.testing.assert_array_equal(our_thin(image), plain_thin(image))


@given(st.integers(0, 2**32 - 1), st.integers(30, 130), st.sampled_from([63, 64, 65, 128, 131]))
@settings(deadline=None, max_examples=30)
def test_equals_the_definition_on_smooth_shapes(seed: int, height: int, width: int) -> None:
    image = blobs(seed, height, width, 0.0)
    np.testing.assert_array_equal(our_thin(image), plain_thin(image))
