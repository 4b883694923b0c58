"""The files that a drive is read from: small text files and numbered files; nothing in them is trusted."""

import gzip
import math
import os
import stat
import zlib
from collections import Counter
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from interloc.drives.findings import DriveFileError, GeoreferenceFileError
from interloc.errors import InterLocError
from interloc.files import reason_of
from interloc.wording import counted, listed

MAX_ROWS = 1_000_000
"""Lines of a file with one per frame: more than a day of driving. Nothing longer is looked into."""

MAX_TEXT_BYTES = 512 * 1024 * 1024
"""Of such a file; also the limit of what a .gz may unpack to."""

MAX_SMALL_BYTES = 1024 * 1024
"""Of a calibration, or of the fix of one frame."""

LFS_POINTER = b"version https://git-lfs"
POINTER = "a pointer of Git LFS, not the file itself: `git lfs pull` fetches it."
EMPTY = "is empty. Usual cause: a copy or download that did not finish."
"""What is wrong with a file of no bytes."""

MAX_LINE_CHARS = 10_000

MAX_NUMBER = 1e7
"""No coordinate of a drive is larger (metres)."""

_HEAD = 64
_HEAD_BYTES = 65_536

_KEPT_BYTES = 64 * 1024 * 1024  # some 25 scans of 120,000 points

_kept: ContextVar[dict[Path, Any] | None] = ContextVar("files of one line per frame, and lists of files", default=None)
_kept_scans: ContextVar[dict[Hashable, Any] | None] = ContextVar("scans that were read last", default=None)
_Read = TypeVar("_Read")


@contextmanager
def each_read_once() -> Iterator[None]:
    """Keep files with one line per frame, lists of files and some scans while a drive is opened: steps ask again."""
    token, scans_token = _kept.set({}), _kept_scans.set({})
    try:
        yield
    finally:
        _kept.reset(token)
        _kept_scans.reset(scans_token)


def _once(kept: dict[Any, Any] | None, key: Hashable, read: Callable[[], _Read]) -> _Read:
    """Read something, or return it where it is kept."""
    if kept is None:
        return read()
    if key not in kept:
        kept[key] = read()
    found: _Read = kept[key]
    return found


def is_opening() -> bool:
    """Return whether a drive is being opened: some of its scans are looked into, not all."""
    return _kept_scans.get() is not None


def scan_once(key: Hashable, read: Callable[[], _Read], size_of: Callable[[_Read], int]) -> _Read:
    """Read a scan, or return it where it is one of the last 64 MB that were read while a drive is opened."""
    kept = _kept_scans.get()
    found = _once(kept, key, read)
    while kept is not None and len(kept) > 1 and sum(map(size_of, kept.values())) > _KEPT_BYTES:
        del kept[next(iter(kept))]
    return found


