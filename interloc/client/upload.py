"""Sending many files, small ones in bundles; what the server has with the same digest is left out."""

import base64
import hashlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import zip_longest
from multiprocessing import TimeoutError as NothingFinishedError
from multiprocessing.pool import ThreadPool
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import quote

from pydantic import BaseModel

from interloc.client.connection import Connection, Refusal
from interloc.errors import DriveError, NetworkError
from interloc.files import reason_of

_CHUNK_BYTES = 1024 * 1024
_SMALL_BYTES = 1024 * 1024  # files up to here travel together
_BUNDLE_BYTES, _BUNDLE_FILES, _ROUNDS = 8 * 1024 * 1024, 32, 4
_PAGE_FILES = 10_000
_REPORT_EVERY_S = 0.1


class FileAnswer(BaseModel):
    """A file of a drive on the server."""

    path: str
    size_bytes: int
    sha256: str


class FilesAnswer(BaseModel):
    """A page of files."""

    files: list[FileAnswer]
    next: str | None = None


@dataclass(frozen=True)
class UploadFile:
    """A file of the drive on the server, and where its content comes from."""

    path: str
    """Its path in the drive."""
    content: Path | Callable[[], bytes]
    """A file to be sent as it is, or a function that makes the bytes (from the files `made_from`)."""
    made_from: tuple[Path, ...] = ()
    """Files that the bytes are made from."""
    made_by: str = ""
    """What else the bytes depend on."""

    @property
    def signature(self) -> str:
        """Sizes and times of its sources, and `made_by`: changes whenever the bytes may have changed."""
        sources = (self.content,) if isinstance(self.content, Path) else self.made_from
        try:
            status = [path.stat() for path in sources]
        except OSError as error:
            raise _unreadable(error) from error
        return " ".join([*(f"{each.st_size}:{each.st_mtime_ns}" for each in status), self.made_by]).strip()


@dataclass
class UploadProgress:
    """The progress of an upload."""

    total: int
    """Number of files."""
    done: int = 0
    """Files that the server has."""
    sent: int = 0
    bytes_sent: int = 0
    """Files that this upload has sent, not an earlier one, and their size."""
    began_s: float = field(default_factory=time.monotonic)
    """Start by the monotonic clock."""


Body = Callable[[], Any]
"""Returns the bytes of a file, of a large one an iterator over chunks of them, each time it is called."""

OnProgress = Callable[[UploadProgress], None]
"""Called in the thread that called `upload`; may raise an exception to end the upload."""


def files_of(connection: Connection, drive_id: str) -> dict[str, FileAnswer]:
    """List the files that the server has of a drive, by path."""
    found: dict[str, FileAnswer] = {}
    params: dict[str, str | int] = {"limit": _PAGE_FILES}
    while True:
        page = connection.ask("GET", f"/drives/{drive_id}/files", FilesAnswer, params=params)
        found |= {file.path: file for file in page.files}
        if page.next is None or not page.files:
            return found
        params["after"] = page.next


def upload(
    connection: Connection,
    drive_id: str,
    files: Sequence[UploadFile],
    *,
    threads: int,
    on_progress: OnProgress | None = None,
) -> UploadProgress:
    """Send the files that the server does not have, or has with other content: small ones many per request.

    Memory is bounded: each thread holds one bundle.
    """
    progress = UploadProgress(len(files))
    at_once = min(_BUNDLE_FILES, math.ceil(len(files) / (_ROUNDS * threads)))  # of few files no thread has all
    some = [files[start : start + at_once] for start in range(0, len(files), at_once or 1)]
    sender = _Sender(connection, drive_id, files_of(connection, drive_id), progress)
    # Threads of concurrent.futures would be joined at exit: Ctrl-C would wait for a server that does not answer.
    report = on_progress or (lambda _: None)
    with ThreadPool(max(1, min(threads, len(some)))) as pool:
        try:
            report(progress)  # who stops it early knows how far it was, too
            finished = pool.imap_unordered(sender.deliver, some)
            left = len(some)
            while left:
                with suppress(NothingFinishedError):
                    finished.next(timeout=_REPORT_EVERY_S)
                    left -= 1
                report(progress)
        except (Exception, KeyboardInterrupt) as error:
            if not isinstance(error, DriveError | NetworkError):
                connection.closing.set()
            raise
    return progress


