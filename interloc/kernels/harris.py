"""Harris corner score (Harris and Stephens 1988) at the pixels of a centerline only.

The gradient of a binary image is zero but next to its lines, so it is computed there, once, and summed over the window
of each line pixel. Equal to OpenCV's `cornerHarris` with Sobel 3 on the image of 0 and 1, up to its rounding, except
near the border, where we take what lies outside as empty.
"""

import numpy as np

from interloc.arrays import FloatArray, Int32Array, UInt64Array
from interloc.kernels import compiled


@compiled
def harris_scores(words: UInt64Array, rows: Int32Array, cols: Int32Array, block: int, k: float) -> FloatArray:
    """Return the score det(M) - k trace(M)^2 of each line pixel, (P,) float64.

    Parameters
    ----------
    words
        Packed centerline.
    rows, cols : (P,) int32
        Its pixels in row-major order.
    block : int
        Side of the square that gradients are summed over, odd.
    k : float
        Weight of the trace.
    """
    n_rows, n_words = words.shape
    half = block // 2
    margin = half + 2
    height, width = n_rows - 2 + 2 * margin, n_words * 64 + 2 * margin
    # Products of the gradient, in one plane each; only pixels next to a line are ever written or read as non-zero.
    line, xx, yy, xy = np.zeros((4, height, width), np.int8)
    for i in range(rows.size):
        line[rows[i] + margin, cols[i] + margin] = 1
    for i in range(rows.size):
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                r, c = rows[i] + margin + dr, cols[i] + margin + dc
                gx = (
                    (line[r - 1, c + 1] + 2 * line[r, c + 1] + line[r + 1, c + 1])
                    - (line[r - 1, c - 1] + 2 * line[r, c - 1] + line[r + 1, c - 1])
                )  # fmt: skip
                gy = (
                    (line[r + 1, c - 1] + 2 * line[r + 1, c] + line[r + 1, c + 1])
                    - (line[r - 1, c - 1] + 2 * line[r - 1, c] + line[r - 1, c + 1])
                )  # fmt: skip
                xx[r, c], yy[r, c], xy[r, c] = gx * gx, gy * gy, gx * gy
    scale = 1.0 / (4.0 * block) ** 2  # OpenCV's: 1 / (2^(Sobel size - 1) * block), squared
    scores = np.empty(rows.size)
    for i in range(rows.size):
        r0, c0 = rows[i] + margin - half, cols[i] + margin - half
        a, b, c = 0, 0, 0
        for r in range(r0, r0 + block):
            for q in range(c0, c0 + block):
                a += xx[r, q]
                b += xy[r, q]
                c += yy[r, q]
        sa, sb, sc = a * scale, b * scale, c * scale
        scores[i] = sa * sc - sb * sb - k * (sa + sc) * (sa + sc)
    return scores


@compiled
def local_maxima(rows: Int32Array, cols: Int32Array, scores: FloatArray, window: int, minimum: float) -> Int32Array:
    """Return the pixels whose score is the best in a square window around them and at least ``minimum``, best first.

    They are listed row by row. Of equal neighbours the first in the list wins.
    """
    half = window // 2
    order = np.argsort(-scores, kind="mergesort")  # stable
    found = np.empty(rows.size, np.int32)
    n = 0
    for j in range(order.size):
        i = order[j]
        if scores[i] < minimum or scores[i] <= 0.0:
            break
        first, last = np.searchsorted(rows, rows[i] - half), np.searchsorted(rows, rows[i] + half + 1)
        for other in range(first, last):
            if abs(cols[other] - cols[i]) <= half:
                if scores[other] > scores[i] or (scores[other] == scores[i] and other < i):
                    break
        else:
            found[n] = i
            n += 1
    return found[:n]