@dataclass(frozen=True)
class SourceFile:
    """A file or folder that a drive is read from, and the name by which messages call it."""

    path: Path
    root: Path
    """Folder of the drive."""

    _error: ClassVar[type[DriveFileError | GeoreferenceFileError]] = DriveFileError

    @property
    def name(self) -> str:
        """Its path, relative to the drive where it lies inside."""
        path, root = self.path.as_posix(), self.root.as_posix()  # relative_to is ten times as slow
        return self.path.absolute().name if path == root else path.removeprefix(f"{root}/")

    def fault(self, message: str, line: int | None = None) -> InterLocError:
        """Return the error to raise about it: what was found, what was expected, the usual cause."""
        return self._error(self.name, message if line is None else f"line {line}: {message}")

    def unreadable(self, error: OSError) -> InterLocError:
        """Return the error to raise where the system refuses to read it."""
        return self.fault(f"cannot be read: {reason_of(error)}.")

    def octets(self) -> UInt8Array:
        """Read the (N,) bytes of a file of values; quicker than `np.fromfile`, which asks for its place again."""
        try:
            with self.path.open("rb") as file:
                octets = np.empty(os.fstat(file.fileno()).st_size, np.uint8)
                return octets[: file.readinto(octets.data)]
        except OSError as error:
            raise self.unreadable(error) from error

    def text(self) -> str:
        """Read a small text file (or its .gz) whole."""
        return self._decoded(self._read(MAX_SMALL_BYTES))

    def lines(self) -> list[str]:
        """Read the lines of a text file, or of its .gz, with one per frame; without blank ones at its end."""
        text = self._decoded(self._data())
        if "\r" in text:
            text = text.replace("\r\n", "\n").replace("\r", "\n")
        lines = text.removesuffix("\n").split("\n")
        longest = max(range(len(lines)), key=lambda row: len(lines[row]))
        if len(lines[longest]) > MAX_LINE_CHARS:
            raise self.fault(
                f"{len(lines[longest]):,} characters in one line; expected at most {MAX_LINE_CHARS:,}. "
                "Usual cause: a file without line breaks.",
                longest + 1,
            )
        while not lines[-1].strip():
            lines.pop()
        return lines

    def head(self) -> bytes:
        """Return how a file with one line per frame begins; b"" where it cannot be read, which its reader says."""
        try:
            return b"" if self.path.suffix == ".gz" else self._data()[:_HEAD_BYTES]
        except InterLocError:
            return b""

    def _data(self) -> bytes:
        return _once(_kept.get(), self.path, partial(self._read, MAX_TEXT_BYTES, MAX_ROWS))

    def _read(self, max_bytes: int, max_rows: int | None = None) -> bytes:
        """Read to the end, or refuse what is too large before anything is made of it."""
        pieces, size, rows = [], 0, 0
        try:
            if not stat.S_ISREG(mode := self.path.stat().st_mode):
                what = "a folder" if stat.S_ISDIR(mode) else "a pipe or device"
                raise self.fault(f"is {what}; a text file was expected.")
            with gzip.open(self.path) if self.path.suffix == ".gz" else self.path.open("rb") as file:
                while piece := file.read(1 << 20):
                    size += len(piece)
                    rows += max(piece.count(b"\n"), piece.count(b"\r"))
                    if size > max_bytes:
                        raise self.fault(f"is larger than {max_bytes // 1024**2} MB, which no such file is.")
                    if max_rows is not None and rows > max_rows:
                        raise self.fault(
                            f"holds more than {max_rows:,} lines; expected one per frame of a drive. "
                            "Usual cause: the file of a whole data set, or one that was appended to again and again."
                        )
                    pieces.append(piece)
        except (gzip.BadGzipFile, EOFError, zlib.error) as error:
            raise self.fault(f"is not a complete gzip file ({error}). Usual cause: a download cut short.") from error
        except OSError as error:
            raise self.unreadable(error) from error
        return b"".join(pieces)

    def _decoded(self, data: bytes) -> str:
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            raise self.fault(
                "is UTF-16, as PowerShell writes with >. Expected UTF-8: `Get-Content FILE | Set-Content -Encoding "
                "utf8 NEW`, or iconv -f UTF-16 -t UTF-8."
            )
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise self.fault(
                f"is not a text file (byte {error.start} is not UTF-8). Usual cause: a binary file under this name."
            ) from error
        if "\0" in text:
            raise self.fault("is not a text file (it holds zero bytes). Usual cause: a binary or UTF-16 file.")
        if not text or text.isspace():
            raise self.fault(EMPTY)
        if data.startswith(LFS_POINTER):
            raise self.fault(f"is {POINTER}")
        if text[:1024].lstrip().startswith("<"):
            raise self.fault("is a web page. Usual cause: a download that wants a login, or whose address has changed.")
        return text

    def numbers(self, fields: list[str], line: int) -> list[float]:
        """Turn the fields of a line into finite numbers."""
        try:
            values = [float(field) for field in fields]
        except ValueError:
            bad = next(field for field in fields if not is_number(field))
            raise self.fault(f"{bad[:_HEAD]!r} is not a number. Expected numbers, all of them.", line) from None
        if not math.isfinite(sum(values)) and not all(map(math.isfinite, values)):  # the sum is quick
            raise self.fault(
                "holds a value that is not finite (NaN or infinity). "
                "Usual cause: an odometry that lost track; cut the drive before it.",
                line,
            )
        return values


class GeoreferenceFile(SourceFile):
    """A file or folder of a georeference: what is wrong with it is a `GeoreferenceError`."""

    _error = GeoreferenceFileError


