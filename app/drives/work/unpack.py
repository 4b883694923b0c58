"""Unpacking of an archive (.zip, .tar, .tar.gz, .tar.zst): nothing in it is trusted, and all of it comes or nothing.

The libraries read one member after the other. What they unpack is counted against the limits of a drive and of a ratio,
time and memory are limited as those of all workers, and names of files are used only once the archive was read.
"""

import errno
import gzip
import hashlib
import io
import shutil
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, BinaryIO, Literal, Self, cast

import zstandard

from app.paths import BadNameError, check_path
from app.work.requests import FilesOutcome, JobRequest, UnpackJob
from app.work.task import LISTING, Part, Plan, Report, Task, UnpackedFile, place_unpacked, read_listing
from interloc.drives.layouts import is_part, is_recording
from interloc.errors import InterLocError, OutputError
from interloc.osm.untrusted import is_map
from interloc.reduction.listing import find_drives

ArchiveKind = Literal["zip", "tar", "tar.gz", "tar.zst"]

ARCHIVE = "archive"
"""Name of the archive in the scratch folder."""

MAGIC_BYTES = 262
"""Number of bytes at the beginning of a file that determine its kind."""

_PIECE = 1 << 20
_MB = 1 << 20
_BLOCK = 512  # of a tar file
_LOOK_BYTES = 64 * _MB
_FREE_RATIO_BYTES = 64 * _MB  # small archives may unpack to this much, whatever their ratio
_FREE_FILES = 10_000  # small archives may hold as many files, whatever their size
_BYTES_PER_FILE = 32  # each further file takes at least this much of an archive, however well it is packed
_MAX_FOLDERS = 10_000  # which an archive may list beside its files
_MAX_HEADER_BYTES = 1 << 14  # of a long name or extended header of a tar file, which are read into memory
_MAX_WINDOW_BYTES = 1 << 27  # of zstandard: the limit of its own tools unless an option raises it
_MAX_HEADERS = 20  # of one member: names, attributes, and those of the whole archive
_HEADERS = (
    tarfile.XHDTYPE,
    tarfile.XGLTYPE,
    tarfile.SOLARIS_XHDTYPE,
    tarfile.GNUTYPE_LONGNAME,
    tarfile.GNUTYPE_LONGLINK,
)
_DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    zstandard.ZstdError,
    struct.error,
    EOFError,
    OverflowError,
    ValueError,
    LookupError,
    NotImplementedError,  # a zip file of a later version
    OSError,
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


