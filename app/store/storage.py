"""Where the bytes are kept: a folder behind a small interface, so that a storage of objects can follow.

Keys are paths below one root: ``drives/<id>/files/...`` (as uploaded), ``drives/<id>/reduced/...`` (what jobs read),
``jobs/<id>/scratch/...`` (checkpoints, progress), ``jobs/<id>/result/...``, ``incoming/<process>/...`` (what is being
received). The library reads and writes folders, so a storage can show a key as one (`Storage.folder`); a storage of
objects would do so by a local copy.
"""

import os
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

from sqlalchemy.exc import SQLAlchemyError

from interloc.errors import InterLocError

INCOMING = "incoming"

LEFT_ALONE_S = 24 * 3600.0
"""Age from which what is being received is left over from a server that was killed: no body takes so long."""


def files_below(folder: Path) -> Iterator[str]:
    """Yield the files of a folder and of those below it, as paths in it; of a folder that is not there, none."""

    def refuse(error: OSError) -> None:  # what is in a folder that cannot be read must not count as gone
        if not isinstance(error, FileNotFoundError | NotADirectoryError):
            raise error

    for parent, _, names in os.walk(folder, onerror=refuse):
        place = Path(parent).relative_to(folder)
        yield from ((place / name).as_posix() for name in names)


def remove_empty(folder: Path, root: Path) -> None:
    """Remove a folder and those above it below a root, as far as they are empty, so that a file can take the name."""
    while folder != root:
        with suppress(OSError):
            folder.rmdir()
        folder = folder.parent


class DataFolderGoneError(SQLAlchemyError):
    """The data folder is not where it was: whatever waits for the database to answer waits for this too."""


class Storage:
    """A folder on this machine, or on a file system that all servers and workers mount at the same place.

    It stays the folder that it was when it was opened: where another one, or none, is found at its place, everything
    raises `DataFolderGoneError` until it is back.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(os.path.realpath(root))
        self._incoming = self.root / INCOMING / secrets.token_hex(8)
        self._handle: int | None = None  # kept open: no other folder can get the same number meanwhile
        self._is: os.stat_result | None = None
        with suppress(OSError):
            self._is = self.root.stat()
            self._handle = os.open(self.root, os.O_RDONLY)  # not on Windows

    def close(self) -> None:
        """Remove what this process was receiving."""
        shutil.rmtree(self._incoming, ignore_errors=True)
        if self._handle is not None:
            os.close(self._handle)
        self._handle = self._is = None

    def check(self) -> None:
        """See that the data folder is where it was, else raise a `DataFolderGoneError`."""
        if self._is is None:
            return
        with suppress(OSError):
            if os.path.samestat(self.root.stat(), self._is):
                return
        raise DataFolderGoneError(
            "the data folder is not where it was when the server started. Usual cause: it was moved or replaced, or "
            "its volume is no longer mounted; put it back, or start the server anew."
        )

    def incoming(self) -> Path:
        """Return the folder where this process receives files before they take their places."""
        self.check()
        self._incoming.mkdir(parents=True, exist_ok=True)
        return self._incoming

    def folder(self, key: str) -> Path:
        """Return the folder of a key, for code that works on folders; it need not exist."""
        self.check()
        path = Path(os.path.normpath(self.root / key))
        if not path.is_relative_to(self.root) or path == self.root:
            raise InterLocError(f"{key!r} leads out of the data folder")
        return path

    def delete(self, key: str) -> None:
        """Remove a file or a folder with all that is in it; nothing happens where there is none."""
        path = self.folder(key)
        if path.is_dir() and not path.is_symlink():
            # Renamed first: what is half deleted must not be found under its name.
            doomed = self.incoming() / secrets.token_hex(12)
            with suppress(FileNotFoundError):
                path.replace(doomed)
                remove(doomed)
        else:
            path.unlink(missing_ok=True)

    def check_writable(self) -> None:
        """Write something that nobody sees; an `OSError` where the folder is read-only, its disk full or failing."""
        self.check()
        with TemporaryFile(dir=self.root) as probe:
            probe.write(b"?")

    def free_bytes(self) -> int:
        """Return the space that is left."""
        self.check()
        return shutil.disk_usage(self.root).free


def remove_dead(root: Path) -> list[tuple[str, int]]:
    """Remove what servers that were killed were receiving, from the folder of all; return names and bytes of it."""
    removed = []
    for path in sorted(root.iterdir()) if root.is_dir() else []:
        if all(is_old(each) for each in (path, *(path / name for name in files_below(path)))):
            removed.append((path.name, size_of(path)))
            remove(path)
    return removed


def remove(path: Path) -> None:
    """Remove a file or a folder with all that is in it, as far as possible."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def is_old(path: Path) -> bool:
    """Return whether something was last changed so long ago that no upload can still need it."""
    try:
        return time.time() - path.stat().st_mtime > LEFT_ALONE_S
    except OSError:  # gone meanwhile
        return False


def size_of(path: Path) -> int:
    """Return the bytes of a file, or of all files in a folder."""
    files = (path / name for name in files_below(path)) if path.is_dir() else [path]
    total = 0
    for file in files:
        with suppress(OSError):  # gone meanwhile
            total += file.lstat().st_size
    return total
