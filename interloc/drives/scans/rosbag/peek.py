"""What a bag that is elsewhere holds, told from some ranges of its bytes: its topics, and whether they carry labels.

The readers of bags read from the ranges that are there, and ask for the first that is missing.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Literal

from interloc.drives.scans.rosbag.bag import POINTS
from interloc.drives.scans.rosbag.files import (
    HEAD_BYTES,
    MAGIC,
    ZSTD_MAGIC,
    mcap_channels,
    messages_at,
    ros1_channels,
    ros2_spelling,
)
from interloc.drives.scans.rosbag.messages import FIX, POSES, TRANSFORMS, Encoding, read_layout

_ASKED_BYTES = 1 << 20  # ranges begin and end at multiples of it
_MAX_READ_BYTES = 8 << 20
_MAX_TOPICS, _MAX_MESSAGES = 1000, 200  # of a bag of SQLite; the first scan is among them, or not looked for


class MissingRangeError(Exception):
    """Ranges of bytes that were not given: the first byte of each, and that after the last."""

    def __init__(self, ranges: list[tuple[int, int]]) -> None:
        super().__init__(f"bytes {ranges}")
        self.ranges = ranges


class _PartialFile(io.BytesIO):
    """A file of some bytes, of which some ranges are known, by where they begin."""

    def __init__(self, size: int, known: Mapping[int, bytes]) -> None:
        super().__init__()
        self.size, self._known, self._at = size, known, 0

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = 0, /) -> int:
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def read(self, count: int | None = -1, /) -> bytes:
        start, found = self._at, b""
        stop = min(self.size, self.size if count is None or count < 0 else start + count)
        if stop - start > _MAX_READ_BYTES:
            raise ValueError(f"{stop - start:,} bytes are not read at once")
        while (at := start + len(found)) < stop:
            pieces = (data[at - begin : stop - begin] for begin, data in self._known.items() if begin <= at)
            piece = next(filter(None, pieces), None)
            if piece is None:
                first, last = at // _ASKED_BYTES * _ASKED_BYTES, -(-stop // _ASKED_BYTES) * _ASKED_BYTES
                wanted = [(first, min(last, self.size))]
                if not self._known and last < self.size:  # the index is at the end
                    wanted.append((max(last, self.size - _ASKED_BYTES), self.size))
                raise MissingRangeError(wanted)
            found += piece
        self._at += len(found)
        return found


@dataclass
class BagPeek:
    """What was found: the topics with messages and their types, and whether the first scan carries labels."""

    topics: dict[str, str] = field(default_factory=dict)
    has_labels: bool | None = None
    """None: that could not be told."""

    def of(self, kind: Literal["points", "poses", "fixes"]) -> list[str]:
        """Return the names of the topics of a kind."""
        types = {"points": POINTS, "poses": (*POSES, *TRANSFORMS), "fixes": (FIX,)}[kind]
        return sorted(name for name, type_ in self.topics.items() if type_ in types)

    def look_at(self, head: bytes, type_: str, encoding: Encoding | None) -> None:
        """Tell from the first bytes of a message of points whether they carry labels."""
        if head and encoding is not None and not head.startswith(ZSTD_MAGIC):
            self.has_labels = bool(self.has_labels) or read_layout(head, type_, encoding, complete=False).has("label")


def peek(size: int, known: Mapping[int, bytes]) -> BagPeek | None:
    """Look into a bag of so many bytes by the ranges that are known, by their first bytes.

    It is None where its form, or its damage, does not let it be read so. A `MissingRangeError` tells what more is
    needed.
    """
    file, found = _PartialFile(size, known), BagPeek()
    try:
        magic = file.read(len(MAGIC[".db3"]))
        if magic == MAGIC[".db3"]:
            _peek_db3(file, found)
            return found
        channels = {".bag": ros1_channels, ".mcap": mcap_channels}
        suffix = next((suffix for suffix in channels if magic.startswith(MAGIC[suffix])), None)
        if suffix is None:
            return None
        for channel in channels[suffix](file):
            if channel.count == 0:
                continue
            found.topics[channel.topic] = channel.type
            if channel.type in POINTS and (rows := next(channel.pieces(file), None)) is not None:
                head = next(messages_at(file, rows[:1, 1:], HEAD_BYTES), b"")
                found.look_at(head, channel.type, channel.encoding)
    except (ValueError, ArithmeticError, LookupError, EOFError, struct.error):  # the check of the whole bag says why
        return None
    return found


def _peek_db3(file: _PartialFile, found: BagPeek) -> None:
    """Read the topics of a bag of SQLite, and the first message of those with points."""
    import apsw  # noqa: PLC0415 - comes with rosbags

    try:
        with closing(_database(file)) as database:
            query = "SELECT id, name, type, serialization_format FROM topics"
            waiting: dict[int, tuple[str, Encoding | None]] = {}
            for number, name, type_, encoding in islice(database.execute(query), _MAX_TOPICS):
                found.topics[str(name)] = ros2_spelling(str(type_))
                if found.topics[str(name)] in POINTS:
                    waiting[number] = found.topics[str(name)], "cdr" if encoding == "cdr" else None
            for row, number in islice(database.execute("SELECT rowid, topic_id FROM messages"), _MAX_MESSAGES):
                if number in waiting:
                    with database.blob_open("main", "messages", "data", row, False) as blob:
                        found.look_at(blob.read(HEAD_BYTES), *waiting.pop(number))
                if not waiting:
                    break
    except MissingRangeError:
        if found.has_labels is None:
            raise
    except apsw.Error as error:
        raise ValueError(str(error)) from error
    if waiting and not found.has_labels:
        found.has_labels = None  # what was not seen may carry them


def _database(file: _PartialFile) -> Any:  # noqa: ANN401 - of apsw, which is imported late
    """Open a database that SQLite reads through a file of which some ranges are known."""
    import apsw  # noqa: PLC0415 - comes with rosbags

    class _File(apsw.VFSFile):
        def __init__(self) -> None: ...

        def xFileSize(self) -> int:
            return file.size

        def xRead(self, count: int, start: int) -> bytes:
            file.seek(start)
            return file.read(count)

        def xDeviceCharacteristics(self) -> int:
            return 0

        def xSectorSize(self) -> int:
            return 0

        def xFileControl(self, _code: int, _pointer: int) -> bool:
            return False

        def xClose(self) -> None: ...

    class _System(apsw.VFS):
        def __init__(self) -> None:
            super().__init__(f"ranges {id(file)}", "")

        def xOpen(self, _name: object, _flags: list[int]) -> _File:
            return _File()

    system, flags = _System(), apsw.SQLITE_OPEN_READONLY | apsw.SQLITE_OPEN_URI
    database = apsw.Connection("file:bag?immutable=1", flags=flags, vfs=f"ranges {id(file)}")
    database.set_progress_handler(lambda: system is not None, 1_000_000)  # a query that goes on for ever ends
    return database
