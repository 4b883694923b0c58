"""ROS 1 bags: the index by rosbags, messages by their place in it."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.rosbag.chunks import MAX_MESSAGE_BYTES, ChunkStream, DamagedChunkError, codec_number
from interloc.drives.scans.rosbag.index import MAX_MESSAGES, BagIndex, Channel, reading, streams_at

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _CONNECTION = b"\x02", b"\x07"


def index_ros1(file: SourceFile) -> BagIndex:
    """Read where the messages of a bag lie; of the messages themselves nothing is read.

    Raises
    ------
    DriveError
        It is no bag of ROS 1, damaged, encrypted, or without an index.
    """
    from rosbags.rosbag1 import Reader, ReaderError  # noqa: PLC0415 - it is an extra

    with reading(file):
        with file.path.open("rb") as raw:
            magic = raw.read(len(MAGIC))
        if magic != MAGIC:
            raise file.fault(
                f"does not start as a bag of ROS 1 does ({magic[:12]!r}; expected {MAGIC[:12]!r}). "
                "Usual cause: another file under this name, or a bag of before ROS 1.2 (`rosbag fix`)."
            )
        try:
            with Reader(file.path) as reader:
                return _index_of(reader)
        except ReaderError as error:
            if "not indexed" in str(error):
                raise file.fault(
                    "has no index: its recording was not ended properly. Make one with `rosbag reindex`, "
                    "or convert it with `rosbags-convert` where that is not installed."
                ) from error
            raise ValueError(str(error).rstrip(".")) from error


def _index_of(reader: Any) -> BagIndex:  # noqa: ANN401 - of rosbags, which is imported late
    """Gather what the reader of rosbags found, without its objects."""
    codecs = {}
    names = {id(function): name for name, function in _rosbags_decompressors().items()}
    for position, chunk in reader.chunks.items():
        codecs[position] = (chunk.datapos, chunk.datasize, codec_number(names[id(chunk.decompressor)]))
    if sum(len(entries) for entries in reader.indexes.values()) > MAX_MESSAGES:
        raise ValueError(f"it holds more than {MAX_MESSAGES:,} messages")
    channels = []
    for connection in reader.connections:
        entries = reader.indexes[connection.id]
        places = np.array([(*codecs[entry.chunk_pos], entry.offset) for entry in entries], dtype=np.int64).reshape(
            -1, 4
        )
        log_ns = np.array([entry.time for entry in entries], dtype=np.int64)
        channels.append(Channel(connection.topic, connection.msgtype, "ros1", log_ns, places))
    return BagIndex(channels)


def _rosbags_decompressors() -> dict[str, object]:
    from rosbags.rosbag1.reader import decompressors  # noqa: PLC0415 - it is an extra

    return dict(decompressors)


def read_messages(path: Path, places: IntArray, limit: int = MAX_MESSAGE_BYTES) -> Iterator[bytes]:
    """Read messages in the order of their places; every chunk is unpacked once.

    Parameters
    ----------
    path : Path
    places : (N, 4) int64
        Ascending.
    limit : int
        Bytes of each that are enough.

    Raises
    ------
    ValueError, struct.error
        The bag is damaged.
    """
    for stream in streams_at(path, places):
        yield _message(stream, limit)


def _message(stream: ChunkStream, limit: int) -> bytes:
    # Records of connections may stand before the message.
    for _ in range(1000):
        header = stream.exactly(_uint32(stream))
        kind = fields_of(header).get("op")
        size = _uint32(stream)
        if kind == _MESSAGE:
            return stream.message(size, limit)
        if kind != _CONNECTION:
            break
        stream.skip_to(stream.position + size)
    raise DamagedChunkError("its index leads to a place where no message is")


def _uint32(stream: ChunkStream) -> int:
    return int(struct.unpack("<I", stream.exactly(4))[0])


def fields_of(header: bytes) -> dict[str, bytes]:
    """Return the fields of a record from its header, a list of name=value with their sizes."""
    fields, at = {}, 0
    while at + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields[name.decode(errors="replace")] = value
        at += 4 + size
    return fields