@dataclass(frozen=True)
class _Content:
    """A file that the server lacks, as it is sent."""

    file: UploadFile
    size: int
    digest: bytes
    body: Body

    @property
    def digest_header(self) -> str:
        """Its SHA-256 as in RFC 9530."""
        return f"sha-256=:{base64.b64encode(self.digest).decode()}:"


@dataclass
class _Sender:
    """Sees to it that the server has the files of a drive; threads share it."""

    connection: Connection
    drive_id: str
    there: dict[str, FileAnswer]
    progress: UploadProgress
    lock: Lock = field(default_factory=Lock)

    def deliver(self, files: Sequence[UploadFile]) -> None:
        """Send what the server lacks of some files."""
        bundle: list[_Content] = []
        for file in files:
            try:
                content = self._lacking(file)
            except DriveError:
                self._send(bundle)  # what was read before the fault need not be read again
                raise
            if content is None:
                self._count(1, [])
            elif content.size > _SMALL_BYTES or '"' in file.path or not file.path.isprintable():
                self._send([content])
            else:
                bundle.append(content)
                if sum(each.size for each in bundle) >= _BUNDLE_BYTES:
                    self._send(bundle)
                    bundle = []
        self._send(bundle)

    def _lacking(self, file: UploadFile) -> _Content | None:
        """Return the content of a file, None where the server has it."""
        try:
            content = _Content(file, *_content_of(file))
        except OSError as error:
            raise _unreadable(error) from error
        known = self.there.get(file.path)
        return None if known is not None and known.sha256 == content.digest.hex() else content

    def _send(self, contents: list[_Content]) -> None:
        """Send a file, or several small ones in one request: all of them arrive, or none does."""
        if not contents:
            return
        first, *others = contents
        try:
            if others:
                kind, address = "application/octet-stream", f"/drives/{self.drive_id}/scans"
                parts = [
                    ("files", (each.file.path, each.body(), kind, {"Content-Digest": each.digest_header}))
                    for each in contents
                ]
                answers = self.connection.ask("POST", address, FilesAnswer, files=parts).files
            else:
                headers = {"Content-Type": "application/octet-stream", "Content-Length": str(first.size)}
                headers["Content-Digest"] = first.digest_header
                address = f"/drives/{self.drive_id}/files/{quote(first.file.path)}"
                answers = [self.connection.ask("PUT", address, FileAnswer, body=first.body, headers=headers)]
        except Refusal as error:
            size = sum(each.size for each in contents)
            what = f"{first.file.path}{f' and {len(others)} more' if others else ''}, {size:,} bytes"
            raise Refusal(error.status, error.problem, f"(while sending {what})") from error
        self._accept(contents, answers)

    def _accept(self, sent: list[_Content], answers: list[FileAnswer]) -> None:
        """Count what the server has, where it is what was sent."""
        for content, answer in zip_longest(sent, answers[: len(sent)]):
            found = "nothing" if answer is None else answer.sha256
            if found != content.digest.hex():
                raise NetworkError(
                    f"{self.connection.server} accepted {content.file.path}, but with other content than was sent "
                    f"(SHA-256 {found[:12]}... instead of {content.digest.hex()[:12]}...). Usual cause: a proxy that "
                    "changes bodies."
                )
        self._count(len(sent), [content.size for content in sent])

    def _count(self, done: int, sizes: list[int]) -> None:
        with self.lock:
            self.progress.done += done
            self.progress.sent += len(sizes)
            self.progress.bytes_sent += sum(sizes)


def _content_of(file: UploadFile) -> tuple[int, bytes, Body]:
    """Return size, SHA-256 and bytes of a file; a large one that is sent as it is is read again each time."""
    if isinstance(file.content, Path) and file.content.stat().st_size > _SMALL_BYTES:
        with file.content.open("rb") as source:
            digest = hashlib.file_digest(source, "sha256").digest()
            size = source.tell()
        return size, digest, partial(_chunks, file.content, size)
    data = file.content.read_bytes() if isinstance(file.content, Path) else file.content()
    return len(data), hashlib.sha256(data).digest(), lambda: data


def _chunks(path: Path, size: int) -> Iterator[bytes]:
    left = size
    with path.open("rb") as file:
        while left and (chunk := file.read(min(_CHUNK_BYTES, left))):
            left -= len(chunk)
            yield chunk
    if left:
        raise DriveError(f"{path} became shorter while it was sent. Send it again when nothing writes to it.")


def _unreadable(error: OSError) -> DriveError:
    return DriveError(f"{error.filename or 'a file'}: cannot be read: {reason_of(error)}.")
