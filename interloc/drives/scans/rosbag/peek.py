"""What a bag holds, told from some ranges of its bytes: its topics, and whether their points carry labels.

For whoever has the bag elsewhere. What is read and was not given is asked for: the index at the end first, then the
chunk in which the first scan lies. A bag of SQLite (.db3) cannot be read so.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

from interloc.drives.scans.rosbag import mcap, ros1
from interloc.drives.scans.rosbag.chunks import ZSTD_MAGIC, ChunkStream, DamagedChunkError, codec_number
from interloc.drives.scans.rosbag.index import ros2_spelling
from interloc.drives.scans.rosbag.messages import FIX, POSES, TRANSFORMS
from interloc.drives.scans.rosbag.pointcloud2 import read_layout
from interloc.drives.scans.rosbag.topics import POINTS
from interloc.drives.scans.rosbag.wire import Encoding, WireError

_TAIL_BYTES = 1 << 20
_MAX_READ_BYTES = 8 << 20
_HEAD_BYTES = 4096


class MissingRangeError(Exception):
    """Bytes that were not given: from `start` to `stop`."""

    def __init__(self, start: int, stop: int) -> None:
        super().__init__(f"bytes {start} to {stop}")
        self.start, self.stop = start, stop


@dataclass(frozen=True)
class Pieces:
    """A file of which some ranges are known.

    Attributes
    ----------
    size : int
    known : mapping of int to bytes
        By where they begin.
    """

    size: int
    known: Mapping[int, bytes]

    def read(self, start: int, count: int, *, ahead: int = 0) -> bytes:
        """Return bytes, at most some megabytes; `ahead`: ask for more of them where they are missing.

        Raises
        ------
        MissingRangeError
        """
        stop = min(start + min(count, _MAX_READ_BYTES), self.size)
        for at, data in self.known.items():
            if at <= start and stop <= at + len(data):
                return data[start - at : stop - at]
        raise MissingRangeError(max(0, start - ahead), stop)


@dataclass
class BagPeek:
    """What was found.

    Attributes
    ----------
    topics : dict of str to str
        Name -> type, of those with messages.
    has_labels : bool or None
        Whether the points of the first scan carry labels; None: that could not be told.
    """

    topics: dict[str, str] = field(default_factory=dict)
    has_labels: bool | None = None

    def of(self, kind: Literal["points", "poses", "fixes"]) -> list[str]:
        """Return the names of the topics of a kind."""
        types = {"points": POINTS, "poses": (*POSES, *TRANSFORMS), "fixes": (FIX,)}[kind]
        return sorted(name for name, type_ in self.topics.items() if type_ in types)


@dataclass(frozen=True)
class _Scan:
    """The messages of a topic of points: where a chunk with one of them begins and ends, and how it is written."""

    type: str
    encoding: Encoding | None
    channel: int
    start: int
    stop: int


def peek(pieces: Pieces) -> BagPeek | None:
    """Look into a bag; None where its form, or its damage, does not let it be read so.

    Raises
    ------
    MissingRangeError
        More of the file is needed.
    """
    magic = pieces.read(0, _HEAD_BYTES)
    try:
        if magic.startswith(mcap.MAGIC):
            found, scans = _peek_mcap(pieces)
            messages = _messages_of_mcap
        elif magic.startswith(ros1.MAGIC):
            found, scans = _peek_ros1(pieces, magic)
            messages = _messages_of_ros1
        else:
            return None
        for scan in scans:
            chunk = pieces.read(scan.start, scan.stop - scan.start)
            head = next(messages(chunk, scan.channel), b"")
            if head and scan.encoding is not None and not head.startswith(ZSTD_MAGIC):
                layout = read_layout(head, scan.type, scan.encoding, complete=False)
                found.has_labels = bool(found.has_labels) or layout.has_labels
    except (ValueError, WireError, struct.error, LookupError, OverflowError):  # the check of the whole bag says why
        return None
    return found


def _peek_mcap(pieces: Pieces) -> tuple[BagPeek, list[_Scan]]:
    """Read the summary at the end of an MCAP file."""
    footer = pieces.read(pieces.size - mcap.FOOTER_BYTES, mcap.FOOTER_BYTES, ahead=_TAIL_BYTES)
    (start,) = struct.unpack_from("<Q", footer, mcap.PREFIX.size)
    if not footer.endswith(mcap.MAGIC) or not start:
        raise DamagedChunkError("it has no index")
    end = pieces.size - mcap.FOOTER_BYTES
    contents, chunks = mcap.read_summary(pieces.read(start, end - start))
    found = BagPeek()
    scans = []
    for number, (topic, schema, encoding) in contents.channels.items():
        first = next(((at, at + length) for at, length, channels in chunks if number in channels), None)
        if first is None:
            continue
        type_ = ros2_spelling(contents.schemas.get(schema, ("", False))[0])
        found.topics[topic] = type_
        if type_ in POINTS:
            scans.append(_Scan(type_, mcap.ENCODINGS.get(encoding), number, *first))
    return found, scans


def _messages_of_mcap(chunk: bytes, channel: int) -> Iterator[bytes]:
    raw = io.BytesIO(chunk)
    raw.seek(mcap.PREFIX.size)
    (start, size, codec), unpacked = mcap.chunk_place(raw)
    stream = ChunkStream(raw, start, size, codec)
    while stream.position < unpacked:
        kind, length = mcap.PREFIX.unpack(stream.exactly(mcap.PREFIX.size))
        end = stream.position + length
        if kind == mcap.MESSAGE:
            own, *_ = mcap.MESSAGE_HEAD.unpack(stream.exactly(mcap.MESSAGE_HEAD.size))
            if own == channel:
                yield stream.exactly(min(_HEAD_BYTES, length - mcap.MESSAGE_HEAD.size))
        stream.skip_to(end)


def _peek_ros1(pieces: Pieces, head: bytes) -> tuple[BagPeek, list[_Scan]]:
    """Read the connections and chunks that the index at the end of a bag of ROS 1 names."""
    header, _, _ = next(_records(head[len(ros1.MAGIC) :]))
    (index,) = struct.unpack("<Q", header["index_pos"])
    if not index:
        raise DamagedChunkError("it has no index")
    types: dict[int, tuple[str, str]] = {}
    chunks: dict[int, set[int]] = {}
    for fields, data, _ in _records(pieces.read(index, pieces.size - index, ahead=_TAIL_BYTES)):
        if fields["op"] == b"\x07":
            about = dict(_fields(data))
            (number,) = struct.unpack("<I", fields["conn"])
            types[number] = fields["topic"].decode(), ros2_spelling(about["type"].decode())
        elif fields["op"] == b"\x06":
            (at,) = struct.unpack("<Q", fields["chunk_pos"])
            counts = struct.unpack(f"<{len(data) // 4}I", data)
            chunks[at] = set(counts[::2])
    ends = [*sorted(chunks), index]
    found, scans = BagPeek(), []
    for number, (topic, type_) in types.items():
        first = next((at for at in ends[:-1] if number in chunks[at]), None)
        if first is None:
            continue
        found.topics[topic] = type_
        if type_ in POINTS:
            scans.append(_Scan(type_, "ros1", number, first, ends[ends.index(first) + 1]))
    return found, scans


def _messages_of_ros1(chunk: bytes, channel: int) -> Iterator[bytes]:
    fields, _, at = next(_records(chunk))
    raw = io.BytesIO(chunk)
    codec = codec_number(fields["compression"].decode())
    stream = ChunkStream(raw, at, len(chunk) - at, codec)
    (unpacked,) = struct.unpack("<I", fields["size"])
    while stream.position < unpacked:
        (length,) = struct.unpack("<I", stream.exactly(4))
        own = dict(_fields(stream.exactly(length)))
        (size,) = struct.unpack("<I", stream.exactly(4))
        end = stream.position + size
        if own["op"] == b"\x02" and struct.unpack("<I", own["conn"])[0] == channel:
            yield stream.exactly(min(_HEAD_BYTES, size))
        stream.skip_to(end)


def _records(data: bytes) -> Iterator[tuple[dict[str, bytes], bytes, int]]:
    """Yield the records of a bag of ROS 1: fields of the header, data as far as it is there, and where that begins."""
    at = 0
    while at + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        start = at + 4 + length + 4
        fields = dict(_fields(data[at + 4 : at + 4 + length]))
        (size,) = struct.unpack_from("<I", data, start - 4)
        yield fields, data[start : start + size], start
        at = start + size


def _fields(header: bytes) -> Iterator[tuple[str, bytes]]:
    at = 0
    while at + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        yield name.decode(), value
        at += 4 + size
