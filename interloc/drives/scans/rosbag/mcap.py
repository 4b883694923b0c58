"""MCAP files: by their index, or from the beginning to the end where they have none or were cut short.

The reader of the package mcap unpacks a chunk whole, whatever it unpacks to, ends at the first damage, and makes an
object of every entry of an index: 1,000 times slower than here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.rosbag.chunks import (
    MAX_MESSAGE_BYTES,
    ChunkStream,
    DamagedChunkError,
    codec_number,
    largest_unpacked,
)
from interloc.drives.scans.rosbag.index import MAX_MESSAGES, BagIndex, Channel, reading, ros2_spelling, streams_at
from interloc.drives.scans.rosbag.wire import Encoding

MAGIC = b"\x89MCAP0\r\n"

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_DATA_END = 0x0F
PREFIX = struct.Struct("<BQ")  # of every record: its kind, its size
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK_HEAD = struct.Struct("<QQQI")  # first and last time, unpacked size, checksum
FOOTER_BYTES = PREFIX.size + 20 + len(MAGIC)
_SMALL_RECORD = 64 * 1024 * 1024
_Place = tuple[int, int, int]  # where the bytes of a chunk start, their size, their compression


class ChunkEntry(NamedTuple):
    """What a summary says of a chunk."""

    start: int
    length: int
    """Of the whole record; the index of its messages follows it."""
    index_length: int
    place: _Place
    channels: frozenset[int]
    """Those that it holds messages of."""


ENCODINGS: dict[str, Encoding] = {"cdr": "cdr", "ros1": "ros1"}


@dataclass
class Contents:
    """What was found so far."""

    schemas: dict[int, tuple[str, bool]] = field(default_factory=dict)
    """dict of int to (str, bool): name of each type, and whether its definition is there."""
    channels: dict[int, tuple[str, int, str]] = field(default_factory=dict)
    """dict of int to (str, int, str): topic, number of the schema, encoding."""
    found: dict[int, list[IntArray]] = field(default_factory=dict)
    """dict of int to list of (N, 5) int64: log time and place of the messages of each channel."""
    count: int = 0
    """Messages found."""

    def add_record(self, kind: int, content: bytes) -> None:
        """Take in a schema or a channel."""
        if kind == _SCHEMA:
            (number,) = struct.unpack_from("<H", content)
            name, at = _text(content, 2)
            _, at = _text(content, at)
            self.schemas[number] = (name, struct.unpack_from("<I", content, at)[0] > 0)
        elif kind == _CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, at = _text(content, 4)
            self.channels[number] = (topic, schema, _text(content, at)[0])

    def add_messages(self, channel: int, messages: IntArray) -> None:
        """Take in (N, 5) messages of a channel."""
        self.count += len(messages)
        if self.count > MAX_MESSAGES:
            raise ValueError(f"it holds more than {MAX_MESSAGES:,} messages")
        self.found.setdefault(channel, []).append(messages)

    def index(self, damage: str = "") -> BagIndex:
        """Return all that was found, by topic."""
        channels = []
        for number, (topic, schema, encoding) in self.channels.items():
            name, defined = self.schemas.get(schema, ("", False))
            rows = np.concatenate([np.empty((0, 5), np.int64), *self.found.get(number, [])])
            channels.append(
                Channel(
                    topic,
                    ros2_spelling(name),
                    ENCODINGS.get(encoding),
                    rows[:, 0].copy(),
                    rows[:, 1:].copy(),
                    defined,
                )
            )
        return BagIndex(channels, damage)


def index_mcap(file: SourceFile) -> BagIndex:
    """Read where the messages of a file lie, from its index.

    A file that has none, or was cut short, is looked through from its beginning: chunks are unpacked one after the
    other, and what could be read until the damage counts.

    Raises
    ------
    DriveError
        It is no MCAP file, or nothing could be read.
    """
    with reading(file), file.path.open("rb") as raw:
        magic = raw.read(len(MAGIC))
        if magic != MAGIC:
            raise file.fault(
                f"is not an MCAP file (it starts with {magic!r}; expected {MAGIC!r}). "
                "Usual cause: another file under this name, or a copy cut short."
            )
        size = raw.seek(0, 2)
        try:
            contents = _by_summary(raw, size)
        except (ValueError, struct.error, OverflowError):
            contents = None
        if contents is not None:
            return contents.index()
        contents = Contents()
        damage = _look_through(raw, size, contents)
        if damage and not contents.count:
            raise ValueError(damage)
        return contents.index(damage)


def _by_summary(raw: BinaryIO, size: int) -> Contents | None:
    """Read the summary at the end, and the indexes of the chunks; None where there is no complete one."""
    raw.seek(max(0, size - FOOTER_BYTES))
    footer = raw.read()
    if len(footer) != FOOTER_BYTES or not footer.endswith(MAGIC) or footer[0] != _FOOTER:
        return None
    (start,) = struct.unpack_from("<Q", footer, PREFIX.size)
    end = size - FOOTER_BYTES
    if not 0 < start <= end:
        return None
    raw.seek(start)
    contents, chunks = read_summary(raw.read(end - start))
    indexes = [(each.start + each.length, each.start + each.length + each.index_length) for each in chunks]
    if any(index_end > size for _, index_end in indexes):
        raise DamagedChunkError("the index of a chunk lies outside of the file")
    if not contents.channels or not chunks or not all(each.index_length for each in chunks):
        return None
    for each, (index_start, _) in zip(chunks, indexes, strict=True):
        raw.seek(index_start)
        _read_message_index(raw.read(each.index_length), each.place, contents)
    return contents


def _records_of(summary: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(summary):
        kind, length = PREFIX.unpack_from(summary, at)
        at += PREFIX.size
        if length > len(summary) - at:
            raise DamagedChunkError("a record of the summary is longer than the summary")
        yield kind, summary[at : at + length]
        at += length


def read_summary(summary: bytes) -> tuple[Contents, list[ChunkEntry]]:
    """Return the channels that a summary names, and what it says of each chunk.

    Raises
    ------
    ValueError, struct.error
        It is damaged.
    """
    contents, chunks = Contents(), []
    for kind, content in _records_of(summary):
        contents.add_record(kind, content)
        if kind == _CHUNK_INDEX:
            start, length = struct.unpack_from("<QQ", content, 16)
            (offsets,) = struct.unpack_from("<I", content, 32)
            pairs = struct.iter_unpack("<HQ", content[36 : 36 + offsets])
            (index_length,) = struct.unpack_from("<Q", content, 36 + offsets)
            compression, at = _text(content, 44 + offsets)
            (packed,) = struct.unpack_from("<Q", content, at)
            data_start = start + PREFIX.size + _CHUNK_HEAD.size + 4 + len(compression) + 8
            place = (data_start, packed, codec_number(compression))
            chunks.append(ChunkEntry(start, length, index_length, place, frozenset(channel for channel, _ in pairs)))
    return contents, chunks


def _read_message_index(records: bytes, place: _Place, contents: Contents) -> None:
    """Read which messages a chunk holds, from the records that follow it."""
    for kind, content in _records_of(records):
        if kind == _MESSAGE_INDEX:
            channel, entries = struct.unpack_from("<HI", content)
            pairs = np.frombuffer(content, "<u8", entries // 16 * 2, 6).reshape(-1, 2).astype(np.int64)
            rows = np.empty((len(pairs), 5), dtype=np.int64)
            rows[:, 0], rows[:, 1:4], rows[:, 4] = pairs[:, 0], place, pairs[:, 1]
            contents.add_messages(channel, rows)


def chunk_place(raw: BinaryIO) -> tuple[_Place, int]:
    """Return where the bytes of a chunk lie, their size and compression, and their size when unpacked."""
    _, _, unpacked, _ = _CHUNK_HEAD.unpack(raw.read(_CHUNK_HEAD.size))
    (length,) = struct.unpack("<I", raw.read(4))
    name = raw.read(min(length, 100))
    codec = codec_number(name.decode())
    (size,) = struct.unpack("<Q", raw.read(8))
    if codec and unpacked > largest_unpacked(size):
        raise DamagedChunkError(f"a chunk of {size:,} bytes is said to unpack to {unpacked:,} bytes")
    return (raw.tell(), size, codec), unpacked


def _look_through(raw: BinaryIO, size: int, contents: Contents) -> str:
    """Read a file from its beginning, past chunks that are damaged; return the first damage, or nothing."""
    at, damage = len(MAGIC), ""
    try:
        while at < size:
            raw.seek(at)
            kind, length = PREFIX.unpack(raw.read(PREFIX.size))
            if kind in {_FOOTER, _DATA_END}:
                return damage
            content_at = at + PREFIX.size
            if kind == _CHUNK:
                error = _look_through_chunk(raw, size, contents)
                if error is not None and content_at + length > size:
                    raise error
                damage = damage or ("" if error is None else f"{error} (at byte {at:,} of {size:,})")
            elif kind == MESSAGE:
                channel, _, log_ns, _ = MESSAGE_HEAD.unpack(raw.read(MESSAGE_HEAD.size))
                if content_at + length <= size:
                    contents.add_messages(channel, np.array([[log_ns, at, PREFIX.size + length, 0, 0]], np.int64))
            elif kind in {_SCHEMA, _CHANNEL}:
                contents.add_record(kind, raw.read(min(length, _SMALL_RECORD)))
            at = content_at + length
        if at > size:
            raise DamagedChunkError(f"its last record was cut short, {at - size:,} bytes before its end")
    except (ValueError, struct.error, OverflowError) as error:
        reason = str(error) if isinstance(error, DamagedChunkError) else "it ends in the middle of a record"
        return damage or f"{reason} (after {min(at, size):,} of {size:,} bytes)"
    return damage or "it has no end (the footer is missing)"


def _look_through_chunk(raw: BinaryIO, size: int, contents: Contents) -> Exception | None:
    """Find the messages of the chunk that a file of some bytes stands at; return what ended that too early."""
    try:
        (start, packed, codec), unpacked = chunk_place(raw)
        there = min(packed, size - start)
        _find_messages(ChunkStream(raw, start, there, codec), unpacked, (start, there, codec), contents)
    except (ValueError, struct.error, OverflowError) as error:
        return error
    return None


def _find_messages(stream: ChunkStream, unpacked: int, place: _Place, contents: Contents) -> None:
    while stream.position < unpacked:
        at = stream.position
        prefix = stream.read(PREFIX.size)
        if not prefix:
            raise DamagedChunkError("a chunk ends too early")
        kind, length = PREFIX.unpack(prefix)
        end = stream.position + length
        if end > unpacked:
            raise DamagedChunkError("a record is longer than its chunk")
        if kind == MESSAGE:
            channel, _, log_ns, _ = MESSAGE_HEAD.unpack(stream.exactly(MESSAGE_HEAD.size))
            if place[2]:
                stream.skip_to(end)
            elif end > place[1]:
                raise DamagedChunkError("a record is longer than its chunk")
            contents.add_messages(channel, np.array([[log_ns, *place, at]], np.int64))
        elif kind in {_SCHEMA, _CHANNEL}:
            contents.add_record(kind, stream.exactly(length))
        stream.skip_to(end)


def read_messages(path: Path, places: IntArray, limit: int = MAX_MESSAGE_BYTES) -> Iterator[bytes]:
    """Read messages in the order of their places; parameters as of `ros1.read_messages`.

    Raises
    ------
    ValueError, struct.error
        The file is damaged.
    """
    for stream in streams_at(path, places):
        kind, length = PREFIX.unpack(stream.exactly(PREFIX.size))
        if kind != MESSAGE or length < MESSAGE_HEAD.size:
            raise DamagedChunkError("its index leads to a place where no message is")
        stream.exactly(MESSAGE_HEAD.size)
        yield stream.message(length - MESSAGE_HEAD.size, limit)


def _text(content: bytes, at: int) -> tuple[str, int]:
    """Read a string of a record; return it and where the next field starts."""
    (length,) = struct.unpack_from("<I", content, at)
    end = at + 4 + length
    if end > len(content):
        raise DamagedChunkError("a record ends in the middle of a text")
    return content[at + 4 : end].decode("utf-8", "replace"), end
