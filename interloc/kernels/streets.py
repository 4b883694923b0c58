"""Loops along streets: what is near their stations, values around stations, systems that link neighbours."""

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.kernels import compiled


def nearest(points: FloatArray, others: FloatArray, within_m: float, maximum: int = 1) -> tuple[FloatArray, IntArray]:
    """Return distance and row, (N, most) and nearest first, of what is near (N, 2) points of (M, 2) others, M > 0.

    Where there is no more within a distance, the distance is infinite and the row means nothing.
    """
    axis = int(np.argmax(np.ptp(others, axis=0)))  # along which fewest are near
    order = np.argsort(others[:, axis], kind="stable")
    ends = np.add.outer([-within_m, within_m], points[:, axis])
    distance, at = _near(points, others[order], np.searchsorted(others[order, axis], ends), within_m, maximum)
    return np.where(distance < within_m, distance, np.inf), order[at]


@compiled
def _near(
    xy: FloatArray, others: FloatArray, span: IntArray, within: float, maximum: int
) -> tuple[FloatArray, IntArray]:
    distance = np.full((len(xy), maximum), within)
    row = np.zeros((len(xy), maximum), np.int64)
    for i in range(len(xy)):
        for j in range(span[0, i], span[1, i]):
            x, y = xy[i, 0] - others[j, 0], xy[i, 1] - others[j, 1]
            apart = np.sqrt(x * x + y * y)
            if apart < distance[i, -1]:
                k = maximum - 1
                while k > 0 and apart < distance[i, k - 1]:
                    distance[i, k], row[i, k] = distance[i, k - 1], row[i, k - 1]
                    k -= 1
                distance[i, k], row[i, k] = apart, j
    return distance, row


@compiled
def ranked(values: FloatArray, size: int, rank: int) -> FloatArray:
    """Return the value of a rank, from 0, in a window of odd size around each of (N,) finite values; the ends go on."""
    window = np.full(size, values[0])  # in ascending order
    result = np.empty_like(values)
    for i in range(-(size // 2), len(values)):
        new, old = values[min(i + size // 2, len(values) - 1)], values[max(i - 1 - size // 2, 0)]
        at = np.searchsorted(window, old)
        while at + 1 < size and window[at + 1] < new:
            window[at] = window[at + 1]
            at += 1
        while at > 0 and window[at - 1] > new:
            window[at] = window[at - 1]
            at -= 1
        window[at] = new
        if i >= 0:
            result[i] = window[rank]
    return result


@compiled
def solve_banded(bands: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a positive definite system for (N, R) right sides, given as (N, B): its diagonal and those beside that."""
    rows, x = bands.copy(), right.copy()
    count, width = rows.shape
    for i in range(count):  # Cholesky's decomposition, without roots
        for k in range(1, min(width, count - i)):
            share = rows[i, k] / rows[i, 0]
            for other in range(k, width):
                rows[i + k, other - k] -= share * rows[i, other]
            for side in range(x.shape[1]):
                x[i + k, side] -= share * x[i, side]
    for i in range(count - 1, -1, -1):
        for side in range(x.shape[1]):
            x[i, side] /= rows[i, 0]
            for k in range(1, min(width, count - i)):
                x[i, side] -= rows[i, k] / rows[i, 0] * x[i + k, side]
    return x


def compile_for_streets() -> None:
    """Compile what lies here where this machine has none of it yet."""
    nearest(np.eye(2), np.eye(2), 1.0)
    ranked(np.zeros(3), 3, 1)
    solve_banded(np.ones((2, 1)), np.ones((2, 2)))
