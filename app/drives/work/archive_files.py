"""Reading of untrusted archives: .zip, .tar, .tar.gz, .tar.zst, member by member, in one pass."""

from __future__ import annotations

import errno
import gzip
import io
import lzma
import re
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, Literal, Self

import zstandard

from interloc.errors import InterLocError

ArchiveKind = Literal["zip", "tar", "tar.gz", "tar.zst"]

MAGIC_BYTES = 262
"""Number of bytes at the beginning of a file that determine its kind."""

_MAX_HEADER_BYTES = 1 << 16  # of a long name or extended header of a tar file, which are read into memory
_MAX_GLOBAL_BYTES = 1 << 10  # of the extended header for all members, which each of them copies; git writes 52
_LONG_NUMBER = re.compile(rb"\d{40}")  # in `tarfile`, time grows with the square of the digits (CVE-2024-6232)
_MAX_WINDOW_BYTES = 1 << 27  # of zstandard: the limit of its own tools unless an option raises it
_MAX_FOLDERS = 10_000  # which an archive may list beside its files
_BOUNDED_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # of which `zipfile` unpacks no more than is asked for
_PIECE = 1 << 12  # asked for of the others: it unpacks all that comes of as many packed bytes
_MAX_ENTRY_BYTES = 1024  # of the list in a zip file, on average: 46 and the name
_ENTRY = b"PK\x01\x02"
_BLOCK = 512
_MAX_FRAME_HEADER = 18  # bytes, of zstandard
_REPEATED = 1  # kind of a block of zstandard that is one byte again and again
_SKIPPED = frozenset((0x184D2A50 + number).to_bytes(4, "little") for number in range(16))
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
    """A file of an archive."""

    name: str
    """As written in the archive; not checked."""
    size_bytes: int
    """As written in the archive; not to be trusted."""
    open: Callable[[], IO[bytes]]
    """Returns its contents; they must be read before the next member is asked for."""


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
    count
        Called with the bytes that come out of its decompressor beside the contents of members: what is skipped counts.
    max_files
        Of a zip file that lists many more, the list is not even looked into; folders beyond some thousands count too.

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
                yield _tar_members(_decompressed(file, kind), count, max_files)
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
            if info.compress_type == zipfile.ZIP_BZIP2:  # a block of some bytes is 46 MB
                raise ArchiveError(f"{info.filename!a}: is packed by bzip2, which is not read here. Use deflate.")
            try:
                file = archive.open(info)
                return file if info.compress_type in _BOUNDED_METHODS else _InPieces(file)  # type: ignore[return-value]
            except NotImplementedError as error:
                raise ArchiveError(
                    f"{info.filename!a}: is packed by a method that is not read here ({error}). Use deflate."
                ) from error

        yield Member(info.filename, info.file_size, contents)


class _InPieces(io.RawIOBase):
    """A file of a zip archive of which little is asked for at a time."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int = -1, /) -> bytes:
        del size
        return self._file.read(_PIECE)


def _special(name: str) -> ArchiveError:
    return ArchiveError(
        f"{name!a}: is a link or a device. A drive has plain files only; pack the files themselves (tar --dereference)."
    )


def _tar_members(stream: BinaryIO, count: Callable[[int], None], max_files: int) -> Iterator[Member]:
    watched = _Watched(stream, count)
    with tarfile.open(
        fileobj=watched, mode="r|", bufsize=1 << 16, tarinfo=_CarefulTarInfo, encoding="utf-8", errors="surrogateescape"
    ) as archive:
        entries = 0
        while (info := archive.next()) is not None:
            archive.members.clear()  # type: ignore[attr-defined] # it keeps them for others than us
            entries += 1
            if entries > max_files + _MAX_FOLDERS:
                raise too_many_files(max_files)
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
    """A header that is refused where `tarfile` would need much memory or time for it."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """Read a header."""
        info = super().frombuf(buf, encoding, errors)
        most = _MAX_GLOBAL_BYTES if info.type == tarfile.XGLTYPE else _MAX_HEADER_BYTES
        if info.type in _HEADERS and info.size > most:
            raise tarfile.ReadError(f"a header of {info.size:,} bytes")
        return info

    def _proc_pax(self, archive: tarfile.TarFile) -> tarfile.TarInfo:
        """Look at an extended header before `tarfile` does: it searches it in ways that take for ever."""
        if self.type == tarfile.XGLTYPE and archive.pax_headers:
            raise tarfile.ReadError("a second extended header for all members")
        stream: Any = archive.fileobj
        content = stream.read(-(-self.size // _BLOCK) * _BLOCK)
        _check_records(content[: self.size])
        archive.fileobj = _Again(stream, content)
        try:
            return super()._proc_pax(archive)  # type: ignore[misc,no-any-return] # no part of the documented interface
        finally:
            archive.fileobj = stream


def _check_records(content: bytes) -> None:
    """Refuse an extended header whose records do not follow each other as they should, "LENGTH KEY=VALUE", or count."""
    start = 0
    while start < len(content):
        length, space, _ = content[start : start + 8].partition(b" ")
        record = content[start : start + int(length)]  # a ValueError is taken for a damaged archive
        start += len(record)
        if not space or b"=" not in record or not record.endswith(b"\n") or len(record) != int(length):
            raise tarfile.ReadError("an extended header that is not made of records")
    if _LONG_NUMBER.search(content):
        raise tarfile.ReadError("an extended header with a very long number")


class _Again:
    """A stream, the last piece of which is read once more."""

    def __init__(self, stream: Any, piece: bytes) -> None:  # noqa: ANN401 - `tarfile` has its own
        self._stream = stream
        self._piece = piece

    def read(self, size: int) -> bytes:
        if not self._piece:
            data: bytes = self._stream.read(size)
            return data
        piece, self._piece = self._piece, b""
        return piece

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        return getattr(self._stream, name)


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
    """Frames of zstandard one after the other; the last must be complete, which the library's own reader ignores.

    The decompressor is given a block at a time (RFC 8878, section 3.1): none unpacks to more than 128 kB.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
        self._frame: zstandard.ZstdDecompressionObj | None = None
        self._has_checksum = False
        self._ready = bytearray()

    def read(self, size: int = -1, /) -> bytes:
        while not self._ready and self._fill():
            pass
        data = bytes(self._ready[:size])
        del self._ready[:size]
        return data

    def _fill(self) -> bool:
        """Decompress a little more; False at the end."""
        if self._frame is None:
            return self._begin()
        head = self._exactly(3)
        number = int.from_bytes(head, "little")
        is_last, kind, size = number & 1, number >> 1 & 3, number >> 3
        block = self._exactly((1 if kind == _REPEATED else size) + 4 * (is_last & self._has_checksum))
        self._ready += self._frame.decompress(head + block)
        if is_last:
            if not self._frame.eof:
                raise EOFError("a zstandard frame is not complete")
            self._frame = None
        return True

    def _begin(self) -> bool:
        """Begin the next frame; False where there is none."""
        head = self._file.read(_MAX_FRAME_HEADER)
        if not head:
            return False
        if head[:4] in _SKIPPED:  # a frame that is none of the contents
            self._file.seek(8 + int.from_bytes(head[4:8], "little") - len(head), io.SEEK_CUR)
            return True
        size = zstandard.frame_header_size(head)
        self._has_checksum = bool(head[4] & 4)
        self._file.seek(size - len(head), io.SEEK_CUR)
        self._frame = self._decompressor.decompressobj()
        self._ready += self._frame.decompress(head[:size])
        return True

    def _exactly(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) < size:
            raise EOFError("the last zstandard frame is not complete")
        return data
