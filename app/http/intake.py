"""How every file is put: streamed to a temporary file, counted and hashed meanwhile, then renamed to its place."""

import hashlib
import os
import secrets
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVar

from fastapi.concurrency import run_in_threadpool
from sqlalchemy.exc import DBAPIError
from starlette.requests import ClientDisconnect, Request

from app.context import Context
from app.http.headers import sha256_of
from app.http.limits import check_free_space, declared_length, too_large
from app.http.problem_types import BODY_NOT_COMPLETE, NAMES_IN_CONFLICT, WRONG_DIGEST
from app.http.problems import Problem
from app.store.storage import Storage, files_below, remove_empty

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


async def receive_file(
    request: Request,
    path: str,
    limit: int,
    keep: Callable[[Arrival], Kept],
    check: Callable[[int], None] = lambda _length: None,
) -> Kept:
    """Receive a body as one file, as every address does that takes one, and call `keep` with it.

    The file lies under a temporary name then, is on disk, and is what the header Content-Digest announces. A large
    body is not read before `check` agrees to its length, 0 where that is not known.
    """
    sha256 = sha256_of(request.headers)
    length = declared_length(request, limit, path)
    intake = Intake(request.app.state.context, path, limit)
    if length is None or length > PIECE_BYTES:  # a small one is read sooner than rows are looked up
        await run_in_threadpool(check, length or 0)
    return await receive(request, length, intake.write, lambda: keep(intake.finish(sha256)), intake.discard)


async def receive(
    request: Request,
    length: int | None,
    take: Callable[[bytes], None],
    finish: Callable[[], Kept],
    discard: Callable[[], None],
) -> Kept:
    """Read a body, and call `take` with each piece in a thread, as long as there is room on the disk (else a 507).

    `finish` is called in the same thread as the last piece: a small body costs one hop to the thread pool. `discard`
    is called in any case.
    """
    context: Context = request.app.state.context

    def take_if_there_is_room(piece: bytes) -> None:
        check_free_space(context, len(piece))
        take(piece)

    def take_last(piece: bytes) -> Kept:
        try:
            take_if_there_is_room(piece)
            return finish()
        finally:
            discard()

    last = b""
    try:
        if length is None or length > PIECE_BYTES:
            await run_in_threadpool(check_free_space, context, length or 0)
        async for piece in _pieces(request):
            if last:
                await run_in_threadpool(take_if_there_is_room, last)
            last = piece
    except BaseException as error:
        await run_in_threadpool(discard)
        if isinstance(error, ClientDisconnect):
            detail = "The connection ended before the body did. Nothing was kept."
            raise Problem(BODY_NOT_COMPLETE, detail) from None
        raise
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


class Placement:
    """Moves files to their places below a key; if the block or its transaction fails, the old files are restored.

    The transaction has locked the row that the files belong to: of several that come at once each is placed whole, one
    after the other, and what is deleted meanwhile is deleted with them.

    A server that is killed between the moves and the end of the transaction leaves files without rows, never a row
    without its file. So does a database that goes away at that end: whether the rows are there is not known then.
    """

    def __init__(self, storage: Storage, key: str) -> None:
        self._incoming = storage.incoming
        self._files = storage.folder(key)
        self._moved: list[tuple[Path, Path | None]] = []

    def __enter__(self) -> Self:
        return self

    def move(self, arrivals: Iterable[Arrival]) -> None:
        """Rename files from their temporary names."""
        try:
            self._move(arrivals)
        except BaseException:
            self._restore()  # while the drive is still locked, so that no other request has put a file there
            raise

    def remove_others(self, arrivals: Iterable[Arrival]) -> None:
        """Remove all that lies beside files that were moved."""
        kept = {arrival.path for arrival in arrivals}
        for path in [self._files / name for name in files_below(self._files) if name not in kept]:
            self._moved.append((path, self._save(path)))
            path.unlink(missing_ok=True)

    def _move(self, arrivals: Iterable[Arrival]) -> None:
        for arrival in arrivals:
            target = self._files / arrival.path
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                old = None if target.is_dir() else self._save(target)
                self._moved.append((target, old))
                arrival.temporary.replace(target)  # fails where a folder has the name
            except (NotADirectoryError, FileExistsError, IsADirectoryError):
                raise Problem(
                    NAMES_IN_CONFLICT,
                    f"{arrival.path}: there is a folder of this name, or a file that has the name of one of its "
                    "folders. Nothing of this request was kept; DELETE what is in the way first.",
                ) from None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is not None and not (isinstance(error, DBAPIError) and error.connection_invalidated):
            self._restore()
        for _, old in self._moved:
            if old is not None:
                with suppress(OSError):
                    old.unlink()

    def _restore(self) -> None:
        """Restore everything, folders too: an empty one would block a file of its name."""
        while self._moved:
            target, old = self._moved.pop()
            with suppress(OSError):
                if old is not None:
                    old.replace(target)
                else:
                    target.unlink(missing_ok=True)
            remove_empty(target.parent, self._files)

    def _save(self, target: Path) -> Path | None:
        """Keep the file that is about to be replaced; until then readers find it under its name."""
        old = self._incoming() / secrets.token_hex(12)
        try:
            os.link(target, old)
        except FileNotFoundError:
            return None
        except OSError:  # a file system without links
            target.replace(old)
        return old
