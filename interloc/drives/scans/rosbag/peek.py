"""What a bag that is elsewhere holds, told from some ranges of its bytes: its topics, and whether they carry labels.

The readers of bags read from the ranges that are there, and ask for the first that is missing.
"""

import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from interloc.drives.scans.rosbag.bag import POINTS
from interloc.drives.scans.rosbag.files import (
    HEAD_BYTES,
    MAGIC,
    ZSTD_MAGIC,
    mcap_channels,
    messages_at,
    ros1_channels,
)
from interloc.drives.scans.rosbag.messages import FIX, POSES, TRANSFORMS, read_layout

_ASKED_BYTES = 1 << 20  # ranges begin and end at multiples of it
_MAX_READ_BYTES = 8 << 20


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


def peek(size: int, known: Mapping[int, bytes]) -> BagPeek | None:
    """Look into a bag of so many bytes by the ranges that are known, by their first bytes.

    It is None where its form (SQLite), or its damage, does not let it be read so. A `MissingRangeError` tells what more
    is needed.
    """
    file, found = _PartialFile(size, known), BagPeek()
    try:
        magic = file.read(len(MAGIC[".db3"]))
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
                if head and channel.encoding is not None and not head.startswith(ZSTD_MAGIC):
                    layout = read_layout(head, channel.type, channel.encoding, complete=False)
                    found.has_labels = bool(found.has_labels) or layout.has("label")
    except (ValueError, ArithmeticError, LookupError, EOFError, struct.error):  # the check of the whole bag says why
        return None
    return found
