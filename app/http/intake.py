"""A body that is being received: streamed to a temporary file, counted and hashed while it is written."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import TypeVar

from fastapi.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from app.context import Context
from app.http.limits import check_free_space, too_large
from app.http.problem_types import BODY_NOT_COMPLETE, WRONG_DIGEST
from app.http.problems import Problem

PIECE_BYTES = 1 << 20
"""Bodies are handed to the thread pool in pieces of about this size: a hop for every network packet costs more."""

Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Arrival:
    """A file that has been received completely, but is not in its place yet."""

    path: str
    """Its name in the drive."""
    temporary: Path
    """Where it lies."""
    size_bytes: int
    sha256: str
    """Hexadecimal."""


class Intake:
    """A temporary file that is being written, for the file `path` of a drive, which may have `limit` bytes."""

    def __init__(self, context: Context, path: str, limit: int) -> None:
        self.path = path
        self.size_bytes = 0
        self._limit = limit
        self._hash = hashlib.sha256()
        self._incoming = context.storage.incoming
        self._temporary = Path()
        self._file: FileIO | None = None

    def write(self, data: bytes | memoryview) -> None:
        """Take the next bytes; a 413 where they are more than the limit."""
        self.size_bytes += len(data)
        if self.size_bytes > self._limit:
            raise too_large(self.path, self._limit)
        self._hash.update(data)
        file = self._open()
        view = memoryview(data)
        while view:
            view = view[file.write(view) :]

    def finish(self, sha256: str | None = None) -> Arrival:
        """Bring the file to disk; a 422 where it has not the SHA-256 that the client announced."""
        digest = self._hash.hexdigest()
        if sha256 not in {None, digest}:
            raise Problem(
                WRONG_DIGEST,
                f"{self.path}: {self.size_bytes:,} bytes came with SHA-256 {digest}, not {sha256} as announced. "
                "Nothing was kept. Usual cause: the file changed while it was read, or a fault on the way; "
                "send it again.",
            )
        file = self._open()
        os.fsync(file.fileno())
        file.close()
        return Arrival(self.path, self._temporary, self.size_bytes, digest)

    def discard(self) -> None:
        """Remove the temporary file; one that was moved to its place stays."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            with suppress(OSError):
                self._temporary.unlink(missing_ok=True)

    def _open(self) -> FileIO:
        """Return the file, made when the first bytes arrive: in a thread, so that the server can answer others."""
        if self._file is None:
            self._temporary = self._incoming() / secrets.token_hex(12)
            self._file = self._temporary.open("xb", buffering=0)
        return self._file


async def receive(request: Request, take: Callable[[bytes], None], finish: Callable[[], Kept]) -> Kept:
    """Read a body, and call `take` with each piece in a thread, as long as there is room on the disk (else a 507).

    `finish` is called in the same thread as the last piece: a small body costs one hop to the thread pool.
    """
    context: Context = request.app.state.context

    def take_if_there_is_room(piece: bytes) -> None:
        check_free_space(context, len(piece))
        take(piece)

    def take_last(piece: bytes) -> Kept:
        take_if_there_is_room(piece)
        return finish()

    last = b""
    try:
        async for piece in _pieces(request):
            if last:
                await run_in_threadpool(take_if_there_is_room, last)
            last = piece
    except ClientDisconnect:
        raise Problem(BODY_NOT_COMPLETE, "The connection ended before the body did. Nothing was kept.") from None
    return await run_in_threadpool(take_last, last)


async def _pieces(request: Request) -> AsyncIterator[bytes]:
    """Gather the packets of a body."""
    packets: list[bytes] = []
    size = 0
    async for packet in request.stream():
        packets.append(packet)
        size += len(packet)
        if size >= PIECE_BYTES:
            yield b"".join(packets)
            packets, size = [], 0
    yield b"".join(packets)
