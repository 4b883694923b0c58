"""One LAS or LAZ file: its header, checked before anything is allocated, and its points, block by block.

laspy and lazrs do the format. What they raise, panics of Rust among it, becomes a `DriveError`; what makes them abort,
loop or allocate without bounds (counts, offsets and sizes that lie) is refused before they see the file.
"""

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from interloc.arrays import BoolArray, FloatArray, UInt8Array, UInt16Array
from interloc.drives.files import SourceFile
from interloc.drives.findings import DriveFileError
from interloc.errors import InterLocError, install

BLOCK_POINTS = 50_000
"""Points that are read at once. LAZ is compressed in chunks of as many, which are unpacked from their beginning."""

ROAD_SURFACE = 11
"""Classification of road surfaces (ASPRS LAS 1.4, standard point classes)."""

_MAX_CLOUD_POINTS = 10_000_000_000
_MAX_RATIO = 500  # LAZ compresses clouds to 1/4 to 1/20 of their size
_MAX_HEAD_BYTES = 64 * 1024 * 1024  # header and records before the points
_MAX_EVLR_BYTES = 16 * 1024 * 1024  # records after the points; waveforms may be larger, and are not read
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}  # compressed parts of a chunk, by the kind of an item; of 14 one per byte
_CHUNK_BYTES = 20  # a chunk begins with a point that is not compressed
_USUAL = "Usual cause: a copy or download that did not finish."


class Points(NamedTuple):
    """Some points of a cloud, one after the other in the file."""

    xyz: FloatArray
    """(N, 3) float64: in the coordinate system of the file."""
    labels: UInt8Array
    """(N,) uint8: classification (ASPRS)."""
    intensity: UInt16Array
    """(N,) uint16."""
    times_s: FloatArray
    """(N,) float64: gps_time, in whichever clock; empty where the points have none."""
    withheld: BoolArray
    """(N,) bool: points that were deleted by their maker, who only marked them."""


@dataclass(frozen=True)
class Cloud:
    """A LAS or LAZ file whose header was checked; its points are read when they are asked for."""

    file: SourceFile
    size: int
    """Bytes."""
    points: int
    point_format: int
    """0 to 10 (ASPRS)."""
    reach: float
    """The largest absolute x or y that the header states."""
    has_time: bool
    """Whether its points carry gps_time."""
    read_evlrs: bool
    """There are records after the points that are worth reading (they may hold the coordinate system)."""

    def crs(self) -> Any | None:  # noqa: ANN401 - pyproj is imported late
        """Return the pyproj.CRS that the header states, or None where it states none."""
        with self._opened(read_evlrs=self.read_evlrs) as reader, in_words(self.file):
            return reader.header.parse_crs()

    def read(self, first: int = 0, last: int | None = None) -> Iterator[Points]:
        """Yield the points from one on up to another (None: to the end), at most `BLOCK_POINTS` at once."""
        stop = self.points if last is None else min(last, self.points)
        with self._opened() as reader:
            for start in range(first, stop, BLOCK_POINTS):
                expected = min(BLOCK_POINTS, stop - start)
                with in_words(self.file, f" after {start:,} of {self.points:,} points"):
                    if start and start == first:
                        reader.seek(start)
                    points = reader.read_points(expected)
                    if len(points) != expected:
                        raise self.file.fault(
                            f"ends after {start + len(points):,} of the {self.points:,} points that its header "
                            f"promises. {_USUAL}"
                        )
                    read = Points(
                        np.stack([np.asarray(points[axis], dtype=np.float64) for axis in "xyz"], axis=1),
                        np.array(points["classification"], dtype=np.uint8),
                        np.array(points["intensity"], dtype=np.uint16),
                        np.array(points["gps_time"] if self.has_time else [], dtype=np.float64),
                        np.array(points["withheld"], dtype=bool),
                    )
                yield read

    @contextmanager
    def _opened(self, *, read_evlrs: bool = False) -> Iterator[Any]:
        laspy = require_laspy(self.file.name)
        with in_words(self.file):
            some = laspy.DecompressionSelection
            wanted = some.base() | some.FLAGS | some.Z | some.CLASSIFICATION | some.INTENSITY | some.GPS_TIME
            reader = laspy.open(
                self.file.path,
                laz_backend=laspy.LazBackend.Lazrs,  # the parallel one hangs in forked processes
                read_evlrs=read_evlrs,
                decompression_selection=wanted,
            )
        with reader:
            yield reader


def all_of(clouds: Sequence[Cloud]) -> SourceFile:
    """Return what messages about all files of a drive call them: the one file, or ``*.laz`` in its folder."""
    first = clouds[0].file
    return first if len(clouds) == 1 else replace(first, path=first.path.with_name(f"*{first.path.suffix}"))


def require_laspy(name: str) -> ModuleType:
    """Import laspy with the part that unpacks LAZ."""
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


def open_cloud(file: SourceFile) -> Cloud:
    """Read the header of a file, and check what it promises against the size of the file."""
    laspy = require_laspy(file.name)
    with in_words(file), file.path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(0)
        read_evlrs = _check_records(file, size, stream.read(393))
        stream.seek(0)
        header = laspy.LasHeader.read_from(stream)
        numbers = [*header.scales, *header.offsets, *header.mins, *header.maxs]
        if not all(1e-9 <= abs(scale) <= 1e3 for scale in header.scales) or not np.all(np.abs(numbers) <= 1e12):
            listed = ", ".join(f"{number:g}" for number in numbers)
            raise file.fault(
                f"has scales, offsets and bounds with which no coordinates can be made: {listed}. "
                "Expected metres, and a scale such as 0.001. Usual cause: a damaged header."
            )
        _check_count(file, header, size - header.offset_to_point_data)
        if header.are_points_compressed:
            _check_chunks(file, header, stream, size)
        return Cloud(
            file=file,
            size=size,
            points=int(header.point_count),
            point_format=int(header.point_format.id),
            reach=float(np.abs([header.mins[:2], header.maxs[:2]]).max()),
            has_time="gps_time" in header.point_format.dimension_names,
            read_evlrs=read_evlrs,
        )


