"""Selection of the points that carry wanted labels, in one pass over a scan."""

import numpy as np

from interloc.arrays import Float32Array, UInt8Array, UInt32Array
from interloc.kernels import compiled


@compiled
def select_points(points: Float32Array, labels: UInt32Array, group_of: UInt8Array) -> tuple[Float32Array, int, int]:
    """Pick the points of two groups of labels, those of the first group in front.

    Parameters
    ----------
    points : (N, 4) float32
        x, y, z in L, metres, and the remission, which is not kept.
    labels : (N,) uint32
        The label id is in the lower 16 bits.
    group_of : (65536,) uint8
        Group of every label id: 1 (road), 2 (confusable), anything else is left out.

    Returns
    -------
    xyz : (M, 3) float32
        Points of group 1, then those of group 2, each in the order of the scan.
    first_group : int
        Number of points of group 1.
    bad_point : int
        Row of `points` of the first kept point that is not finite; -1 where all are.
    """
    n = labels.shape[0]
    first, second = 0, 0
    for i in range(n):
        group = group_of[labels[i] & 0xFFFF]
        first += group == 1
        second += group == 2

    xyz = np.empty((first + second, 3), np.float32)
    a, b, bad_point = 0, first, -1
    for i in range(n):
        group = group_of[labels[i] & 0xFFFF]
        if group == 1:
            to = a
            a += 1
        elif group == 2:
            to = b
            b += 1
        else:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        xyz[to, 0], xyz[to, 1], xyz[to, 2] = x, y, z
        if bad_point < 0 and not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
            bad_point = i
    return xyz, first, bad_point
