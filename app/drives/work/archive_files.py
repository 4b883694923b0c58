"""Reading of untrusted archives: .zip, .tar, .tar.gz, .tar.zst, member by member, in one pass."""

from __future__ import annotations

import errno
import gzip
import io
import lzma
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, Literal, Self

import zstandard

from interloc.errors import InterLocError

ArchiveKind = Literal["zip", "tar", "tar.gz", "tar.zst"]

MAGIC_BYTES = 262
"""Number of bytes at the beginning of a file that determine its kind."""

_MAX_HEADER_BYTES = 1 << 20  # of a long name or extended header of a tar file, which are read into memory
_MAX_WINDOW_BYTES = 1 << 27  # of zstandard: the limit of its own tools unless an option raises it
_MAX_FOLDERS = 10_000  # which a zip file may list beside its files
_MAX_ENTRY_BYTES = 1024  # of the list in a zip file, on average: 46 and the name
_ENTRY = b"PK\x01\x02"
_BLOCK = 512
_HEADERS = (
    tarfile.XHDTYPE,
    tarfile.XGLTYPE,
    tarfile.SOLARIS_XHDTYPE,
    tarfile.GNUTYPE_LONGNAME,
    tarfile.GNUTYPE_LONGLINK,
)


class ArchiveError(InterLocError):
    """The archive is damaged, or holds what a drive cannot have."""

    http_status = 422


@dataclass(frozen=True)
class Member:
    """A file of an archive.

    Attributes
    ----------
    name : str
        As written in the archive; not checked.
    size_bytes : int
        As written in the archive; not to be trusted.
    open : callable
        Returns its contents; they must be read before the next member is asked for.
    """

    name: str
    size_bytes: int
    open: Callable[[], IO[bytes]]


def archive_kind(head: bytes) -> ArchiveKind | None:
    """Return the kind of an archive by its first `MAGIC_BYTES`; None if it is not an archive."""
    if head.startswith((b"PK\x03\x04", b"PK\x05\x06")):
        return "zip"
    if head.startswith(b"\x1f\x8b"):
        return "tar.gz"
    if head.startswith(b"\x28\xb5\x2f\xfd"):
        return "tar.zst"
    return "tar" if head[257:262] == b"ustar" else None


@contextmanager
def members(path: Path, count: Callable[[int], None], max_files: int) -> Iterator[Iterator[Member]]:
    """Open an archive.

    Parameters
    ----------
    path
    count
        Called with the bytes that come out of its decompressor beside the contents of members: what is skipped counts.
    max_files
        Of a zip file that lists many more, the list is not even looked into.

    Yields
    ------
    iterator of Member
        Files only; folders are passed over.

    Raises
    ------
    ArchiveError
        The file is not an archive, is damaged or cut short, or holds links, devices or encrypted files. Also raised
        within the block.
    """
    with path.open("rb") as file:
        kind = archive_kind(file.read(MAGIC_BYTES))
        file.seek(0)
        try:
            if kind == "zip":
                bounded = _BoundedZip(file, max_files)
                with zipfile.ZipFile(bounded) as archive:
                    bounded.is_listed = True
                    yield _zip_members(archive)
            elif kind is not None:
                yield _tar_members(_decompressed(file, kind), count)
            else:
                raise ArchiveError("the archive is neither .zip nor .tar, .tar.gz or .tar.zst.")
        except (
            zipfile.BadZipFile,
            tarfile.TarError,
            zlib.error,
            lzma.LZMAError,
            zstandard.ZstdError,
            struct.error,
            EOFError,
            OverflowError,
            ValueError,
            LookupError,
            RuntimeError,  # of thousands of headers in a row too, which tarfile reads by recursion
            OSError,
        ) as error:
            if isinstance(error, OSError) and error.errno not in {None, errno.EINVAL}:
                raise  # the disk, not the archive: a position before its beginning is "invalid argument"
            raise ArchiveError(
                f"the archive is damaged or cut short ({error}). Usual cause: a transfer that did not finish."
            ) from error


def too_many_files(max_files: int) -> ArchiveError:
    """Return the error that an archive holds too many files."""
    return ArchiveError(f"the archive holds more than {max_files:,} files.")