def _check_records(file: SourceFile, size: int, head: bytes) -> bool:
    """Check what laspy loops over; return whether there are records after the points that are worth reading."""
    if not size:
        raise file.fault(f"is empty. {_USUAL}")
    if head[:4] != b"LASF":
        raise file.fault(
            f"starts with {head[:4]!r}; a LAS or LAZ file starts with b'LASF'. "
            "Usual cause: another kind of file under this name."
        )
    if len(head) < 227:
        raise file.fault(f"ends within its header ({size:,} bytes). {_USUAL}")
    major, minor, header_size, offset, vlrs = struct.unpack_from("<2B68xHII", head, 24)
    if major != 1 or minor > 5:
        raise file.fault(
            f"is of LAS version {major}.{minor}; versions 1.0 to 1.5 are read. "
            "Write it as 1.4, with las2las -set_version 1.4 or pdal translate --writers.las.minor_version=4."
        )
    if not header_size <= offset <= min(size, _MAX_HEAD_BYTES) or vlrs * 54 > offset - header_size:
        raise file.fault(
            f"promises {vlrs:,} records before its points, which begin at byte {offset:,} of {size:,}; "
            f"that cannot be. {_USUAL}"
        )
    if minor < 4 or len(head) < 247:
        return False
    start, records = struct.unpack_from("<QI", head, 235)
    if records and start >= size:
        raise file.fault(f"should have records at byte {start:,}, but ends at {size:,}. {_USUAL}")
    return bool(records) and start > 0 and 60 * records <= size - start <= _MAX_EVLR_BYTES


def _check_count(file: SourceFile, header: Any, room: int) -> None:  # noqa: ANN401 - of laspy
    points, record = int(header.point_count), int(header.point_format.size)
    if not points:
        raise file.fault("holds no points. Usual cause: a tile that was cut where nothing was measured.")
    if not header.are_points_compressed and points * record > room:
        raise file.fault(
            f"promises {points:,} points of {record} bytes, but holds {room // record:,} of them. {_USUAL}"
        )
    if points > _MAX_CLOUD_POINTS:
        raise file.fault(f"promises {points:,} points; at most {_MAX_CLOUD_POINTS:,} are read.")
    if points * record > _MAX_RATIO * room:
        raise file.fault(
            f"promises {points:,} points of {record} bytes in {room:,} bytes. No cloud can be compressed that much. "
            "Usual cause: a damaged file, or one that was made to fill the memory of its reader."
        )


def _check_chunks(file: SourceFile, header: Any, stream: BinaryIO, size: int) -> None:  # noqa: ANN401 - of laspy
    """Check the table of the chunks of a LAZ file and the sizes in each, before lazrs makes room for what they say."""
    import lazrs  # noqa: PLC0415 - an extra

    start, points = int(header.offset_to_point_data), int(header.point_count)
    stream.seek(start)
    table = int.from_bytes(stream.read(8), "little", signed=True)
    if table == -1:  # written by a stream that could not go back: the last 8 bytes say where
        stream.seek(size - 8)
        table = int.from_bytes(stream.read(8), "little", signed=True)
    if not start + 8 <= table <= size - 8:
        share = min(max(size - start - 8, 0) / (table - start), 1.0) if table > start else 0.0
        raise file.fault(
            f"is cut short: the table of its compressed chunks should be at byte {table:,}, but the file ends at byte "
            f"{size:,}. About {round(share * points, -3):,.0f} of its {points:,} points are there, and without the "
            f"table they cannot be found. {_USUAL}"
        )
    stream.seek(table + 4)
    chunks = int.from_bytes(stream.read(4), "little")
    if chunks > points or chunks > (size - start) // _CHUNK_BYTES:
        raise file.fault(
            f"is damaged: the table at byte {table:,} lists {chunks:,} chunks for {points:,} points in "
            f"{size - start:,} bytes. {_USUAL}"
        )
    records = header.vlrs.get("LasZipVlr")
    items = records[0].record_data[34:] if records else b""
    kinds = list(struct.iter_unpack("<3H", items[: len(items) // 6 * 6]))
    layers = sum(_LAYERS.get(kind, length if kind == 14 else 0) for kind, length, _ in kinds)
    if not layers:
        return  # points of the older formats are compressed without sizes
    stream.seek(start)
    begin, listed, head = start + 8, 0, sum(length for _, length, _ in kinds) + 4  # a point, and how many there are
    for count, held in lazrs.read_chunk_table(stream, lazrs.LazVlr(records[0].record_data)):
        stream.seek(begin + head)
        sizes = np.frombuffer(stream.read(4 * layers), "<u4")
        promised = head + 4 * layers + int(sizes.sum(dtype=np.int64))
        if len(sizes) < layers or promised != held or begin + held > table:
            raise file.fault(
                f"is damaged: the chunk at byte {begin:,} of {held:,} bytes promises {promised:,} bytes of compressed "
                f"points. {_USUAL}"
            )
        begin, listed = begin + held, listed + count
    if listed < points:  # what is in no chunk would be read without having been checked
        raise file.fault(
            f"promises {points:,} points, and the table at byte {table:,} lists chunks of {listed:,}. {_USUAL}"
        )
