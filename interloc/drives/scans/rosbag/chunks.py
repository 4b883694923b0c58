"""Reading from the chunks of a bag: compressed or not, only as far as is needed, never more than is allowed."""

from __future__ import annotations

import bz2
import sys
from typing import BinaryIO, Protocol

MAX_MESSAGE_BYTES = 512 * 1024 * 1024
"""Of one message; a scan of 4 million points is smaller."""

MAX_CHUNK_BYTES = 2 * 1024 * 1024 * 1024
"""Of one chunk when unpacked; recorders write about a megabyte."""

CODECS = ("", "bz2", "lz4", "zstd")
"""Compressions, by the number that stands for them in an index."""

MAX_RATIO = 1000
"""What so many times its size comes out of is no recording, but made to fill the memory; small chunks may."""

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

_PIECE = 1 << 16
_SMALL = 64 * 1024 * 1024


class DamagedChunkError(ValueError):
    """A chunk that cannot be unpacked, or unpacks to too much."""


class _Decompressor(Protocol):
    @property
    def eof(self) -> bool: ...
    @property
    def needs_input(self) -> bool: ...
    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def codec_number(name: str) -> int:
    """Return the number that stands for a compression in an index."""
    name = "" if name == "none" else name
    if name not in CODECS:
        raise DamagedChunkError(f"compression {name[:20]!r} is not known; known are bz2, lz4 and zstd")
    return CODECS.index(name)


def _decompressor(codec: int) -> tuple[_Decompressor, tuple[type[Exception], ...]]:
    """Return a decompressor and what it raises for damaged data."""
    if CODECS[codec] == "bz2":
        return bz2.BZ2Decompressor(), (OSError, EOFError, ValueError)
    if CODECS[codec] == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # noqa: PLC0415 - comes with the extra

        return LZ4FrameDecompressor(), (RuntimeError, EOFError, ValueError)
    if sys.version_info >= (3, 14):
        from compression.zstd import ZstdDecompressor, ZstdError  # noqa: PLC0415 - as the next
    else:
        from backports.zstd import ZstdDecompressor, ZstdError  # noqa: PLC0415 - comes with the extra

    return ZstdDecompressor(), (ZstdError, EOFError, ValueError)


class ChunkStream:
    """Reads a chunk from its beginning to its end, unpacking no more than what was asked for.

    Parameters
    ----------
    file : binary file
    start, size : int
        Where its (compressed) bytes lie in the file.
    codec : int
        Position in `CODECS`.
    """

    def __init__(self, file: BinaryIO, start: int, size: int, codec: int) -> None:
        self.position = 0
        self._file, self._start, self._size = file, start, size
        self._packed_at = self._unpacked = 0
        self._buffer = b""
        self._used = 0
        self._decompressor: _Decompressor | None = None
        self._errors: tuple[type[Exception], ...] = ()
        if codec:
            self._decompressor, self._errors = _decompressor(codec)

    def skip_to(self, offset: int) -> None:
        """Go forward to an offset in the unpacked chunk."""
        if offset < self.position:
            raise DamagedChunkError("its index leads backwards")
        if offset > MAX_CHUNK_BYTES and self._decompressor is not None:
            raise DamagedChunkError(
                f"its index leads to byte {offset:,} of a chunk, which no chunk is large enough for"
            )
        if self._decompressor is None:
            self.position = offset
            return
        while self.position < offset:
            if not self._take(offset - self.position):
                raise DamagedChunkError("a chunk ends before the place where its index leads")

    def read(self, count: int) -> bytes:
        """Read some bytes; fewer at the end of the chunk."""
        if count > MAX_MESSAGE_BYTES:
            raise DamagedChunkError(f"announces a record of {count:,} bytes; none is larger than {MAX_MESSAGE_BYTES:,}")
        if self._decompressor is None:
            self._file.seek(self._start + self.position)
            data = self._file.read(max(0, min(count, self._size - self.position)))
            self.position += len(data)
            return data
        pieces = []
        while count > 0 and (piece := self._take(count)):
            pieces.append(piece)
            count -= len(piece)
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def exactly(self, count: int) -> bytes:
        """Read some bytes.

        Raises
        ------
        DamagedChunkError
            The chunk ends before.
        """
        data = self.read(count)
        if len(data) != count:
            raise DamagedChunkError("a chunk ends in the middle of a record")
        return data

    def message(self, size: int, limit: int) -> bytes:
        """Read a message of some size, or as many bytes of it as are enough.

        Raises
        ------
        DamagedChunkError
            No message is so large, or the chunk ends before.
        """
        if size > MAX_MESSAGE_BYTES:
            raise DamagedChunkError(f"announces a message of {size:,} bytes; none is larger than 512 MB")
        return self.exactly(min(size, limit))

    def _take(self, limit: int) -> bytes:
        """Return the next unpacked bytes, at most some; none at the end."""
        if self._used == len(self._buffer):
            self._buffer, self._used = self._unpack(max(min(limit, 1 << 24), _PIECE)), 0
        piece = self._buffer[self._used : self._used + limit]
        self._used += len(piece)
        self.position += len(piece)
        return piece

    def _unpack(self, limit: int) -> bytes:
        assert self._decompressor is not None
        while not self._decompressor.eof:
            packed = b""
            if self._decompressor.needs_input:
                self._file.seek(self._start + self._packed_at)
                packed = self._file.read(max(0, min(_PIECE, self._size - self._packed_at)))
                if not packed:
                    raise DamagedChunkError("a compressed chunk ends too early")
                self._packed_at += len(packed)
            try:
                data = self._decompressor.decompress(packed, limit)
            except self._errors as error:
                raise DamagedChunkError(f"a chunk cannot be unpacked ({error})") from error
            self._unpacked += len(data)
            if self._unpacked > largest_unpacked(self._size) + _PIECE:
                raise DamagedChunkError(f"a chunk of {self._size:,} bytes unpacks to more than {self._unpacked - 1:,}")
            if data:
                return data
        return b""


def largest_unpacked(size: int) -> int:
    """Return to how many bytes some packed bytes may unpack."""
    return min(MAX_CHUNK_BYTES, max(_SMALL, MAX_RATIO * size))


def unpacked(message: bytes) -> bytes:
    """Unpack a message that was compressed on its own (compression mode "message" of ROS 2)."""
    if not message.startswith(ZSTD_MAGIC):
        return message
    decompressor, errors = _decompressor(CODECS.index("zstd"))
    try:
        data = decompressor.decompress(message, min(MAX_MESSAGE_BYTES, largest_unpacked(len(message))))
    except errors as error:
        raise DamagedChunkError(f"a message cannot be unpacked ({error})") from error
    if not decompressor.eof:
        raise DamagedChunkError("a compressed message is cut short, or unpacks to more than any scan")
    return data
