"""Sending many files over several connections; what the server already has is left out."""

from __future__ import annotations

import base64
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import TimeoutError as NothingFinishedError
from multiprocessing.pool import ThreadPool
from pathlib import Path
from urllib.parse import quote

from interloc.client.answers import FileAnswer, FilesAnswer, Refusal
from interloc.client.connection import Connection
from interloc.client.upload_log import Sent, UploadLog
from interloc.errors import DriveError, NetworkError
from interloc.files import reason_of

_CHUNK_BYTES = 1024 * 1024
_PAGE_FILES = 10_000
_REPORT_EVERY_S = 0.1


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

    def load(self) -> Payload:
        """Get the bytes ready to be sent; a file is read in chunks.

        Raises
        ------
        DriveError
            A file cannot be read, or is damaged.
        """
        try:
            return Payload.of_file(self.content) if isinstance(self.content, Path) else Payload.of(self.content())
        except OSError as error:
            raise _unreadable(error) from error


@dataclass(frozen=True)
class Payload:
    """Bytes to be sent."""

    size: int
    digest: bytes
    """SHA-256."""
    body: Callable[[], bytes | Iterator[bytes]]
    """Returns the bytes, or an iterator over chunks of them, each time it is called."""

    @classmethod
    def of(cls, data: bytes) -> Payload:
        """Return the payload of bytes in memory."""
        return cls(len(data), hashlib.sha256(data).digest(), lambda: data)

    @classmethod
    def of_file(cls, path: Path) -> Payload:
        """Return the payload of a file, which is read again each time it is sent."""
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").digest()
            size = file.tell()
        return cls(size, digest, partial(_chunks, path, size))

    @property
    def sha256(self) -> str:
        """The digest in hexadecimal."""
        return self.digest.hex()

    @property
    def headers(self) -> dict[str, str]:
        """Size and digest (RFC 9530)."""
        return {
            "Content-Type": "application/octet-stream",
            "Content-Length": str(self.size),
            "Content-Digest": f"sha-256=:{base64.b64encode(self.digest).decode()}:",
        }


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

    @property
    def bytes_per_s(self) -> float:
        """Mean rate since the upload began."""
        return self.bytes_sent / max(time.monotonic() - self.began_s, 1e-3)


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
    log: UploadLog,
    *,
    threads: int,
    on_progress: OnProgress | None = None,
) -> UploadProgress:
    """Send the files that the server does not have, or has with other content.

    Memory is bounded: each thread holds one file.

    Raises
    ------
    DriveError
        A file of the drive cannot be read.
    NetworkError
        The server refuses, or cannot be reached. The files that it accepted before stay there.
    """
    there = files_of(connection, drive_id)
    progress = UploadProgress(len(files))
    # Threads of concurrent.futures would be joined at exit: Ctrl-C would wait for a server that does not answer.
    pool = ThreadPool(max(1, min(threads, len(files))))
    try:
        finished = pool.imap_unordered(partial(_deliver, connection, drive_id, there, log), files)
        while progress.done < progress.total:
            try:
                sent_bytes = finished.next(timeout=_REPORT_EVERY_S)
            except NothingFinishedError:
                pass
            else:
                progress.done += 1
                if sent_bytes is not None:
                    progress.sent += 1
                    progress.bytes_sent += sent_bytes
            if on_progress is not None:
                on_progress(progress)
    except (Exception, KeyboardInterrupt) as error:
        if not isinstance(error, DriveError | NetworkError):
            connection.closing.set()
        raise
    finally:
        pool.terminate()
    return progress


def _deliver(
    connection: Connection, drive_id: str, there: dict[str, FileAnswer], log: UploadLog, file: UploadFile
) -> int | None:
    """See to it that the server has a file; return the bytes sent, or None if it had the file already."""
    known, signature = there.get(file.path), file.signature
    if known is not None and log.sent(file.path) == Sent(signature, known.sha256):
        return None
    payload = file.load()
    is_there = known is not None and known.sha256 == payload.sha256
    if not is_there:
        _put(connection, file_address(drive_id, file.path), file.path, payload)
    log.add(file.path, Sent(signature, payload.sha256))
    return None if is_there else payload.size


def _put(connection: Connection, address: str, path: str, payload: Payload) -> None:
    try:
        answer = connection.ask("PUT", address, FileAnswer, body=payload.body, headers=payload.headers)
    except Refusal as error:
        raise Refusal(error.status, error.problem, f"(while sending {path}, {payload.size:,} bytes)") from error
    if answer.sha256 != payload.sha256:
        raise NetworkError(
            f"{connection.server} accepted {path}, but with other content than was sent (SHA-256 "
            f"{answer.sha256[:12]}... instead of {payload.sha256[:12]}...). Usual cause: a proxy that changes bodies."
        )


def file_address(drive_id: str, path: str) -> str:
    """Return the address of a file of a drive."""
    return f"/drives/{drive_id}/files/{quote(path)}"
