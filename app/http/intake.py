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
from python_multipart.exceptions import MultipartParseError
from python_multipart.multipart import MultipartParser, parse_options_header
from sqlalchemy import func, select
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from starlette.datastructures import Headers
from starlette.requests import Request

from app.context import Context
from app.http import problem_types as kinds
from app.http.headers import sha256_of
from app.http.problems import Problem, disk_full
from app.paths import check_path
from app.settings import MB
from app.store.models import CityMap, Drive, Token
from app.store.storage import Storage, remove_empty

# Limits of uploads: the answer names the limit that was exceeded, and what is allowed.

CLOSE = {"Connection": "close"}
"""Sent when a body is refused before it is read: the rest of it would be taken for the next request."""


def declared_length(request: Request, limit: int, what: str) -> int | None:
    """Return the Content-Length, None where the body comes in chunks; refuse one above the limit (413).

    A body that is a part of a file is a 400, a compressed one a 415.
    """
    if "content-range" in request.headers:  # RFC 9110, section 14.5: it may not be ignored
        raise Problem(
            kinds.PART_OF_A_FILE,
            "Content-Range: files are taken whole only. To resume an upload, send the files that "
            "GET /api/v1/drives/{id}/files does not list.",
            headers=CLOSE,
        )
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    transfer = request.headers.get("transfer-encoding", "chunked").strip().lower()
    is_plain = coding in {"", "identity"}
    if not is_plain or transfer != "chunked":
        raise Problem(
            kinds.COMPRESSED_BODY,
            f"{f'Transfer-Encoding: {transfer}' if is_plain else f'Content-Encoding: {coding}'}. Send the file as it "
            "is; files that are compressed themselves (map.osm.gz) need no Content-Encoding.",
            headers={"Accept-Encoding": "identity", **CLOSE},
        )
    text = request.headers.get("content-length")
    if text is None:
        return None
    length = int(text)  # the HTTP parser has refused everything else
    if length > limit:
        raise too_large(what, limit)
    return length


def too_large(what: str, limit: int) -> Problem:
    """Return the problem that a body is larger than allowed."""
    size = f"{limit / MB:,.0f} MB" if limit >= MB else f"{limit:,} bytes"
    return Problem(kinds.TOO_LARGE, f"{what} may have {size} at most. Nothing was kept.", headers=CLOSE)


def check_free_space(context: Context, needed: int) -> None:
    """Refuse (507) what would leave too little space on the disk."""
    if context.storage.free_bytes() - needed < context.settings.min_free_bytes:
        raise disk_full(headers=CLOSE)


def check_drive(context: Context, files: int, size: int) -> None:
    """Refuse (413) what makes a drive too large, by the files and bytes that it would have."""
    settings = context.settings
    if size > settings.max_drive_bytes:
        raise too_large("All files of a drive together", settings.max_drive_bytes)
    if files > settings.max_drive_files:
        raise Problem(
            kinds.TOO_MANY_FILES,
            f"A drive may have {settings.max_drive_files:,} files at most. Leave out what the method does not need "
            "(images), or cut the drive.",
            headers=CLOSE,
        )


def check_quota(context: Context, session: Session, owner: str, sender: str, more: int) -> None:
    """Refuse (413) what a client may not store any more by its token: a drive or map counts for its owner.

    Whose token has a limit sends to its own drives only, or it would have none. The transaction is the one that stores
    it: those of one client come here one after the other.
    """
    if sender != owner and context.tokens.named(sender).max_bytes is not None:
        detail = f"The token of {sender} has a limit of bytes, so it sends to drives and maps of its own only."
        raise Problem(kinds.QUOTA_USED_UP, detail, headers=CLOSE)
    allowed = context.tokens.named(owner).max_bytes
    if allowed is None or more <= 0:
        return
    session.execute(select(Token.name).where(Token.name == owner).with_for_update())
    sums = select(func.sum(Drive.stored_bytes)), select(func.sum(CityMap.osm_bytes))
    owners = Drive.owner, CityMap.owner
    kept = sum(int(session.scalar(of.where(by == owner)) or 0) for of, by in zip(sums, owners, strict=True))
    if kept + more > allowed:
        raise Problem(
            kinds.QUOTA_USED_UP,
            f"What {owner} keeps takes {kept / MB:,.0f} MB; with {more / MB:,.1f} MB more it would exceed the "
            f"{allowed / MB:,.0f} MB that its token allows. Delete drives for good (?purge=true): the trash counts.",
            headers=CLOSE,
        )


def job_limit(context: Context, owner: str) -> int:
    """Return how many jobs of one kind a client may have that wait or run."""
    allowed = context.tokens.named(owner).max_jobs
    limit = context.settings.max_queued_jobs
    return limit if allowed is None else min(limit, allowed)


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
                kinds.WRONG_DIGEST,
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
    except BaseException:
        await run_in_threadpool(discard)
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
                    kinds.NAMES_IN_CONFLICT,
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


