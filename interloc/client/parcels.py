"""What is sent: files of a drive, each with its name there and a way to get its bytes."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from interloc.client.journal import signature
from interloc.errors import DriveError

_PIECE = 1024 * 1024


@dataclass(frozen=True)
class Parcel:
    """A file of the drive on the server.

    Attributes
    ----------
    path : str
        Where it belongs in the drive.
    content : Path or callable
        A file to be sent as it is, or what makes the bytes: then `made_from`.
    made_from : tuple of Path
        Files that the bytes are made from.
    made_by : str
        What else decides about the bytes.
    """

    path: str
    content: Path | Callable[[], bytes]
    made_from: tuple[Path, ...] = ()
    made_by: str = ""

    @property
    def signature(self) -> str:
        """Changes when the bytes may have changed; two parcels without sources differ by `made_by` alone."""
        sources = (self.content,) if isinstance(self.content, Path) else self.made_from
        try:
            return signature(*sources, made_by=self.made_by)
        except OSError as error:
            raise _unreadable(error) from error

    def load(self) -> Load:
        """Get the bytes ready to be sent; a file is read piece by piece.

        Raises
        ------
        DriveError
            A file cannot be read, or is damaged.
        """
        try:
            return _file_load(self.content) if isinstance(self.content, Path) else _bytes_load(self.content())
        except OSError as error:
            raise _unreadable(error) from error


@dataclass(frozen=True)
class Load:
    """Bytes to be sent.

    Attributes
    ----------
    size : int
    digest : bytes
        SHA-256.
    body : callable
        Gives the bytes, or an iterator over pieces of them, as often as it is called.
    """

    size: int
    digest: bytes
    body: Callable[[], bytes | Iterator[bytes]]

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


def _bytes_load(data: bytes) -> Load:
    return Load(len(data), hashlib.sha256(data).digest(), lambda: data)


def _file_load(path: Path) -> Load:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").digest()
        size = file.tell()

    def pieces() -> Iterator[bytes]:
        left = size
        with path.open("rb") as file:
            while left and (piece := file.read(min(_PIECE, left))):
                left -= len(piece)
                yield piece
        if left:
            raise DriveError(f"{path} became shorter while it was sent. Send it again when nothing writes to it.")

    return Load(size, digest, pieces)


def _unreadable(error: OSError) -> DriveError:
    return DriveError(f"{error.filename or 'a file'}: cannot be read: {(error.strerror or str(error)).lower()}.")
