"""ROS 2 bags in SQLite: one table of topics, one of messages."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.files import SourceFile
from interloc.drives.scans.rosbag.chunks import MAX_MESSAGE_BYTES
from interloc.drives.scans.rosbag.index import MAX_MESSAGES, OFFSET, BagIndex, Channel, reading, ros2_spelling

MAGIC = b"SQLite format 3\0"

_PATIENCE_S = 120.0
_STEPS = 1_000_000
_ROWS = 100_000


def index_db3(file: SourceFile) -> BagIndex:
    """Read the topics, and the rows of their messages; the messages themselves stay where they are.

    Raises
    ------
    DriveError
        It is no bag, or damaged.
    """
    with reading(file):
        with file.path.open("rb") as raw:
            magic = raw.read(len(MAGIC))
        if magic != MAGIC:
            raise file.fault(
                f"is not an SQLite database (it starts with {magic[:8]!r}). Usual cause: a recording that was not "
                "ended properly, or a copy cut short."
            )
        with closing(_connect(file.path)) as database:
            tables = dict(database.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'"))
            if not {"topics", "messages"} <= tables.keys():
                raise file.fault(
                    f"is a database without the tables of a bag (it has {', '.join(sorted(tables)[:5]) or 'none'}). "
                    "Expected topics and messages, as `ros2 bag record` writes them."
                )
            defined = set()
            if "message_definitions" in tables:
                defined = {name for (name,) in database.execute("SELECT topic_type FROM message_definitions")}
            topics = database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
            rows = _rows(database)
        return BagIndex(_channels(topics, rows, defined))


def _channels(topics: list[tuple[Any, ...]], rows: IntArray, defined: set[str]) -> list[Channel]:
    order = np.argsort(rows[:, 1], kind="stable")
    rows = rows[order]
    channels = []
    for number, name, kind, encoding in topics:
        first, last = np.searchsorted(rows[:, 1], [int(number), int(number) + 1])
        places = np.zeros((last - first, 4), dtype=np.int64)
        places[:, OFFSET] = rows[first:last, 0]
        channels.append(
            Channel(
                str(name),
                ros2_spelling(str(kind)),
                "cdr" if encoding == "cdr" else None,
                rows[first:last, 2].copy(),
                places,
                kind in defined,
            )
        )
    return channels


def _connect(path: Path) -> sqlite3.Connection:
    """Open a database that nothing may be written to, nor be done with for ever."""
    unfinished = path.with_name(path.name + "-wal")
    kept = "" if unfinished.is_file() and unfinished.stat().st_size else "&immutable=1"
    database = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro{kept}", uri=True)
    deadline = time.monotonic() + _PATIENCE_S
    database.set_progress_handler(lambda: int(time.monotonic() > deadline), _STEPS)
    database.execute("PRAGMA trusted_schema = OFF")
    return database


def _rows(database: sqlite3.Connection) -> IntArray:
    """Return (N, 3) row, topic and time of all messages."""
    cursor = database.execute("SELECT rowid, topic_id, timestamp FROM messages")
    pieces, count = [np.empty((0, 3), dtype=np.int64)], 0
    while rows := cursor.fetchmany(_ROWS):
        pieces.append(np.array(rows, dtype=np.int64))
        count += len(rows)
        if count > MAX_MESSAGES:
            raise ValueError(f"it holds more than {MAX_MESSAGES:,} messages")
    return np.concatenate(pieces)


def read_messages(path: Path, places: IntArray, limit: int = MAX_MESSAGE_BYTES) -> Iterator[bytes]:
    """Read messages by their rows, no more of each than is enough; parameters as of `ros1.read_messages`.

    Raises
    ------
    sqlite3.Error, ValueError
        The bag is damaged.
    """
    with closing(_connect(path)) as database:
        for place in places:
            with database.blobopen("messages", "data", int(place[OFFSET]), readonly=True) as blob:
                if len(blob) > MAX_MESSAGE_BYTES:
                    raise ValueError(f"a message of {len(blob):,} bytes; none is larger than 512 MB")
                yield blob.read(min(len(blob), limit))
