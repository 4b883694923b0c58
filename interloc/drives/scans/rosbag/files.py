"""The files of a bag, in MCAP, ROS 1's format or SQLite: their topics, where the messages of each lie, and these.

The small records of an index are read by the packages mcap and rosbags; only the topics that are asked for are
indexed, and of messages and chunks only as much is read and unpacked as is needed. No size that a file announces is
taken on trust: it is checked before anything of that size is read or unpacked.
"""

import bz2
import io
import sqlite3
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.rosbag.messages import Encoding

MAX_BYTES = 512 * 1024 * 1024
"""Of one message, and of one chunk when unpacked: recorders write a megabyte; a scan of 4 million points is smaller."""

MAX_MESSAGES = 20_000_000
"""Of one topic in one file: two days of an IMU at 100 Hz."""

HEAD_BYTES = 4096
"""Of a message, where its beginning is enough."""

MAGIC = {".bag": b"#ROSBAG V2.0\n", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
"""How each kind of file begins, by its suffix."""

CHUNK_START, CHUNK_BYTES, CODEC, OFFSET = range(4)
"""Columns of a place: where the chunk lies in the file, its size there, its compression, and the message in it; in a
database the row only, in the last."""

_KINDS = {".bag": "a bag of ROS 1", ".db3": "an SQLite database", ".mcap": "an MCAP file"}
_CURES = {
    ".bag": "`rosbag reindex {name}` makes the index anew",
    ".db3": "`sqlite3 {name} .recover` saves what can be read, and `ros2 bag reindex` describes it anew",
    ".mcap": "`mcap recover {name} -o recovered.mcap` writes it anew with its index, or saves what can be read",
}
_CODECS = ("", "bz2", "lz4", "zstd")  # compressions, by the number that stands for them in a place
_DAMAGE = (ArithmeticError, EOFError, LookupError, MemoryError, TypeError, ValueError, struct.error, sqlite3.Error)
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MAX_RATIO, _SMALL_BYTES = 1000, 64 * 1024 * 1024  # what more comes out of is made to fill the memory
_MAX_INDEX_BYTES = 64 * 1024 * 1024  # of some hundred gigabytes
_PIECE_BYTES, _PIECES_BYTES = 1 << 16, 1 << 24
_MESSAGE, _MESSAGE_INDEX = 5, 7  # records of MCAP
_RECORD = struct.Struct("<BQ")  # kind, size
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_INDEX_HEAD = struct.Struct("<BQHI")  # kind, size, channel, bytes of entries
_FOOTER_BYTES = _RECORD.size + 20 + len(MAGIC[".mcap"])
_PATIENCE_S, _STEPS, _ROWS = 120.0, 1_000_000, 100_000  # of queries of SQLite


class DamagedBagError(ValueError):
    """A file that contradicts itself; its text says what was found."""


@dataclass(frozen=True)
class Channel:
    """The messages of one topic in one file."""

    topic: str
    type: str
    """Spelt as in ROS 2: "sensor_msgs/msg/PointCloud2"."""
    encoding: Encoding | None
    count: int | None
    """Messages; None where only their index tells."""
    pieces: Callable[[BinaryIO], Iterator[IntArray]]
    """Read from the file, chunk by chunk, when and where the messages lie: (N, 5) int64, log time and place."""


class BagReader(io.BufferedReader):
    """A file of which nothing is read at once that is larger than any part of a bag."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes; fewer at the end."""
        if size is not None and size > MAX_BYTES:
            raise DamagedBagError(f"it announces a record of {size:,} bytes; none is larger than {MAX_BYTES:,}")
        return super().read(size)


@contextmanager
def reading(file: SourceFile) -> Iterator[None]:
    """Turn whatever a damaged bag makes its readers raise into a `DriveError` that names the file and the cure."""
    try:
        yield
    except OSError as error:
        raise file.unreadable(error) from error
    except _DAMAGE as error:
        found, cure = str(error) or type(error).__name__, _CURES[file.path.suffix.lower()].format(name=file.path.name)
        raise file.fault(
            f"is damaged: {found[:300]}. Expected a complete bag. Usual cause: a recording that was not ended "
            f"properly, or a copy cut short: {cure}."
        ) from error


def channels_of(file: SourceFile) -> list[Channel]:
    """Read which topics are in a file of a bag; of the messages themselves nothing is read."""
    suffix = file.path.suffix.lower()
    with reading(file), BagReader(io.FileIO(file.path)) as raw:
        magic = raw.read(len(MAGIC[suffix]))
        if magic != MAGIC[suffix]:
            raise file.fault(
                f"is not {_KINDS[suffix]} (it starts with {magic!r}; expected {MAGIC[suffix]!r}). Usual cause: another "
                "file under this name, a recording that was not ended properly, or a copy cut short."
            )
        if suffix == ".db3":
            with closing(_connect(file.path)) as database:
                return _db3_channels(file, database)
        return (_mcap_channels if suffix == ".mcap" else _ros1_channels)(raw)


def locate(file: SourceFile, channel: Channel) -> IntArray:
    """Return when and where the messages of a channel lie: (N, 5), log time in nanoseconds and place."""
    found, count = [np.empty((0, 5), dtype=np.int64)], 0
    with reading(file), BagReader(io.FileIO(file.path)) as raw:
        for piece in channel.pieces(raw):
            found.append(piece)
            count += len(piece)
            if count > MAX_MESSAGES:
                raise DamagedBagError(f"{channel.topic} has more than {MAX_MESSAGES:,} messages")
        if channel.count not in {None, count}:
            raise DamagedBagError(f"it holds {channel.count:,} messages of {channel.topic}, its index {count:,}")
    return np.concatenate(found)


def read_messages(file: SourceFile, places: IntArray, limit: int = MAX_BYTES) -> Iterator[bytes]:
    """Read messages of a file by their (N, 4) places: so many bytes of each, or all; unpacked if packed one by one."""
    with reading(file):
        if file.path.suffix.lower() == ".db3":
            messages = _db3_messages(file.path, places, limit)
        else:
            messages = _messages_of_file(file.path, places, limit)
        for place, message in zip(places, messages, strict=True):
            if not message.startswith(_ZSTD_MAGIC):
                yield message
            elif limit < MAX_BYTES:
                yield from read_messages(file, place[None])
            else:
                yield _Unpacked(io.BytesIO(message), 0, len(message), _CODECS.index("zstd")).read(MAX_BYTES)


# Chunks


def _codec_number(name: str) -> int:
    """Return the number that stands for a compression in a place."""
    name = "" if name == "none" else name
    if name not in _CODECS:
        raise DamagedBagError(f"compression {name[:20]!r} is not known; known are bz2, lz4 and zstd")
    return _CODECS.index(name)


def _decompressor(codec: int) -> Any:  # noqa: ANN401 - of three packages, alike
    if _CODECS[codec] == "bz2":
        return bz2.BZ2Decompressor()
    if _CODECS[codec] == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - comes with the extra

        return LZ4FrameDecompressor()
    if sys.version_info >= (3, 14):
        from compression.zstd import ZstdDecompressor  # noqa: PLC0415 - as the next
    else:
        from backports.zstd import ZstdDecompressor  # noqa: PLC0415 - comes with the extra

    return ZstdDecompressor()


def _largest_unpacked(size: int) -> int:
    """Return to how many bytes some packed bytes may unpack."""
    return min(MAX_BYTES, max(_SMALL_BYTES, _MAX_RATIO * size))


class _Unpacked(io.BytesIO):
    """A compressed chunk or message of a file, unpacked as far as it is read."""

    def __init__(self, raw: BinaryIO, start: int, size: int, codec: int) -> None:
        super().__init__()
        self._raw, self._left, self._size = raw, size, size
        self._decompressor = _decompressor(codec)
        raw.seek(start)

    def read(self, count: int | None = -1, /) -> bytes:
        assert count is not None
        at, maximum = self.tell(), _largest_unpacked(self._size)
        self.seek(0, 2)
        while self.tell() < at + count and not self._decompressor.eof:
            packed = b""
            if self._decompressor.needs_input:
                packed = self._raw.read(min(_PIECE_BYTES, self._left))
                self._left -= len(packed)
                if not packed:
                    raise DamagedBagError("a compressed chunk or message ends too early")
            try:
                wanted = max(at + count - self.tell(), _PIECE_BYTES)
                self.write(self._decompressor.decompress(packed, min(wanted, _PIECES_BYTES)))
            except Exception as error:  # whatever each of the packages raises
                raise DamagedBagError(f"a chunk cannot be unpacked ({error})") from error
            if self.tell() > maximum:
                raise DamagedBagError(f"a chunk of {self._size:,} bytes unpacks to more than {maximum:,}")
        self.seek(at)
        return super().read(count)


def _exactly(stream: BinaryIO, count: int) -> bytes:
    data = stream.read(count)
    if len(data) != count:
        raise DamagedBagError("it ends in the middle of a record")
    return data


def _messages_of_file(path: Path, places: IntArray, limit: int) -> Iterator[bytes]:
    """Read messages of an MCAP file or a bag of ROS 1; every chunk is unpacked once if their places ascend."""
    read_one = _mcap_message if path.suffix.lower() == ".mcap" else _ros1_message
    with BagReader(io.FileIO(path)) as raw:
        for (start, size, codec), chunk in groupby(places.tolist(), key=lambda place: tuple(place[:OFFSET])):
            stream = _Unpacked(raw, start, size, codec) if codec else raw
            for *_, offset in chunk:
                if offset >= size and not codec:
                    raise DamagedBagError("its index leads out of a chunk")
                stream.seek(offset if codec else start + offset)
                yield read_one(stream, limit)


def _rest(raw: BinaryIO, start: int) -> io.BytesIO:
    size = raw.seek(0, 2) - start
    if not 0 <= size <= _MAX_INDEX_BYTES:
        raise DamagedBagError(f"its index has {size:,} bytes; expected at most {_MAX_INDEX_BYTES:,}")
    raw.seek(start)
    return io.BytesIO(raw.read(size))


# MCAP


def _mcap_channels(raw: BinaryIO) -> list[Channel]:
    """Read which channels an MCAP file has, from the summary at its end."""
    from mcap import records as kinds  # noqa: PLC0415 - it is an extra
    from mcap.exceptions import McapError  # noqa: PLC0415
    from mcap.stream_reader import StreamReader  # noqa: PLC0415

    size = raw.seek(0, 2)
    raw.seek(max(0, size - _FOOTER_BYTES))
    footer = raw.read(_FOOTER_BYTES)
    if len(footer) != _FOOTER_BYTES or not footer.endswith(MAGIC[".mcap"]):
        raise DamagedBagError("its end is missing, and with it the index")
    (start,) = struct.unpack_from("<Q", footer, _RECORD.size)
    if not start:
        raise DamagedBagError("it has no summary, and with it no index")
    try:
        records = list(StreamReader(_rest(raw, start), skip_magic=True, emit_chunks=True).records)
    except McapError as error:
        raise DamagedBagError(f"its summary cannot be read ({error or type(error).__name__})") from error
    schemas = {record.id: record for record in records if isinstance(record, kinds.Schema)}
    channels = [record for record in records if isinstance(record, kinds.Channel)]
    counts = next((each.channel_message_counts for each in records if isinstance(each, kinds.Statistics)), {})
    chunks = [record for record in records if isinstance(record, kinds.ChunkIndex)]
    places: dict[int, list[tuple[int, ...]]] = {}
    for chunk in chunks:
        if chunk.compression and chunk.uncompressed_size > _largest_unpacked(chunk.compressed_size):
            raise DamagedBagError(
                f"a chunk of {chunk.compressed_size:,} bytes is said to unpack to {chunk.uncompressed_size:,} bytes"
            )
        head_bytes = _RECORD.size + 28 + 4 + len(chunk.compression.encode()) + 8
        place = (chunk.chunk_start_offset + head_bytes, chunk.compressed_size, _codec_number(chunk.compression))
        for number, at in chunk.message_index_offsets.items():
            places.setdefault(number, []).append((*place, at))
    if chunks and not (channels and schemas and (counts or places)):
        raise DamagedBagError("its summary lacks the channels, their schemas or the index of the messages")
    encodings: dict[str, Encoding] = {"cdr": "cdr", "ros1": "ros1"}
    found = []
    for record in channels:
        schema = schemas.get(record.schema_id)
        name = "" if schema is None else _ros2_spelling(schema.name)
        count = counts.get(record.id, 0) if counts else None
        indexed = partial(_locate_in_mcap, record.id, places.get(record.id, []))
        pieces = indexed if chunks else partial(_locate_without_chunks, record.id, start)
        found.append(Channel(record.topic, name, encodings.get(record.message_encoding), count, pieces))
    return found


def _locate_in_mcap(number: int, chunks: list[tuple[int, ...]], raw: BinaryIO) -> Iterator[IntArray]:
    for *place, at in chunks:
        raw.seek(at)
        kind, _, channel, size = _INDEX_HEAD.unpack(_exactly(raw, _INDEX_HEAD.size))
        if kind != _MESSAGE_INDEX or channel != number:
            raise DamagedBagError("its summary leads to a place where no index is")
        entries = np.frombuffer(_exactly(raw, size), "<u8").reshape(-1, 2).astype(np.int64)
        yield _rows(entries[:, 0], place, entries[:, 1])


def _locate_without_chunks(number: int, end: int, raw: BinaryIO) -> Iterator[IntArray]:
    """Find messages that lie in the file one by one and without an index, as the fastest settings of recorders do."""
    at = len(MAGIC[".mcap"])
    while at < end:
        raw.seek(at)
        kind, size = _RECORD.unpack(_exactly(raw, _RECORD.size))
        if kind == _MESSAGE:
            channel, _, log_ns, _ = _MESSAGE_HEAD.unpack(_exactly(raw, _MESSAGE_HEAD.size))
            if channel == number:
                yield np.array([[log_ns, at, _RECORD.size + size, 0, 0]], dtype=np.int64)
        at += _RECORD.size + size


def _rows(log_ns: IntArray, place: list[int], offsets: IntArray) -> IntArray:
    rows = np.empty((len(offsets), 5), dtype=np.int64)
    rows[:, 0], rows[:, 1:4], rows[:, 4] = log_ns, place, offsets
    return rows


def _mcap_message(stream: BinaryIO, limit: int) -> bytes:
    kind, size = _RECORD.unpack(_exactly(stream, _RECORD.size))
    if kind != _MESSAGE or size < _MESSAGE_HEAD.size:
        raise DamagedBagError("its index leads to a place where no message is")
    stream.seek(_MESSAGE_HEAD.size, 1)
    return _exactly(stream, min(size - _MESSAGE_HEAD.size, limit))


def _ros2_spelling(name: str) -> str:
    """Spell the name of a type as ROS 2 does: "sensor_msgs/PointCloud2" is "sensor_msgs/msg/PointCloud2"."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


# ROS 1


def _ros1_channels(raw: BinaryIO) -> list[Channel]:
    """Read which connections a bag of ROS 1 has, and which chunks hold their messages, from the index at its end."""
    from rosbags.rosbag1.reader import Header, Reader, ReaderError, RecordType  # noqa: PLC0415 - it is an extra

    raw.seek(len(MAGIC[".bag"]))
    try:
        head = Header.read(raw, RecordType.BAGHEADER)
        if head.get("encryptor"):
            raise DamagedBagError("it is encrypted")
        if not (start := head.get_uint64("index_pos")):
            raise DamagedBagError("it has no index")
        reader = Reader.__new__(Reader)  # it would open the file by its name, and index every message
        reader.bio = _rest(raw, start)
        connections = [reader.read_connection() for _ in range(head.get_uint32("conn_count"))]
        infos = [reader.read_chunk_info() for _ in range(head.get_uint32("chunk_count"))]
    except ReaderError as error:
        raise DamagedBagError(f"its index is incomplete ({str(error).rstrip('.')})") from error
    chunks: dict[int, list[tuple[int, int]]] = {each.id: [] for each in connections}
    counts = dict.fromkeys(chunks, 0)
    for info in infos:
        for number, count in info.connection_counts.items():
            chunks[number].append((info.pos, len(info.connection_counts)))
            counts[number] += count
    return [
        Channel(each.topic, each.msgtype, "ros1", counts[each.id], partial(_locate_in_ros1, each.id, chunks[each.id]))
        for each in connections
    ]


def _locate_in_ros1(number: int, chunks: list[tuple[int, int]], raw: BinaryIO) -> Iterator[IntArray]:
    for at, connections in chunks:
        raw.seek(at)
        codec = _codec_number(_ros1_header(raw).get_string("compression"))
        (size,) = struct.unpack("<I", _exactly(raw, 4))
        place = [raw.tell(), size, codec]
        raw.seek(size, 1)
        for _ in range(connections):
            head = _exactly(raw, 55)  # its size; ver, conn, count and op, in any order; the size of the entries
            (size,) = struct.unpack_from("<I", head, 51)
            if struct.unpack_from("<I", head, head.index(b"conn=") + 5) != (number,):
                raw.seek(size, 1)
                continue
            seconds, nanoseconds, offsets = np.frombuffer(_exactly(raw, size), "<u4").reshape(-1, 3).astype(np.int64).T
            yield _rows(seconds * 10**9 + nanoseconds, place, offsets)


def _ros1_header(stream: BinaryIO) -> Any:  # noqa: ANN401 - of rosbags, which is imported late
    from rosbags.rosbag1.reader import Header, ReaderError  # noqa: PLC0415 - it is an extra

    try:
        return Header.read(stream)
    except ReaderError as error:
        raise DamagedBagError(f"its index leads to a place where no record is ({str(error).rstrip('.')})") from error


def _ros1_message(stream: BinaryIO, limit: int) -> bytes:
    for _ in range(1000):  # records of connections may stand before the message
        kind = _ros1_header(stream).get("op")
        (size,) = struct.unpack("<I", _exactly(stream, 4))
        if kind == b"\x02":
            return _exactly(stream, min(size, limit))
        if kind != b"\x07":
            break
        stream.seek(size, 1)
    raise DamagedBagError("its index leads to a place where no message is")


# SQLite


def _db3_channels(file: SourceFile, database: sqlite3.Connection) -> list[Channel]:
    """Read the topics of a bag of SQLite, and the rows of their messages."""
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"topics", "messages"} <= tables:
        raise file.fault(
            f"is a database without the tables of a bag (it has {', '.join(sorted(tables)[:5]) or 'none'}). "
            "Expected topics and messages, as `ros2 bag record` writes them."
        )
    rows = _rows_of(database)
    rows = rows[np.argsort(rows[:, 1], kind="stable")]
    found = []
    for number, name, kind, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
        own = rows[slice(*np.searchsorted(rows[:, 1], [int(number), int(number) + 1]))]
        places = np.zeros((len(own), 5), dtype=np.int64)
        places[:, 0], places[:, 1 + OFFSET] = own[:, 2], own[:, 0]
        wire: Encoding | None = "cdr" if encoding == "cdr" else None
        found.append(Channel(str(name), _ros2_spelling(str(kind)), wire, len(own), partial(_given, places)))
    return found


def _given(places: IntArray, _: BinaryIO) -> Iterator[IntArray]:
    return iter([places])


def _connect(path: Path) -> sqlite3.Connection:
    """Open a database that nothing may be written to, nor be done with for ever."""
    unfinished = path.with_name(path.name + "-wal")
    kept = "" if unfinished.is_file() and unfinished.stat().st_size else "&immutable=1"
    address = f"file:{quote(str(path.absolute()))}?mode=ro{kept}"
    database = sqlite3.connect(address, uri=True, check_same_thread=False)  # what is left may be closed by any thread
    deadline = time.monotonic() + _PATIENCE_S
    database.set_progress_handler(lambda: int(time.monotonic() > deadline), _STEPS)
    database.execute("PRAGMA trusted_schema = OFF")
    return database


def _rows_of(database: sqlite3.Connection) -> IntArray:
    """Return (N, 3) row, topic and time of all messages."""
    cursor = database.execute("SELECT rowid, topic_id, timestamp FROM messages")
    pieces = [np.empty((0, 3), dtype=np.int64)]
    while rows := cursor.fetchmany(_ROWS):
        pieces.append(np.array(rows, dtype=np.int64))
        if len(pieces) > MAX_MESSAGES // _ROWS:
            raise DamagedBagError(f"it holds more than {MAX_MESSAGES:,} messages")
    return np.concatenate(pieces)


def _db3_messages(path: Path, places: IntArray, limit: int) -> Iterator[bytes]:
    with closing(_connect(path)) as database:
        for place in places:
            with database.blobopen("messages", "data", int(place[OFFSET]), readonly=True) as blob:
                if len(blob) > MAX_BYTES:
                    raise DamagedBagError(f"it has a message of {len(blob):,} bytes; none is larger than {MAX_BYTES:,}")
                yield blob.read(min(len(blob), limit))
