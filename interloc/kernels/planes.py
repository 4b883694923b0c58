"""Coordinates as byte planes that deflate well, and back, bit by bit the same."""

from __future__ import annotations

import numpy as np

from interloc.arrays import UInt8Array, UInt32Array
from interloc.kernels import compiled


@compiled
def split_planes(bits: UInt32Array) -> UInt8Array:
    """Sort the bytes of differences along the rows by their weight.

    Parameters
    ----------
    bits : (N, 3) uint32
        Bits of float32 coordinates.

    Returns
    -------
    (12 N,) uint8
        Twelve planes of N bytes. Each value is taken as its difference to the row before (modulo 2^32, the first row
        to zero), folded so that small differences of either sign become small numbers (0, -1, 1, -2, ... as 0, 1, 2,
        3, ...), and cut into its bytes. Planes: the highest bytes of x, of y, of z, then the next lower ones.
    """
    n = bits.shape[0]
    planes = np.empty(12 * n, np.uint8)
    for c in range(3):
        before = np.uint32(0)
        for i in range(n):
            value = bits[i, c]
            step = np.int32(value - before)
            before = value
            folded = np.uint32((step << 1) ^ (step >> 31))
            planes[c * n + i] = (folded >> 24) & 0xFF
            planes[(3 + c) * n + i] = (folded >> 16) & 0xFF
            planes[(6 + c) * n + i] = (folded >> 8) & 0xFF
            planes[(9 + c) * n + i] = folded & 0xFF
    return planes


@compiled
def join_planes(planes: UInt8Array) -> tuple[UInt32Array, int]:
    """Undo `split_planes`, and look for coordinates that are not finite.

    Parameters
    ----------
    planes : (12 N,) uint8

    Returns
    -------
    bits : (N, 3) uint32
        Bits of float32 coordinates.
    bad_point : int
        The first row with an infinity or NaN; -1 where all are finite.
    """
    n = planes.shape[0] // 12
    bits = np.empty((n, 3), np.uint32)
    bad_point = n
    for c in range(3):
        value = np.uint32(0)
        for i in range(n):
            folded = (
                (np.uint32(planes[c * n + i]) << np.uint32(24))
                | (np.uint32(planes[(3 + c) * n + i]) << np.uint32(16))
                | (np.uint32(planes[(6 + c) * n + i]) << np.uint32(8))
                | np.uint32(planes[(9 + c) * n + i])
            )
            step = (folded >> np.uint32(1)) ^ (np.uint32(0) - (folded & np.uint32(1)))
            value = np.uint32(value + step)
            bits[i, c] = value
            if (value & np.uint32(0x7F800000)) == np.uint32(0x7F800000) and i < bad_point:
                bad_point = i
    return bits, bad_point if bad_point < n else -1