def is_number(text: str) -> bool:
    """Return whether a field is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def seconds_of(text: str) -> float:
    """Read seconds, or a date and time with up to nanoseconds (KITTI raw); NaN where it is neither."""
    if is_number(text):
        return float(text)
    whole, _, fraction = text.strip().partition(".")
    try:
        moment = datetime.fromisoformat(whole + "+00:00")
        return moment.timestamp() + (float("0." + fraction) if fraction else 0.0)
    except ValueError:
        return float("nan")


SINCE_1970_MS = 1e11  # times from here on are in milliseconds or smaller units; scan numbers are smaller


def in_seconds(times: FloatArray) -> FloatArray:
    """Return times as seconds: they are, or are since 1970 in milli-, micro- or nanoseconds."""
    first = times[0] if len(times) else 0.0
    return times * (1.0 if first < SINCE_1970_MS else 1e-3 if first < 1e14 else 1e-6 if first < 1e17 else 1e-9)


@dataclass(frozen=True)
class NumberedFiles:
    """The files ``000000.suffix``, ``000001.suffix``, ... of a folder."""

    folder: SourceFile
    suffix: str
    """With its dot."""
    digits: int
    """Width that the numbers are padded to with zeros."""
    numbers: IntArray
    """(N,) int64: ascending."""
    sizes: IntArray
    """(N,) int64: bytes."""

    def path(self, number: int) -> Path:
        """Return the path of a number."""
        return self.folder.path / f"{number:0{self.digits}d}{self.suffix}"

    def file(self, number: int) -> SourceFile:
        """Return the file of a number."""
        return type(self.folder)(self.path(number), self.folder.root)


def list_numbered(folder: SourceFile, suffix: str) -> NumberedFiles:
    """List the numbered files of a folder, by their names and sizes only."""
    return replace(_once(_kept.get(), folder.path / f"*{suffix}", partial(_list, folder, suffix)), folder=folder)


def _list(folder: SourceFile, suffix: str) -> NumberedFiles:
    def fault(stem: str, message: str) -> InterLocError:
        return replace(folder, path=folder.path / (stem + suffix)).fault(message)

    stems: list[str] = []
    sizes: list[int] = []
    try:
        with os.scandir(folder.path) as entries:
            for entry in entries:
                stem = entry.name.removesuffix(suffix)
                if stem != entry.name and stem and not stem.startswith("."):
                    status = entry.stat()
                    if stat.S_ISDIR(status.st_mode):
                        raise fault(stem, "is a folder; a file was expected.")
                    stems.append(stem)
                    sizes.append(status.st_size)
    except OSError as error:
        raise replace(folder, path=Path(error.filename)).unreadable(error) from error  # a link may lead nowhere
    if not stems:
        raise folder.fault(
            f"holds no {suffix} file{_others_in(folder.path)}. "
            f"Expected one per scan: 000000{suffix}, 000001{suffix}, ..."
        )
    odd = sorted(stem for stem in stems if not (stem.isascii() and stem.isdigit() and len(stem) <= 18))
    if odd:
        raise fault(odd[0], _name_complaint(odd[0], suffix))
    digits = min(len(stem) for stem in stems)
    numbers = np.array([int(stem) for stem in stems], dtype=np.int64)
    order = np.argsort(numbers, kind="stable")
    for number, stem in zip(numbers, stems, strict=True):
        if stem != f"{number:0{digits}d}":
            raise fault(
                stem,
                f"is not numbered like its neighbours ({counted(digits, 'digit')}). "
                "Usual cause: files of two drives in one folder.",
            )
    return NumberedFiles(folder, suffix, digits, numbers[order], np.array(sizes, dtype=np.int64)[order])


_TIME_DIGITS = 19  # nanoseconds since 1970, from 2001 to 2286


def _name_complaint(stem: str, suffix: str) -> str:
    expected = f"000000{suffix}, 000001{suffix}, ..."
    if not (stem.isascii() and stem.isdigit()) or len(stem) > _TIME_DIGITS:
        return f"is not named by its scan number. Expected names such as {expected}"
    return (
        f"is named by a time, in nanoseconds. Expected scan numbers, {expected}: rename scans and labels alike in the "
        "order of their times, and write the times, in seconds, one per line into times.txt. Only PCD and LAS files "
        "may be named by times."
    )


def _others_in(folder: Path) -> str:
    """Return what else lies in a folder, for the message that those expected do not: ", but 281 .ply"."""
    others = sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    endings = Counter(path.suffix or "without ending" for path in others if not path.is_dir())
    found = [f"{count:,} {ending}" for ending, count in endings.most_common(3)]
    found = found or [f"the folder {path.name}/" for path in others[:3]]
    return f", but {' and '.join(found)}" if found else ""


MAX_NAMED = 3
"""Scans with a message each; of more with the same fault, the first speaks for all."""


def others_like_it(numbers: IntArray, of: int) -> str:
    """Return how many scans are like the first of some, where one message is for all of them."""
    if len(numbers) <= MAX_NAMED:
        return ""
    return f" {len(numbers):,} of {of:,} scans are like this ({listed(numbers)})."


def rows_by_frame(frames: IntArray, rows: int) -> IntArray | None:
    """Return the row of each of (N,) ascending scan numbers in a file: that of its number, or one to one.

    The latter where a drive starts later and has one row per scan. None where there are too few rows.
    """
    if frames[-1] < rows:
        return frames
    if rows == len(frames) and frames[-1] - frames[0] == rows - 1:
        return np.arange(rows, dtype=np.int64)
    return None


def in_part(part: str | None, frames: IntArray) -> BoolArray:
    """Return which of (N,) ascending scan numbers are in a part FROM:TO of a drive; None: all."""
    inside: BoolArray = np.ones(len(frames), dtype=bool)
    start, stop = (part or ":").split(":")
    if start:
        inside &= frames >= int(start)
    if stop:
        inside &= frames < int(stop)
    return inside


def rows_of_part(part: str, frames: IntArray, name: str) -> slice:
    """Return which scans are in a part of a drive, as `in_part`."""
    rows = np.flatnonzero(in_part(part, frames))
    if not len(rows):
        raise DriveFileError(
            name,
            f"has no scan in the part {part} (--frames): its scans are {frames[0]} to {frames[-1]}. Expected FROM:TO, "
            "where FROM is the first that is used and TO the first that is not.",
        )
    return slice(int(rows[0]), int(rows[-1]) + 1)


def gaps(frames: IntArray) -> IntArray:
    """Return the numbers missing between the first and the last scan (of the first thousand gaps, to be shown)."""
    breaks = np.flatnonzero(np.diff(frames) > 1)[:1000]
    missing = [np.arange(frames[i] + 1, min(frames[i + 1], frames[i] + 1001)) for i in breaks]
    return np.concatenate(missing) if missing else np.empty(0, dtype=np.int64)
