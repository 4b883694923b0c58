"""What a bag holds, told from some ranges of its bytes: its topics, and whether their points carry labels.

For whoever has the bag elsewhere. What is read and was not given is asked for: the index at the end first, then the
chunk in which the first scan lies; of a bag of SQLite (.db3) its first pages, then those with the first messages.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from typing import Literal

from interloc.drives.scans.rosbag import db3, mcap, ros1
from interloc.drives.scans.rosbag.chunks import ZSTD_MAGIC, ChunkStream, DamagedChunkError, codec_number
from interloc.drives.scans.rosbag.index import ros2_spelling
from interloc.drives.scans.rosbag.messages import FIX, POSES, TRANSFORMS
from interloc.drives.scans.rosbag.pointcloud2 import read_layout
from interloc.drives.scans.rosbag.sqlite_pages import Pages
from interloc.drives.scans.rosbag.topics import POINTS
from interloc.drives.scans.rosbag.wire import Encoding, WireError

_TAIL_BYTES = 1 << 20
_MAX_READ_BYTES = 8 << 20
_HEAD_BYTES = 4096
_MAX_TOPICS = 1000
_MAX_MESSAGES = 200  # of a bag of SQLite; the first scan is among them, or not looked for


class MissingRangeError(Exception):
    """Bytes that were not given: from `start` to `stop`."""

    def __init__(self, start: int, stop: int) -> None:
        super().__init__(f"bytes {start} to {stop}")
        self.start, self.stop = start, stop


@dataclass(frozen=True)
class Pieces:
    """A file of which some ranges are known."""

    size: int
    known: Mapping[int, bytes]
    """By where they begin."""

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
    """What was found."""

    topics: dict[str, str] = field(default_factory=dict)
    """Name -> type, of those with messages."""
    has_labels: bool | None = None
    """Whether the points of the first scan carry labels; None: that could not be told."""

    def of(self, kind: Literal["points", "poses", "fixes"]) -> list[str]:
        """Return the names of the topics of a kind."""
        types = {"points": POINTS, "poses": (*POSES, *TRANSFORMS), "fixes": (FIX,)}[kind]
        return sorted(name for name, type_ in self.topics.items() if type_ in types)

    def look_at(self, head: bytes, type_: str, encoding: Encoding | None) -> None:
        """Tell from the first bytes of a message of points whether they carry labels."""
        if head and encoding is not None and not head.startswith(ZSTD_MAGIC):
            self.has_labels = bool(self.has_labels) or read_layout(head, type_, encoding, complete=False).has_labels


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
        elif magic.startswith(db3.MAGIC):
            return _peek_db3(pieces)
        else:
            return None
        for scan in scans:
            chunk = pieces.read(scan.start, scan.stop - scan.start)
            found.look_at(next(messages(chunk, scan.channel), b""), scan.type, scan.encoding)
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
        first = next(((each.start, each.start + each.length) for each in chunks if number in each.channels), None)
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
            about = ros1.fields_of(data)
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
        own = ros1.fields_of(stream.exactly(length))
        (size,) = struct.unpack("<I", stream.exactly(4))
        end = stream.position + size
        if own["op"] == b"\x02" and struct.unpack("<I", own["conn"])[0] == channel:
            yield stream.exactly(min(_HEAD_BYTES, size))
        stream.skip_to(end)


def _peek_db3(pieces: Pieces) -> BagPeek:
    """Read the topics of a bag of SQLite, and the first message of those with points."""
    database = Pages(pieces.read, pieces.size)
    roots = {row[1]: int(str(row[3])) for row in database.rows(1) if row[0] == "table"}
    found, topics = BagPeek(), {}
    for number, name, type_, encoding, *_ in islice(database.rows(roots["topics"]), _MAX_TOPICS):
        found.topics[str(name)] = ros2_spelling(str(type_))
        topics[number] = found.topics[str(name)], encoding
    waiting = {number for number, (type_, _) in topics.items() if type_ in POINTS}
    try:
        for _, number, _, head in islice(database.rows(roots["messages"]), _MAX_MESSAGES):
            if number in waiting and isinstance(head, bytes):
                waiting.remove(number)
                type_, encoding = topics[number]
                found.look_at(head, type_, "cdr" if encoding == "cdr" else None)
            if not waiting:
                break
    except MissingRangeError:
        if found.has_labels is None:
            raise
    if waiting and not found.has_labels:
        found.has_labels = None  # what was not seen may carry them
    return found


def _records(data: bytes) -> Iterator[tuple[dict[str, bytes], bytes, int]]:
    """Yield the records of a bag of ROS 1: fields of the header, data as far as it is there, and where that begins."""
    at = 0
    while at + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        start = at + 4 + length + 4
        fields = ros1.fields_of(data[at + 4 : at + 4 + length])
        (size,) = struct.unpack_from("<I", data, start - 4)
        yield fields, data[start : start + size], start
        at = start + size