# Several files in one request: multipart/form-data, read as it arrives, each part written straight to its own file.

_MAX_HEADERS, _MAX_HEADER_BYTES = 16, 8192  # of a part
_PLAIN_ENCODINGS = {b"binary", b"8bit", b"7bit"}


def boundary_of(content_type: str | None) -> bytes:
    """Return what separates the parts; a 415 where the body is not multipart/form-data."""
    kind, options = parse_options_header(content_type or "")
    if kind != b"multipart/form-data" or not options.get(b"boundary"):
        raise Problem(
            kinds.NOT_MULTIPART_FORM_DATA,
            f"Content-Type {content_type or '(none)'!r}. Expected multipart/form-data with its boundary.",
            headers=CLOSE,
        )
    return options[b"boundary"]


class BatchReader:
    """Takes a body in pieces and writes its parts to files."""

    def __init__(self, context: Context, boundary: bytes) -> None:
        self._context, self._limits = context, context.settings
        self._size = 0
        self._headers: dict[bytes, bytes] = {}
        self._name = self._value = b""  # of the header that is being read
        self._sha256: str | None = None  # of the part that is being read, where the client announces it
        self._intakes: list[Intake] = []
        self._arrivals: dict[str, Arrival] = {}
        self._ended = False
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin_part,
                "on_part_data": self._take_data,
                "on_part_end": self._end_part,
                "on_header_field": self._take_header_name,
                "on_header_value": self._take_header_value,
                "on_header_end": self._end_header,
                "on_headers_finished": self._open_part,
                "on_end": self._end,
            },
            max_header_count=_MAX_HEADERS,
            max_header_size=_MAX_HEADER_BYTES,
        )

    def take(self, data: bytes) -> None:
        """Take the next bytes of the body."""
        self._size += len(data)
        if self._size > self._limits.max_batch_bytes:
            raise too_large("A request with several files", self._limits.max_batch_bytes)
        try:
            self._parser.write(data)
        except MultipartParseError as error:
            raise _malformed(str(error)) from error

    def finish(self) -> list[Arrival]:
        """Return the files, all on disk."""
        if not self._ended:
            raise _malformed("it ends before its last boundary")
        if not self._arrivals:
            raise _bad_part("The request has no parts. Expected one or more files.")
        return list(self._arrivals.values())

    def discard(self) -> None:
        """Remove the files that were not moved to their places."""
        for intake in self._intakes:
            intake.discard()

    def _begin_part(self) -> None:
        maximum = self._limits.max_batch_files
        if len(self._intakes) >= maximum:
            raise Problem(
                kinds.TOO_MANY_FILES,
                f"One request may have {maximum:,} files at most. Send several. Nothing of this one was kept.",
                headers=CLOSE,
            )
        self._headers = {}

    def _take_header_name(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _take_header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _end_header(self) -> None:
        self._headers[self._name.lower()] = self._value
        self._name = self._value = b""

    def _open_part(self) -> None:
        kind, options = parse_options_header(self._headers.get(b"content-disposition"))
        if kind != b"form-data" or b"name" not in options:
            raise _malformed("a part has no Content-Disposition: form-data with a name")
        if self._headers.get(b"content-transfer-encoding", b"binary").strip().lower() not in _PLAIN_ENCODINGS:
            raise _bad_part("A part has a Content-Transfer-Encoding; expected its bytes as they are.")
        field, filename = _text(options[b"name"]), options.get(b"filename")
        if field != "files" or not filename:
            raise _bad_part(f"A part {field[:80]!r}; expected `files`, each with its path in the drive as file name.")
        path = check_path(_text(filename))
        if path in self._arrivals:
            raise _bad_part(f"{path} comes twice.")
        self._sha256 = sha256_of(Headers(raw=list(self._headers.items())))
        self._intakes.append(Intake(self._context, path, self._limits.max_file_bytes))

    def _take_data(self, data: bytes, start: int, end: int) -> None:
        self._intakes[-1].write(memoryview(data)[start:end])

    def _end_part(self) -> None:
        arrival = self._intakes[-1].finish(self._sha256)
        self._arrivals[arrival.path] = arrival

    def _end(self) -> None:
        self._ended = True


def _text(value: bytes) -> str:
    try:
        return value.decode()
    except UnicodeDecodeError:
        raise _bad_part(f"{value[:80]!r} is not UTF-8.") from None


def _bad_part(what: str) -> Problem:
    """Return the problem that a part has."""
    return Problem(kinds.BAD_PART, f"{what} Nothing of this request was kept.", headers=CLOSE)


def _malformed(what: str) -> Problem:
    return Problem(kinds.BODY_MALFORMED, f"multipart/form-data: {what}. Nothing of it was kept.", headers=CLOSE)