class _BoundedZip(io.RawIOBase):
    """A zip file that does not hand out a list of too many files: `zipfile` would make an object of each."""

    def __init__(self, file: BinaryIO, max_files: int) -> None:
        self._file = file
        self._max_files = max_files
        self.is_listed = False

    def read(self, size: int = -1, /) -> bytes:
        if self.is_listed:
            return self._file.read(size)
        most = self._max_files + _MAX_FOLDERS
        if size > most * _MAX_ENTRY_BYTES:
            raise too_many_files(self._max_files)
        data = self._file.read(size)
        if data.count(_ENTRY) > most:
            raise too_many_files(self._max_files)
        return data

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True


def _zip_members(archive: zipfile.ZipFile) -> Iterator[Member]:
    for info in archive.infolist():
        kind = stat.S_IFMT(info.external_attr >> 16)
        if info.is_dir():
            continue
        if kind not in {0, stat.S_IFREG}:
            raise _special(info.filename)
        if info.flag_bits & 0x1:
            raise ArchiveError(f"{info.filename!a}: is encrypted. Make the archive without a password.")

        def contents(info: zipfile.ZipInfo = info) -> IO[bytes]:
            try:
                return archive.open(info)
            except NotImplementedError as error:
                raise ArchiveError(
                    f"{info.filename!a}: is packed by a method that is not read here ({error}). Use deflate."
                ) from error

        yield Member(info.filename, info.file_size, contents)


def _special(name: str) -> ArchiveError:
    return ArchiveError(
        f"{name!a}: is a link or a device. A drive has plain files only; pack the files themselves (tar --dereference)."
    )


def _tar_members(stream: BinaryIO, count: Callable[[int], None]) -> Iterator[Member]:
    watched = _Watched(stream, count)
    with tarfile.open(
        fileobj=watched, mode="r|", bufsize=1 << 16, tarinfo=_CarefulTarInfo, encoding="utf-8", errors="surrogateescape"
    ) as archive:
        for info in archive:
            if info.isdir():
                continue
            if not info.isreg() or info.issparse():
                raise _special(info.name)
            if info.size < 0:
                raise ArchiveError(f"{info.name!a}: its header announces {info.size:,} bytes, which no file has.")

            def contents(info: tarfile.TarInfo = info) -> IO[bytes]:
                file = archive.extractfile(info)
                assert file is not None
                return file

            yield Member(info.name, info.size, contents)
        watched.drain()


class _CarefulTarInfo(tarfile.TarInfo):
    """A header that is refused when it announces a name of gigabytes, which would be read into memory."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """Read a header."""
        info = super().frombuf(buf, encoding, errors)
        if info.type in _HEADERS and info.size > _MAX_HEADER_BYTES:
            raise tarfile.ReadError(f"a header of {info.size:,} bytes")
        return info


class _Watched(io.RawIOBase):
    """The bytes of a tar file, counted and read to the end, which a complete one marks by a block of zeros."""

    def __init__(self, stream: BinaryIO, count: Callable[[int], None]) -> None:
        self._stream = stream
        self._count = count
        self._last = b""

    def read(self, size: int = -1, /) -> bytes:
        data = self._stream.read(size)
        self._count(len(data))
        self._last = (self._last + data[-_BLOCK:])[-_BLOCK:]
        return data

    def drain(self) -> None:
        """Read what follows the last member, so that checksums at the end are verified."""
        while self.read(1 << 16):
            pass
        if self._last != bytes(_BLOCK):
            raise EOFError("its end mark is missing")


def _decompressed(file: BinaryIO, kind: ArchiveKind) -> BinaryIO:
    if kind == "tar.gz":
        return gzip.GzipFile(fileobj=file)  # type: ignore[return-value] # it reads like one
    if kind == "tar.zst":
        return _ZstdStream(file)  # type: ignore[return-value]
    return file


class _ZstdStream(io.RawIOBase):
    """Frames of zstandard one after the other; the last must be complete, which the library's own reader ignores."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
        self._frame: zstandard.ZstdDecompressionObj | None = None
        self._packed = b""
        self._ready = bytearray()

    def read(self, size: int = -1, /) -> bytes:
        while not self._ready and self._fill():
            pass
        data = bytes(self._ready[:size])
        del self._ready[:size]
        return data

    def _fill(self) -> bool:
        """Decompress a little more; False at the end."""
        packed = self._packed or self._file.read(1 << 14)  # little: it may become a thousand times as much
        self._packed = b""
        if not packed:
            if self._frame is not None:
                raise EOFError("the last zstandard frame is not complete")
            return False
        if self._frame is None:
            self._frame = self._decompressor.decompressobj()
        self._ready += self._frame.decompress(packed)
        if self._frame.eof:
            self._packed = self._frame.unused_data
            self._frame = None
        return True
