"""Files brought into a folder: what is there already stays, the rest is linked where possible, else copied.

No file of a data folder is ever changed in place (each is written under a temporary name, then renamed), so a second
name of it is as good as a copy, and its size and time stand for its content.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from interloc.errors import OutputError
from interloc.files import reason_of

PARTIAL = "partial"
"""Folder of files that are being copied."""

_BATCH_FILES, _BATCH_BYTES = 500, 512 * 1024**2
_IN_THE_WAY = (FileExistsError, NotADirectoryError, IsADirectoryError)


class Transfer:
    """Brings files into a folder.

    Copies take their names in batches, each once it is on disk: whatever stops a transfer, also a power failure, what
    has its name is whole, and the next transfer goes on from there.

    Attributes
    ----------
    files, size_bytes : int
        What was brought so far, without what was there.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.files = 0
        self.size_bytes = 0
        self._partial = root / PARTIAL
        self._waiting: list[tuple[Path, Path]] = []
        self._waiting_bytes = 0
        self._can_link = True
        shutil.rmtree(self._partial, ignore_errors=True)

    def bring(self, source: Path, key: str) -> int:
        """Bring a file to its place below the root, now or with the next `finish`; returns its size."""
        target = self.root / key
        found = source.stat()
        with suppress(FileNotFoundError, NotADirectoryError):
            if self._is_same(found, target.stat()):
                return found.st_size
        with writing(target):
            if not self._link(source, target):
                self._copy(source, target, found)
        self.files += 1
        self.size_bytes += found.st_size
        if len(self._waiting) >= _BATCH_FILES or self._waiting_bytes >= _BATCH_BYTES:
            self.finish()
        return found.st_size

    def finish(self) -> None:
        """Give all copies their names."""
        if self._waiting:
            os.sync()
        for temporary, target in self._waiting:
            with writing(target):
                self._place(temporary, target)
        self._waiting.clear()
        self._waiting_bytes = 0

    def close(self) -> None:
        """Remove the folder of what is being copied."""
        shutil.rmtree(self._partial, ignore_errors=True)

    def _is_same(self, found: os.stat_result, there: os.stat_result) -> bool:
        if self._can_link and found.st_dev == there.st_dev:  # the times of two files can be the same
            return found.st_ino == there.st_ino
        return (found.st_size, found.st_mtime_ns) == (there.st_size, there.st_mtime_ns)

    def _link(self, source: Path, target: Path) -> bool:
        """Link a file, directly where there is nothing of its name; False where files cannot be linked."""
        if not self._can_link:
            return False
        try:
            with suppress(FileExistsError, FileNotFoundError, NotADirectoryError):
                os.link(source, target)
                return True
            os.link(source, temporary := self._temporary())
        except FileNotFoundError:
            raise
        except OSError:  # another file system, or one without links; else the copy finds out what is wrong
            self._can_link = False
            return False
        self._place(temporary, target)
        return True

    def _copy(self, source: Path, target: Path, found: os.stat_result) -> None:
        temporary = self._temporary()
        shutil.copyfile(source, temporary)
        os.utime(temporary, ns=(found.st_atime_ns, found.st_mtime_ns))
        self._waiting.append((temporary, target))
        self._waiting_bytes += found.st_size

    def _temporary(self) -> Path:
        self._partial.mkdir(parents=True, exist_ok=True)
        temporary = self._partial / str(len(self._waiting))
        temporary.unlink(missing_ok=True)
        return temporary

    def _place(self, temporary: Path, target: Path) -> None:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.replace(target)
        except _IN_THE_WAY:  # a file has become a folder, or the other way round
            for place in (target, *target.parents):
                if place == self.root:
                    break
                if place.is_file():
                    place.unlink()
                elif place == target:
                    shutil.rmtree(target)
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.replace(target)


def prune(root: Path, folder: str, keys: Collection[str]) -> int:
    """Remove the files of a folder that are not among the keys, and folders that are empty then; returns how many."""
    removed = 0
    for parent, folders, names in os.walk(root / folder, topdown=False):
        for name in names:
            path = Path(parent, name)
            if path.relative_to(root).as_posix() not in keys:
                with writing(path):
                    path.unlink()
                removed += 1
        for name in folders:
            with suppress(OSError):
                Path(parent, name).rmdir()
    with suppress(OSError):
        (root / folder).rmdir()
    return removed


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name the file that could not be written, and why.

    Raises
    ------
    OutputError
    FileNotFoundError
        What was to be brought is gone.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except OSError as error:
        raise OutputError(f"{path} could not be written: {reason_of(error)}.") from error


Advance = Callable[[int, int, str], None]
"""Called with how much is done, of how much (bytes, drives, folders), and the name of what is at hand."""


def no_progress(_done: int, _total: int, _note: str) -> None:
    """Report to nobody."""
