"""Reading of small text files and listing of numbered files; nothing in them is trusted."""

from __future__ import annotations

import gzip
import os
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from interloc.arrays import IntArray
from interloc.drives.findings import DriveFileError

MAX_TEXT_BYTES = 512 * 1024 * 1024
"""More than a million pose lines; also the limit of what a .gz may unpack to."""

MAX_NUMBER = 1e7
"""No coordinate of a drive is larger (metres)."""

_HEAD = 64


def shown(path: Path, root: Path) -> str:
    """Name a file in a message: relative to the drive where it lies inside."""
    try:
        return path.relative_to(root).as_posix() or "."
    except ValueError:
        return str(path)


def read_text(path: Path, root: Path) -> str:
    """Read a text file (or its .gz) whole.

    Raises
    ------
    DriveError
        It is missing, a folder, empty, unreadable, not text, or larger than any such file can be.
    """
    name = shown(path, root)
    try:
        if path.is_dir():
            raise DriveFileError(name, "is a folder; a text file was expected.")
        if path.exists() and not path.is_file():
            raise DriveFileError(name, "is a pipe or device; a text file was expected.")
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            data = _read_limited(file)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise DriveFileError(
            name, f"is not a complete gzip file ({error}). Usual cause: a download cut short."
        ) from error
    except OSError as error:
        raise DriveFileError(name, f"cannot be read: {os_reason(error)}.") from error
    if len(data) > MAX_TEXT_BYTES:
        raise DriveFileError(name, f"is larger than {MAX_TEXT_BYTES // 1024**2} MB, which no such file is.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DriveFileError(
            name, f"is not a text file (byte {error.start} is not UTF-8). Usual cause: a binary file under this name."
        ) from error
    if "\0" in text:
        raise DriveFileError(name, "is not a text file (it holds zero bytes). Usual cause: a binary or UTF-16 file.")
    if not text.strip():
        raise DriveFileError(name, "is empty. Usual cause: a copy or download that did not finish.")
    return text


def _read_limited(file: BinaryIO | gzip.GzipFile) -> bytes:
    """Read to the end, or a little beyond the limit."""
    pieces, size = [], 0
    while size <= MAX_TEXT_BYTES and (piece := file.read(1 << 20)):
        pieces.append(piece)
        size += len(piece)
    return b"".join(pieces)


def os_reason(error: OSError) -> str:
    """Say in words why a file could not be read."""
    return (error.strerror or str(error)).lower()


def numbers_of(fields: list[str], path: Path, root: Path, line: int) -> list[float]:
    """Turn the fields of a line into finite numbers.

    Raises
    ------
    DriveError
        One of them is no number, or not finite.
    """
    try:
        values = [float(field) for field in fields]
    except ValueError:
        bad = next(field for field in fields if not is_number(field))
        raise DriveFileError(
            shown(path, root),
            f"line {line}: {bad[:_HEAD]!r} is not a number. Numbers separated by spaces were expected.",
        ) from None
    if not np.isfinite(values).all():
        raise DriveFileError(
            shown(path, root),
            f"line {line}: holds a value that is not finite (NaN or infinity). "
            "Usual cause: an odometry that lost track; cut the drive before it.",
        )
    return values


def is_number(text: str) -> bool:
    """Say whether a field is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


@dataclass(frozen=True)
class NumberedFiles:
    """The files ``000000.suffix``, ``000001.suffix``, ... of a folder.

    Attributes
    ----------
    folder : Path
    suffix : str
        With its dot.
    digits : int
        Width that the numbers are padded to with zeros.
    numbers : (N,) int64
        Ascending.
    sizes : (N,) int64
        Bytes.
    """

    folder: Path
    suffix: str
    digits: int
    numbers: IntArray
    sizes: IntArray

    def name(self, number: int) -> str:
        """Return the file name of a number."""
        return f"{number:0{self.digits}d}{self.suffix}"

    def path(self, number: int) -> Path:
        """Return the file of a number."""
        return self.folder / self.name(number)


def list_numbered(folder: Path, suffix: str, root: Path) -> NumberedFiles:
    """List the numbered files of a folder, by their names and sizes only.

    Raises
    ------
    DriveError
        The folder cannot be read, holds no such file, or names that are not plain numbers of one width.
    """
    stems: list[str] = []
    sizes: list[int] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                stem, extension = os.path.splitext(entry.name)  # noqa: PTH122 - Path is 10 times slower here
                if extension == suffix and not stem.startswith("."):
                    if entry.is_dir():
                        raise DriveFileError(shown(folder / entry.name, root), "is a folder; a file was expected.")
                    stems.append(stem)
                    sizes.append(entry.stat().st_size)
    except OSError as error:
        raise DriveFileError(shown(folder, root), f"cannot be read: {os_reason(error)}.") from error
    if not stems:
        raise DriveFileError(
            shown(folder, root), f"holds no {suffix} file. Expected one a scan: 000000{suffix}, 000001{suffix}, ..."
        )
    odd = sorted(stem for stem in stems if not (stem.isascii() and stem.isdigit() and len(stem) <= 18))
    if odd:
        raise DriveFileError(
            shown(folder / (odd[0] + suffix), root),
            f"is not named by its scan number. Expected names as 000000{suffix}, 000001{suffix}, ...",
        )
    digits = min(len(stem) for stem in stems)
    numbers = np.array([int(stem) for stem in stems], dtype=np.int64)
    order = np.argsort(numbers, kind="stable")
    for number, stem in zip(numbers, stems, strict=True):
        if stem != f"{number:0{digits}d}":
            raise DriveFileError(
                shown(folder / (stem + suffix), root),
                f"is numbered otherwise than its neighbours ({digits} digits). "
                "Usual cause: files of two drives in one folder.",
            )
    return NumberedFiles(folder, suffix, digits, numbers[order], np.array(sizes, dtype=np.int64)[order])


def missing_numbers(numbers: IntArray, wanted: IntArray) -> IntArray:
    """Return the wanted numbers that are not there."""
    return np.setdiff1d(wanted, numbers)


def listed(numbers: IntArray, most: int = 5) -> str:
    """Write some of many numbers: "3, 4, 5 and 12 more"."""
    head = ", ".join(str(int(number)) for number in numbers[:most])
    rest = len(numbers) - most
    return head if rest <= 0 else f"{head} and {rest:,} more"


def rows_by_frame(frames: IntArray, rows: int) -> IntArray | None:
    """Map scans to rows by the frame number, or one to one where a drive starts later and has a row a scan.

    Parameters
    ----------
    frames : (N,) int64
        Scan numbers, ascending.
    rows : int
        Rows of the file.

    Returns
    -------
    (N,) int64 or None
        Row of every scan; None where there are too few.
    """
    if frames[-1] < rows:
        return frames
    if rows == len(frames) and frames[-1] - frames[0] == rows - 1:
        return np.arange(rows, dtype=np.int64)
    return None


def gaps(frames: IntArray) -> IntArray:
    """Return the numbers missing between the first and the last scan (of the first thousand gaps, to be shown)."""
    breaks = np.flatnonzero(np.diff(frames) > 1)[:1000]
    missing = [np.arange(frames[i] + 1, min(frames[i + 1], frames[i] + 1001)) for i in breaks]
    return np.concatenate(missing) if missing else np.empty(0, dtype=np.int64)
