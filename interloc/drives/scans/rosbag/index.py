"""Where the messages of a bag lie: what the reader of each file format provides."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.rosbag.chunks import ChunkStream
from interloc.drives.scans.rosbag.wire import Encoding

MAX_MESSAGES = 20_000_000
"""Of one file: two days of an IMU at 100 Hz."""

CHUNK_START, CHUNK_BYTES, CODEC, OFFSET = range(4)
"""Columns of a place: where the chunk lies in the file, its size there, its compression, and the message in it; in a
database the row only, in the last."""

_DAMAGE = (
    struct.error,
    sqlite3.Error,
    ValueError,  # also of text that is not UTF-8, of chunks and of messages
    ArithmeticError,
    LookupError,
    TypeError,
    AttributeError,
    AssertionError,
    EOFError,
    MemoryError,
    RecursionError,
)
"""What comes out of a damaged bag, here and in rosbags."""


@dataclass(frozen=True)
class Channel:
    """The messages of one topic in one file."""

    topic: str
    type: str
    """The type is spelt as in ROS 2: "sensor_msgs/msg/PointCloud2"."""
    encoding: Encoding | None
    """{"ros1", "cdr"} or None: none where it is another."""
    log_ns: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    """(N,) int64: when each message was recorded, nanoseconds."""
    places: IntArray = field(default_factory=lambda: np.empty((0, 4), np.int64))
    """(N, 4) int64: where it lies: `CHUNK_START`, `CHUNK_BYTES`, `CODEC`, `OFFSET`."""
    defined: bool = True
    """The file holds the definition of the type."""


@dataclass(frozen=True)
class BagIndex:
    """What is in one file of a bag."""

    channels: list[Channel]
    damage: str = ""
    """What was found where the file could not be read to its end; empty where all is well."""


_AHEAD = 64
_HEAD_BYTES = 65_536  # what `ChunkStream` unpacks at a time, and more than most messages that are not points
_MESSAGE_BYTES = 1024


def streams_at(path: Path, places: IntArray) -> Iterator[ChunkStream]:
    """Yield a stream for each of the (N, 4) places, which stands there; every chunk is unpacked once if they ascend.

    Parameters
    ----------
    path
    places

    Raises
    ------
    ValueError
        The file is damaged.
    """
    with path.open("rb") as file:
        stream, chunk = None, -1
        for place in places:
            if stream is None or place[CHUNK_START] != chunk or place[OFFSET] < stream.position:
                chunk = int(place[CHUNK_START])
                stream = ChunkStream(file, chunk, int(place[CHUNK_BYTES]), int(place[CODEC]))
            stream.skip_to(int(place[OFFSET]))
            yield stream


def ros2_spelling(name: str) -> str:
    """Return the name of a type as ROS 2 spells it: "sensor_msgs/PointCloud2" is "sensor_msgs/msg/PointCloud2"."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


@contextmanager
def reading(file: SourceFile) -> Iterator[None]:
    """Turn whatever a damaged bag makes its readers raise into a `DriveError` that names the file.

    Raises
    ------
    DriveError
    """
    try:
        yield
    except OSError as error:
        raise file.unreadable(error) from error
    except _DAMAGE as error:
        raise damaged(file, str(error) or type(error).__name__) from error


def damaged(file: SourceFile, found: str) -> Exception:
    """Return the error to raise about a damaged bag."""
    return file.fault(
        f"is damaged: {found[:300]}. Expected a complete bag. "
        "Usual cause: a recording that was not ended properly, or a copy cut short."
    )
