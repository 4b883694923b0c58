"""Decompression of LZF, the compression of PCD files."""

from __future__ import annotations

import numpy as np

from interloc.arrays import UInt8Array
from interloc.kernels import compiled


@compiled
def decompress_lzf(data: UInt8Array, size: int) -> tuple[UInt8Array, int]:  # noqa: PLR0911 - of damaged data
    """Unpack what LZF has packed; nothing in it is trusted.

    Parameters
    ----------
    data : (P,) uint8
    size : int
        Bytes that it should unpack to.

    Returns
    -------
    (size,) uint8
        The bytes unpacked, up to where the data end or are damaged.
    int
        Number of bytes unpacked; `size` + 1 where there would be more, and -1 where the data are damaged.

    Notes
    -----
    A control byte below 32 is followed by that many bytes plus one, as they are. Any other refers to bytes unpacked
    before: its upper three bits are the length (7: one more byte adds to it) minus two, the rest and the next byte are
    the distance minus one. LibLZF of M. Lehmann has the format.
    """
    out = np.empty(size, np.uint8)
    at, to, end = 0, 0, len(data)
    while at < end:
        control = int(data[at])
        at += 1
        if control < 32:
            count = control + 1
            if at + count > end:
                return out, -1
            if to + count > size:
                return out, size + 1
            for k in range(count):
                out[to + k] = data[at + k]
            at += count
        else:
            count = control >> 5
            if count == 7:
                if at >= end:
                    return out, -1
                count += int(data[at])
                at += 1
            if at >= end:
                return out, -1
            source = to - ((control & 31) << 8) - int(data[at]) - 1
            at += 1
            count += 2
            if source < 0:
                return out, -1
            if to + count > size:
                return out, size + 1
            for k in range(count):  # byte by byte: it may reach into what it writes
                out[to + k] = out[source + k]
        to += count
    return out, to