def prepare(task: Task[UnpackJob]) -> Plan:
    """Return one part; its units are packed megabytes, because neither files nor contents can be counted before."""
    size = _archive(task).stat().st_size
    return Plan([Part(0, 0, max(1, size // _MB))], max(1, size // _MB))


def run(task: Task[UnpackJob], part: Part, report: Report) -> None:
    """Unpack all files to the scratch folder, with a list of them."""
    if (task.scratch / LISTING).is_file():
        return
    folder = task.scratch / f"unpacking-{task.attempt}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        unpacking = _Unpacking(task, folder, lambda: report(0))
        with members(_archive(task), unpacking.count, unpacking.max_files) as found:
            for member in found:
                unpacking.take(member)
        place_unpacked(folder / "drive", unpacking.sort(), task.scratch)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    report(part.stop - part.start)


def finish(task: Task[JobRequest], plan: Plan) -> FilesOutcome:
    """Sum up what was unpacked, or simulated; the server moves the files into the drive."""
    del plan
    listing = read_listing(task.scratch)
    return FilesOutcome(files=len(listing), size_bytes=sum(file.size_bytes for file in listing))


def _archive(task: Task[UnpackJob]) -> Path:
    older = task.request.archive
    return task.scratch / ARCHIVE if older is None else task.drive / older


class _Unpacking:
    """Files unpacked so far, stored under numbers instead of names."""

    def __init__(self, task: Task[UnpackJob], folder: Path, look_up: Callable[[], None]) -> None:
        self._folder = folder
        self._limits = task.settings
        packed_bytes = _archive(task).stat().st_size
        self._max_bytes = min(
            self._limits.max_drive_bytes, max(_FREE_RATIO_BYTES, int(packed_bytes * self._limits.max_archive_ratio))
        )
        self.max_files = min(self._limits.max_drive_files, max(_FREE_FILES, packed_bytes // _BYTES_PER_FILE))
        self._look_up = look_up
        self._files: dict[str, tuple[Path, UnpackedFile]] = {}
        self._unpacked = self._streamed = self._looked_at = self._members = 0

    def count(self, size: int) -> None:
        """Count decompressed bytes, headers and padding included."""
        self._streamed += size
        self._check_size(self._streamed, "the archive")

    def take(self, member: Member) -> None:
        """Unpack a file; refuse it where its name is not valid or comes twice, or there is too much."""
        self._members += 1
        if self._members > self.max_files:
            raise _too_many_files(self.max_files)
        name = member.name.removeprefix("./")
        if _is_litter(name):
            return
        try:
            check_path(name)
        except BadNameError as error:
            raise ArchiveError(str(error)) from error
        if name in self._files:
            raise ArchiveError(f"{name}: comes twice in the archive. Pack it anew.")
        place = self._folder / str(len(self._files))
        limit = self._limits.max_recording_bytes if is_recording(name) else self._limits.max_file_bytes
        digest, size = hashlib.sha256(), 0
        with member.open() as source, ExitStack() as stack:
            target: BinaryIO | None = None  # of an empty file nothing is made before the whole archive is known
            while piece := source.read(_PIECE):
                size += len(piece)
                self._unpacked += len(piece)
                if size > limit:
                    raise ArchiveError(f"{name}: is larger than {limit / _MB:,.0f} MB, the limit of a file.")
                self._check_size(self._unpacked, name)
                target = target or stack.enter_context(place.open("xb"))
                target.write(piece)
                digest.update(piece)
        if size != member.size_bytes:
            raise ArchiveError(f"{name}: has {size:,} bytes, not {member.size_bytes:,} as the archive says.")
        self._files[name] = place, UnpackedFile(name, size, digest.hexdigest())

    def sort(self) -> list[UnpackedFile]:
        """Give the files of the drive their names, and return a list of them."""
        if not self._files:
            raise ArchiveError("the archive holds no files.")
        listing = []
        for name, path in drive_paths({name: file.size_bytes for name, (_, file) in self._files.items()}).items():
            place, file = self._files[name]
            target = self._folder / "drive" / path
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                if file.size_bytes:
                    place.rename(target)
                else:
                    target.touch(exist_ok=False)
            except OSError as error:
                raise ArchiveError(f"{name}: is a file and a folder in the archive. Pack it anew.") from error
            listing.append(replace(file, path=path))
        return listing

    def _check_size(self, size: int, name: str) -> None:
        """Refuse what unpacks to too much; check from time to time for free space and for a cancelled job."""
        if size > self._max_bytes:
            raise ArchiveError(
                f"{name}: the archive unpacks to more than {self._max_bytes / _MB:,.0f} MB, the limit for a drive or "
                f"{self._limits.max_archive_ratio:g} times its own size. Send the files one by one instead."
            )
        if size - self._looked_at > _LOOK_BYTES:
            self._looked_at = size
            self._look_up()
            if shutil.disk_usage(self._folder).free < self._limits.min_free_bytes:
                raise OutputError("the disk of the service is full. Nothing of the archive was kept.")


def _is_litter(name: str) -> bool:
    """Return whether a file was put into the archive by a file manager: hidden files, metadata of other systems."""
    segments = name.split("/")
    hidden = "\\" not in name and any(each.startswith(".") and each not in {".", ".."} for each in segments)
    return (hidden and not {"", ".", ".."} & set(segments)) or segments[0] == "__MACOSX" or segments[-1] == "Thumbs.db"


def drive_paths(sizes: Mapping[str, int]) -> dict[str, str]:
    """Find the drive in an archive: path in the archive -> path in the drive, of its files and of what belongs to it.

    Without a drive, these are all files, without the one folder that they may lie in; two drives are an `ArchiveError`.
    """
    drives = find_drives(sizes, "archive")
    if len(drives) > 1:
        raise ArchiveError(
            f"the archive holds {len(drives)} drives: {drives[0].root or '.'}/ and {drives[1].root}/"
            f"{' and more' if len(drives) > 2 else ''}. Pack one drive per archive, and make a drive for each."
        )
    if drives:
        front = f"{drives[0].root}/" if drives[0].root else ""
    else:
        folders = {name.partition("/")[0] if "/" in name else "" for name in sizes}
        is_packed = len(folders) == 1 and "" not in folders and not any(map(is_part, sizes))
        front = f"{folders.pop()}/" if is_packed else ""
    paths = {name: name[len(front) :] for name in sizes if name.startswith(front)}
    beside = {path: inside for drive in drives for inside, path in drive.files.items()}
    maps = {name: name.rpartition("/") for name in sizes if is_map(name)}
    above = {name: last for name, (folder, slash, last) in maps.items() if front.startswith(folder + slash)}
    taken = set(paths.values())
    for name, inside in {**beside, **above}.items():
        if name not in paths and inside not in taken:
            paths[name] = inside
            taken.add(inside)
    return paths


@contextmanager
def members(path: Path, count: Callable[[int], None], max_files: int) -> Iterator[Iterator[Member]]:
    """Open an archive, and yield its files; folders are passed over.

    `count` is called with the bytes that come out of its decompressor beside the contents of members: what is skipped
    counts, and so do folders beyond some thousands. An `ArchiveError`, also raised within the block, says that it is no
    archive, is damaged or cut short, or holds links, devices or encrypted files.
    """
    with path.open("rb") as file:
        kind = archive_kind(file.read(MAGIC_BYTES))
        file.seek(0)
        try:
            if kind is None:
                raise ArchiveError("the archive is neither .zip nor .tar, .tar.gz or .tar.zst.")
            yield _zip_members(file, max_files) if kind == "zip" else _tar_members(file, kind, count, max_files)
        except _DAMAGE as error:
            if isinstance(error, OSError) and error.errno not in {None, errno.EINVAL}:
                raise  # the disk, not the archive: a position before its beginning is "invalid argument"
            raise ArchiveError(
                f"the archive is damaged or cut short ({error}). Usual cause: a transfer that did not finish."
            ) from error


def _too_many_files(max_files: int) -> ArchiveError:
    return ArchiveError(f"the archive holds more than {max_files:,} files.")


def _zip_members(file: BinaryIO, max_files: int) -> Iterator[Member]:
    with zipfile.ZipFile(file) as archive:
        if len(archive.infolist()) > max_files + _MAX_FOLDERS:
            raise _too_many_files(max_files)
        for info in archive.infolist():
            if info.is_dir():
                continue
            if stat.S_IFMT(info.external_attr >> 16) not in {0, stat.S_IFREG}:
                raise _special(info.filename)
            if info.flag_bits & 0x1:
                raise ArchiveError(f"{info.filename!a}: is encrypted. Make the archive without a password.")
            # Other methods unpack all they can at once.
            if info.compress_type not in {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
                raise ArchiveError(f"{info.filename!a}: is packed by a method that is not read here. Use deflate.")
            yield Member(info.filename, info.file_size, lambda info=info: archive.open(info))  # type: ignore[misc]


def _special(name: str) -> ArchiveError:
    return ArchiveError(
        f"{name!a}: is a link or a device. A drive has plain files only; pack the files themselves (tar --dereference "
        "--hard-dereference)."
    )


def _tar_members(file: BinaryIO, kind: ArchiveKind, count: Callable[[int], None], max_files: int) -> Iterator[Member]:
    watched = _Watched(_decompressed(file, kind), count)
    with _BoundedTar.open(
        fileobj=watched, mode="r|", bufsize=1 << 16, encoding="utf-8", errors="surrogateescape"
    ) as archive:
        entries = 0
        while (info := archive.next()) is not None:
            archive.members.clear()  # type: ignore[attr-defined] # it keeps them for others than us
            entries += 1
            if entries > max_files + _MAX_FOLDERS:
                raise _too_many_files(max_files)
            if info.isdir():
                continue
            if not info.isreg() or info.issparse():
                raise _special(info.name)
            if info.size < 0:
                raise ArchiveError(f"{info.name!a}: its header announces {info.size:,} bytes, which no file has.")
            yield Member(info.name, info.size, lambda info=info: cast("IO[bytes]", archive.extractfile(info)))  # type: ignore[misc]
        watched.drain()


def _decompressed(file: BinaryIO, kind: ArchiveKind) -> BinaryIO:
    if kind == "tar.gz":
        return cast("BinaryIO", gzip.GzipFile(fileobj=file))
    if kind == "tar.zst":
        decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
        return cast("BinaryIO", decompressor.stream_reader(file, read_across_frames=True))
    return file


class _BoundedTarInfo(tarfile.TarInfo):
    """A header that is refused where `tarfile` would need much memory or time for what follows it."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> Self:
        """Read a header."""
        info = super().frombuf(buf, encoding, errors)
        if info.type in _HEADERS and info.size > _MAX_HEADER_BYTES:
            raise tarfile.ReadError(f"a header of {info.size:,} bytes")
        return info

    @classmethod
    def fromtarfile(cls, tarfile: tarfile.TarFile) -> Self:
        """Read a header and, within the same call, those that it announces."""
        assert isinstance(tarfile, _BoundedTar)
        with tarfile.one_more():
            return super().fromtarfile(tarfile)


class _BoundedTar(tarfile.TarFile):
    """A tar file of which no member has so many headers that reading them by recursion would end in an error."""

    tarinfo = _BoundedTarInfo
    _headers = 0

    @contextmanager
    def one_more(self) -> Iterator[None]:
        """Count a header in the block."""
        self._headers += 1
        if self._headers > _MAX_HEADERS:
            raise tarfile.ReadError(f"more than {_MAX_HEADERS} headers of one member")
        try:
            yield
        finally:
            self._headers -= 1


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
