"""The ground points of one scan as bytes, and back, bit by bit the same (format: `interloc.drives.reduction`)."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from interloc.drive import GroundPoints
from interloc.drives.faults import DriveFileError
from interloc.kernels.planes import join_planes, split_planes

MAX_POINTS = 4_000_000
"""A scan has 0.1 to 0.3 million; nothing larger is allocated."""

_HEADER = struct.Struct("<4sIII")
_MAGIC, _VERSION = b"ILGP", 1
_POINT_BYTES = 12
MIN_BYTES = _HEADER.size + 8
MAX_BYTES = _HEADER.size + MAX_POINTS * _POINT_BYTES * 9 // 8 + 1024
"""No file is larger, however badly its maker compresses."""

_CUT = "Usual cause: an upload or copy that did not finish."


def encode_ground(points: GroundPoints) -> bytes:
    """Write the ground points of a scan.

    Raises
    ------
    ValueError
        More than `MAX_POINTS` points, or not (N, 3) float32.
    """
    xyz = np.ascontiguousarray(points.xyz)
    if xyz.dtype != np.float32 or xyz.ndim != 2 or xyz.shape[1] != 3 or not 0 <= points.road_count <= len(xyz):
        raise ValueError(f"expected (N, 3) float32 points, at most N of them road; got {xyz.shape} {xyz.dtype}")
    if len(xyz) > MAX_POINTS:
        raise ValueError(f"{len(xyz):,} ground points; no scan has more than {MAX_POINTS:,}")
    # Runs are all that deflate finds in the planes: looking for nothing else is as small, and five times as fast.
    deflate = zlib.compressobj(strategy=zlib.Z_RLE)
    planes = split_planes(xyz.view(np.uint32))
    header = _HEADER.pack(_MAGIC, _VERSION, len(xyz), points.road_count)
    return b"".join((header, deflate.compress(planes.data), deflate.flush()))


def decode_ground(data: bytes, name: str) -> GroundPoints:
    """Read what `encode_ground` wrote; nothing in it is trusted.

    Parameters
    ----------
    data : bytes
    name : str
        Of the file, in messages.

    Raises
    ------
    DriveError
        It is no such file, cut short, damaged, or holds a point that is not finite.
    """
    count, road_count = _counts(data, name)
    size = count * _POINT_BYTES
    inflate = zlib.decompressobj()
    try:
        raw = inflate.decompress(memoryview(data)[_HEADER.size :], size + 1)  # never more than the header promises
    except zlib.error as error:
        raise DriveFileError(name, f"is damaged: {error}. {_CUT}") from None
    if len(raw) != size:
        found = f"more than {size:,}" if len(raw) > size else f"{len(raw):,} of {size:,}"
        raise DriveFileError(name, f"is damaged: its {count:,} points unpack to {found} bytes. {_CUT}")
    if not inflate.eof:
        raise DriveFileError(name, f"is damaged: the end of its {count:,} points is missing. {_CUT}")
    if inflate.unused_data:
        raise DriveFileError(
            name, f"{len(inflate.unused_data):,} bytes follow after its points. Expected nothing more."
        )
    bits, bad_point = join_planes(np.frombuffer(raw, np.uint8))
    xyz = bits.view(np.float32)
    if bad_point >= 0:
        x, y, z = xyz[bad_point]
        raise DriveFileError(
            name, f"point {bad_point:,} of {count:,} is not finite ({x:g}, {y:g}, {z:g}). Expected x y z in metres."
        )
    return GroundPoints(xyz, road_count)


def _counts(data: bytes, name: str) -> tuple[int, int]:
    """Return the counts of points and of road points that the header promises."""
    if not MIN_BYTES <= len(data) <= MAX_BYTES:
        raise DriveFileError(name, size_complaint(len(data)))
    magic, version, count, road_count = _HEADER.unpack_from(data)
    if magic != _MAGIC:
        raise DriveFileError(
            name, f"starts with {magic!r}; expected {_MAGIC!r}. Usual cause: another kind of file under this name."
        )
    if version != _VERSION:
        raise DriveFileError(
            name, f"is of version {version}; this InterLoc reads version {_VERSION}. Reduce the drive again with it."
        )
    if count > MAX_POINTS:
        raise DriveFileError(name, f"promises {count:,} points; no scan has more than {MAX_POINTS:,}.")
    if road_count > count:
        raise DriveFileError(name, f"promises {road_count:,} road points among {count:,} points.")
    return count, road_count


def size_complaint(size: int) -> str:
    """Say what is wrong with the size of a file."""
    if size == 0:
        return f"is empty. {_CUT}"
    if size < MIN_BYTES:
        return f"holds {size:,} bytes; expected at least {MIN_BYTES}. {_CUT}"
    return f"is larger than {MAX_BYTES // 1024**2} MB, which the ground points of one scan never are."
