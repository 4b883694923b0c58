"""Harris scores on the centerline against those of the definition on the whole image."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import FloatArray, Int32Array, UInt8Array
from interloc.detection.image import BinaryImage
from interloc.kernels.harris import harris_scores, local_maxima
from tests.images import binary_image


def plain_harris(image: UInt8Array, block: int, k: float) -> FloatArray:
    """Score every pixel of an image that is empty outside."""
    margin = block // 2 + 1
    line = np.pad(image.astype(np.float64), margin + 1)

    def shifted(dr: int, dc: int) -> FloatArray:
        return line[1 + dr : line.shape[0] - 1 + dr, 1 + dc : line.shape[1] - 1 + dc]

    gx = sum(weight * (shifted(d, 1) - shifted(d, -1)) for d, weight in ((-1, 1), (0, 2), (1, 1)))
    gy = sum(weight * (shifted(1, d) - shifted(-1, d)) for d, weight in ((-1, 1), (0, 2), (1, 1)))
    gx, gy = gx / (4 * block), gy / (4 * block)
    scores = np.zeros(image.shape)
    for r, c in np.ndindex(image.shape):
        window = np.s_[r + 1 : r + 1 + block, c + 1 : c + 1 + block]
        a, b, d = (gx[window] ** 2).sum(), (gx[window] * gy[window]).sum(), (gy[window] ** 2).sum()
        scores[r, c] = a * d - b * b - k * (a + d) ** 2
    return scores


def plain_local_maxima(
    rows: Int32Array, cols: Int32Array, scores: FloatArray, window: int, minimum: float
) -> list[int]:
    found = []
    for i in range(len(rows)):
        near = (np.abs(rows - rows[i]) <= window // 2) & (np.abs(cols - cols[i]) <= window // 2)
        best = scores[near].max()
        first = int(np.flatnonzero(near & (scores == best))[0])
        if first == i and best >= minimum and best > 0:
            found.append(i)
    return sorted(found, key=lambda i: -scores[i])


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 12),
    st.sampled_from([1, 13, 63, 64, 65, 128]),
    st.sampled_from([3, 9, 15]),
)
@settings(deadline=None, max_examples=30)
def test_equals_the_plain_twin_up_to_the_border(seed: int, height: int, width: int, block: int) -> None:
    image = (np.random.default_rng(seed).random((height, width)) < 0.2).astype(np.uint8)
    packed = binary_image(image)
    rows, cols = packed.pixels()
    scores = harris_scores(packed.words, rows, cols, block, 0.04)
    np.testing.assert_allclose(scores, plain_harris(image, block, 0.04)[rows, cols], rtol=1e-9, atol=1e-12)


def test_image_without_lines_has_no_scores() -> None:
    empty = BinaryImage.empty(20, 20, 1.0)
    rows, cols = empty.pixels()
    scores = harris_scores(empty.words, rows, cols, 9, 0.04)
    assert scores.size == 0
    assert local_maxima(rows, cols, scores, 21, 0.0).size == 0


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.sampled_from([3, 7, 21]), st.sampled_from([0.0, 2.0]))
@settings(deadline=None)
def test_local_maxima_are_those_of_the_plain_twin(seed: int, count: int, window: int, minimum: float) -> None:
    generator = np.random.default_rng(seed)
    rows, cols = np.unique(generator.integers(0, 40, (count, 2), np.int32), axis=0).T
    scores = generator.integers(-3, 6, len(rows)).astype(np.float64)  # many equal ones
    found = local_maxima(np.ascontiguousarray(rows), np.ascontiguousarray(cols), scores, window, minimum)
    assert found.tolist() == plain_local_maxima(rows, cols, scores, window, minimum)
