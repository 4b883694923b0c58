"""One LAS or LAZ file: its header, checked before anything is allocated, and its points, block by block.

The points are decoded by laspy and lazrs. What they raise, panics of Rust among it, becomes a `DriveError`; what makes
them abort or allocate without bounds (counts and offsets that lie) is refused before they see the file.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, Literal

import numpy as np

from interloc.arrays import BoolArray, FloatArray, UInt8Array, UInt16Array
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError
from interloc.errors import InterLocError, install

BLOCK_POINTS = 50_000
"""Points that are read at once. LAZ is compressed in chunks of as many, which are unpacked from their beginning."""

MAX_CLOUD_POINTS = 10_000_000_000
MAX_RATIO = 500
"""LAZ compresses clouds to 1/4 to 1/20 of their size; what promises more than this is no cloud."""

ROAD_SURFACE = 11
"""Classification of road surfaces (ASPRS LAS 1.4, standard point classes)."""

ADJUSTED_OFFSET_S = 1e9
"""Adjusted standard time is the seconds of GPS since 6 January 1980 minus these."""

_MAX_HEAD_BYTES = 64 * 1024 * 1024  # header and records before the points
_MAX_EVLR_BYTES = 16 * 1024 * 1024  # records after the points; waveforms may be larger, and are not read
_WITH_TIME = frozenset({1, 3, 4, 5, 6, 7, 8, 9, 10})
_HEAD_BYTES = 393  # of LAS 1.5, the longest
_HEADER = struct.Struct("<4sHH16sBB32s32sHHHIIBHI20s12d")
_LAS14 = struct.Struct("<QIQ")
_TIME_OFFSET_FLAG = 1 << 6
_COMPRESSED, _FORMAT_BITS = 0b1100_0000, 0b0011_1111
_CHUNK_BYTES = 20  # a chunk begins with a point that is not compressed
_USUAL = "Usual cause: a copy or download that did not finish."

Field = Literal["xyz", "labels", "intensity", "time"]


@dataclass(frozen=True)
class CloudFile:
    """A LAS or LAZ file whose header was checked; its points are read when they are asked for."""

    file: SourceFile
    size: int
    """Bytes."""
    points: int
    point_format: int
    """0 to 10 (ASPRS)."""
    minimum: tuple[float, float, float]
    maximum: tuple[float, float, float]
    """Bounds of x, y, z that the header states."""
    compressed: bool
    standard_time: bool
    """The header states that times are adjusted standard GPS time, not seconds of the GPS week. Not all do so rightly.
    """
    time_offset_s: float = ADJUSTED_OFFSET_S
    """What was subtracted from adjusted standard time."""
    read_evlrs: bool = False
    """There are records after the points that are worth reading (they may hold the coordinate system)."""

    @property
    def has_time(self) -> bool:
        """Whether its points carry gps_time."""
        return self.point_format in _WITH_TIME

    @property
    def blocks(self) -> int:
        """Number of its blocks."""
        return -(-self.points // BLOCK_POINTS)

    def crs(self) -> Any | None:  # noqa: ANN401 - pyproj is imported late
        """Return the pyproj.CRS that the header states, or None where it states none.

        Raises
        ------
        DriveError
            The statement is damaged.
        """
        with _opened(self, frozenset(), read_evlrs=self.read_evlrs) as reader, in_words(self.file):
            return reader.header.parse_crs()

    def read(self, block: int = 0, count: int | None = None, fields: frozenset[Field] = frozenset()) -> Iterator[Block]:
        """Yield some blocks, one after the other, from one on (all: ``count`` None).

        Raises
        ------
        DriveError
            The file cannot be read, or is damaged there.
        """
        last = self.blocks if count is None else min(block + count, self.blocks)
        with _opened(self, fields) as reader:
            if block:
                with in_words(self.file, f" at point {block * BLOCK_POINTS:,} of {self.points:,}"):
                    reader.seek(block * BLOCK_POINTS)
            for number in range(block, last):
                first = number * BLOCK_POINTS
                expected = min(BLOCK_POINTS, self.points - first)
                with in_words(self.file, f" after {first:,} of {self.points:,} points"):
                    points = reader.read_points(expected)
                    if len(points) != expected:
                        raise self.file.fault(
                            f"ends after {first + len(points):,} of the {self.points:,} points that its header "
                            f"promises. {_USUAL}"
                        )
                    block_read = Block.of(points, fields, with_time=self.has_time)
                yield block_read


@dataclass(frozen=True)
class Block:
    """Some points of a cloud, one after the other in the file; what was not asked for is empty."""

    xyz: FloatArray
    """(N, 3) float64: in the coordinate system of the file."""
    labels: UInt8Array
    """(N,) uint8: classification (ASPRS)."""
    intensity: UInt16Array
    """(N,) uint16."""
    times_s: FloatArray
    """(N,) float64: gps_time, in whichever clock."""
    withheld: BoolArray
    """(N,) bool: points that were deleted by their maker, who only marked them."""

    @classmethod
    def of(cls, points: Any, fields: frozenset[Field], *, with_time: bool) -> Block:  # noqa: ANN401 - a laspy record
        """Take the fields that are asked for out of a record of laspy."""
        count = len(points)
        xyz = np.stack([np.asarray(points[axis], dtype=np.float64) for axis in "xyz"], axis=1) if "xyz" in fields else 0
        return cls(
            xyz=np.empty((0, 3)) if isinstance(xyz, int) else xyz,
            labels=np.array(points["classification"] if "labels" in fields else [], dtype=np.uint8),
            intensity=np.array(points["intensity"] if "intensity" in fields else [], dtype=np.uint16),
            times_s=np.array(points["gps_time"] if "time" in fields and with_time else [], dtype=np.float64),
            withheld=np.array(points["withheld"], dtype=bool) if count else np.zeros(0, dtype=bool),
        )


def all_of(clouds: Sequence[CloudFile]) -> SourceFile:
    """Return what messages about all files of a drive call them: the one file, or ``*.laz`` in its folder."""
    first = clouds[0].file
    return first if len(clouds) == 1 else replace(first, path=first.path.with_name(f"*{first.path.suffix}"))


def require_laspy(name: str) -> ModuleType:
    """Import laspy with the part that unpacks LAZ.

    Raises
    ------
    DriveError
        One of them is not installed.
    """
    try:
        import laspy  # noqa: PLC0415 - an extra
        import lazrs  # noqa: F401, PLC0415
    except ImportError as error:
        raise DriveFileError(
            name,
            f"needs the package {error.name or 'laspy'} to be read, which is not installed. "
            f"Install it: {install('las')}",
        ) from error
    module: ModuleType = laspy
    return module


@contextmanager
def in_words(file: SourceFile, place: str = "") -> Iterator[None]:
    """Turn whatever laspy and lazrs raise, panics of Rust among it, into a `DriveError`."""
    try:
        yield
    except (InterLocError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except MemoryError:
        raise file.fault(f"is damaged{place}: it asks for more memory than there is.") from None
    except OSError as error:
        raise file.unreadable(error) from error
    except BaseException as error:  # pyo3's PanicException is no Exception
        if not (isinstance(error, Exception) or type(error).__name__ == "PanicException"):
            raise
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise file.fault(f"is damaged{place} ({why}). {_USUAL}") from error


@contextmanager
def _opened(cloud: CloudFile, fields: frozenset[Field], *, read_evlrs: bool = False) -> Iterator[Any]:
    """Open a file whose header was checked, to unpack some fields of its points only."""
    laspy = require_laspy(cloud.file.name)
    with in_words(cloud.file):
        selection = laspy.DecompressionSelection
        wanted = selection.base() | selection.FLAGS
        for field, parts in {
            "xyz": selection.Z,
            "labels": selection.CLASSIFICATION,
            "intensity": selection.INTENSITY,
            "time": selection.GPS_TIME,
        }.items():
            if field in fields:
                wanted |= parts
        reader = laspy.open(
            cloud.file.path,
            laz_backend=laspy.LazBackend.Lazrs,  # the parallel one hangs in forked processes
            read_evlrs=read_evlrs,
            decompression_selection=wanted,
        )
    try:
        yield reader
    finally:
        reader.close()


def read_cloud_header(file: SourceFile) -> CloudFile:
    """Read the header of a file, and check what it promises against the size of the file.

    Raises
    ------
    DriveError
        It is not a LAS or LAZ file of version 1.0 to 1.5, cut short, or promises what cannot be.
    """
    try:
        size = os.stat(file.path).st_size  # noqa: PTH116 - as elsewhere here, a plain number
        with file.path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
            cloud = _checked(file, size, head)
            if cloud.compressed and cloud.points:
                stream.seek(_offset_to_points(head))
                _check_chunk_table(cloud, head, stream)
    except OSError as error:
        raise file.unreadable(error) from error
    return cloud


def _offset_to_points(head: bytes) -> int:
    return int(struct.unpack_from("<I", head, 96)[0])


def _checked(file: SourceFile, size: int, head: bytes) -> CloudFile:
    if not size:
        raise file.fault(f"is empty. {_USUAL}")
    if head[:4] != b"LASF":
        raise file.fault(
            f"starts with {head[:4]!r}; a LAS or LAZ file starts with b'LASF'. "
            "Usual cause: another kind of file under this name."
        )
    if len(head) < _HEADER.size:
        raise file.fault(f"ends within its header ({size:,} bytes). {_USUAL}")
    _, _, encoding, _, major, minor, _, _, _, _, header_size, offset, vlrs, id_bits, record, points, _, *numbers = (
        _HEADER.unpack_from(head)
    )
    if major != 1 or minor > 5:
        raise file.fault(
            f"is of LAS version {major}.{minor}; versions 1.0 to 1.5 are read. "
            "Write it as 1.4, with las2las -set_version 1.4 or pdal translate --writers.las.minor_version=4."
        )
    point_format = id_bits & _FORMAT_BITS
    compressed = bool(id_bits & _COMPRESSED)
    if point_format > 10:
        raise file.fault(f"is of point format {point_format}; 0 to 10 are read.")
    read_evlrs, time_offset_s = False, ADJUSTED_OFFSET_S
    if minor >= 4:
        points, read_evlrs, time_offset_s = _newer(file, size, head, minor, header_size)
    if not header_size <= offset <= min(size, _MAX_HEAD_BYTES) or vlrs * 54 > offset - header_size:
        raise file.fault(
            f"promises {vlrs:,} records before its points, which begin at byte {offset:,} of {size:,}; "
            f"that cannot be. {_USUAL}"
        )
    minimum, maximum = _bounds(file, numbers)
    _check_count(file, points, record, size - offset, compressed=compressed)
    return CloudFile(
        file=file,
        size=size,
        points=points,
        point_format=point_format,
        minimum=minimum,
        maximum=maximum,
        compressed=compressed,
        standard_time=bool(encoding & 1),
        time_offset_s=time_offset_s,
        read_evlrs=read_evlrs,
    )


def _newer(file: SourceFile, size: int, head: bytes, minor: int, header_size: int) -> tuple[int, bool, float]:
    """Return what LAS 1.4 and 1.5 added: count of points, whether to read the records after them, offset of times."""
    complete = 375 if minor == 4 else _HEAD_BYTES
    if len(head) < complete or header_size < complete:
        raise file.fault(f"has a header of {header_size:,} bytes; LAS 1.{minor} has {complete}. {_USUAL}")
    encoding = int(struct.unpack_from("<H", head, 6)[0])
    offset_s = ADJUSTED_OFFSET_S
    if minor == 5 and encoding & _TIME_OFFSET_FLAG:
        offset_s = 1e6 * struct.unpack_from("<H", head, 391)[0]
    start, records, points = _LAS14.unpack_from(head, 235)
    if records and start >= size:
        raise file.fault(f"should have records at byte {start:,}, but ends at {size:,}. {_USUAL}")
    read_evlrs = bool(records) and start > 0 and 60 * records <= size - start <= _MAX_EVLR_BYTES
    return points, read_evlrs, offset_s


_Triple = tuple[float, float, float]


def _bounds(file: SourceFile, numbers: list[float]) -> tuple[_Triple, _Triple]:
    scales, offsets, bounds = numbers[:3], numbers[3:6], numbers[6:]
    if not (all(1e-9 <= abs(scale) <= 1e3 for scale in scales) and all(abs(value) <= 1e9 for value in offsets)):
        raise file.fault(
            f"has the scales {_listed(scales)} and offsets {_listed(offsets)}, with which no coordinates can be made. "
            "Expected a scale such as 0.001. Usual cause: a damaged header."
        )
    if not all(abs(value) <= 1e12 for value in bounds):
        raise file.fault(
            f"has bounds that are not numbers of metres: {_listed(bounds)}. Usual cause: a damaged header."
        )
    return (bounds[1], bounds[3], bounds[5]), (bounds[0], bounds[2], bounds[4])


def _listed(numbers: list[float]) -> str:
    return ", ".join(f"{number:g}" for number in numbers)


def _check_count(file: SourceFile, points: int, record: int, room: int, *, compressed: bool) -> None:
    if not compressed and points * record > room:
        raise file.fault(
            f"promises {points:,} points of {record} bytes, but holds {room // max(record, 1):,} of them. {_USUAL}"
        )
    if points > MAX_CLOUD_POINTS:
        raise file.fault(f"promises {points:,} points; at most {MAX_CLOUD_POINTS:,} are read.")
    if compressed and points * record > MAX_RATIO * room:
        raise file.fault(
            f"promises {points:,} points of {record} bytes in {room:,} bytes. No cloud can be compressed that much. "
            "Usual cause: a damaged file, or one that was made to fill the memory of its reader."
        )


def _check_chunk_table(cloud: CloudFile, head: bytes, stream: Any) -> None:  # noqa: ANN401 - an open file
    """Check where the table of the chunks of a LAZ file lies, and how many it lists, before lazrs makes room for it."""
    start = _offset_to_points(head)
    room = cloud.size - start
    raw = stream.read(8)
    if len(raw) < 8:
        raise cloud.file.fault(f"ends where its points begin. {_USUAL}")
    table = int.from_bytes(raw, "little", signed=True)
    if table == -1:  # written by a stream that could not go back: the last 8 bytes say where
        stream.seek(cloud.size - 8)
        table = int.from_bytes(stream.read(8), "little", signed=True)
    if not start + 8 <= table <= cloud.size - 8:
        share = min(max(room - 8, 0) / (table - start), 1.0) if table > start else 0.0
        about = f"about {round(share * cloud.points, -3):,.0f}" if share else "none"
        raise cloud.file.fault(
            f"is cut short: the table of its compressed chunks should be at byte {table:,}, but the file ends at byte "
            f"{cloud.size:,}. {about} of its {cloud.points:,} points are there, and without the table they cannot be "
            f"found. {_USUAL}"
        )
    stream.seek(table)
    version, chunks = struct.unpack("<II", stream.read(8))
    if version != 0 or chunks > cloud.points or chunks > room // _CHUNK_BYTES:
        raise cloud.file.fault(
            f"is damaged: the table at byte {table:,} lists {chunks:,} chunks for {cloud.points:,} points in {room:,} "
            f"bytes. {_USUAL}"
        )
