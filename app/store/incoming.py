"""Where a process receives files: a folder of its own, locked for as long as it lives.

What lies in the folder of a process that is dead is known to be nobody's any more, and is removed by the next one that
starts. The lock belongs to the operating system: it goes with the process, however that ends.
"""

import secrets
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path

from filelock import FileLock, Timeout

from interloc.errors import OutputError

LEFT_ALONE_S = 24 * 3600.0
"""Age from which something without a lock is left over: of older versions, or on a file system that has no locks."""

_LOCK = "lock"


class Incoming:
    """The folder of this process, made and locked when it is first asked for."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._made = threading.Lock()
        self._lock: FileLock | None = None
        self._folder = root

    def folder(self) -> Path:
        """Return the folder; an `OutputError` where it cannot be made."""
        with self._made:
            if self._lock is None:
                self._folder, self._lock = self._open()
        self._folder.mkdir(parents=True, exist_ok=True)
        return self._folder

    def close(self) -> None:
        """Remove the folder with all that is in it."""
        with self._made:
            if self._lock is not None:
                shutil.rmtree(self._folder, ignore_errors=True)
                self._lock.release(force=True)
                self._lock = None

    def _open(self) -> tuple[Path, FileLock]:
        for _ in range(10):
            folder = self._root / secrets.token_hex(8)
            lock = FileLock(folder / _LOCK, timeout=0, thread_local=False)
            with suppress(Timeout, FileNotFoundError):  # another process took the folder for that of a dead one
                folder.mkdir(parents=True)
                lock.acquire()
                if (folder / _LOCK).exists():
                    return folder, lock
                lock.release(force=True)
        raise OutputError(f"{self._root}: no folder can be made and locked there.")


def remove_dead(root: Path) -> list[tuple[str, int]]:
    """Remove what dead processes were receiving, from the folder of all of them; return names and bytes of it."""
    removed = []
    for path in sorted(root.iterdir()) if root.is_dir() else []:
        is_dead, lock = _take(path)
        try:
            if is_dead:
                removed.append((path.name, size_of(path)))
                remove(path)
        finally:
            if lock is not None:
                lock.release(force=True)
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
    files = path.rglob("*") if path.is_dir() else [path]
    total = 0
    for file in files:
        with suppress(OSError):  # gone meanwhile
            total += file.lstat().st_size if not file.is_dir() else 0
    return total


def _take(path: Path) -> tuple[bool, FileLock | None]:
    """Return whether no living process uses something, and its lock, which keeps others from starting to."""
    if not (path / _LOCK).is_file():
        return is_old(path), None
    lock = FileLock(path / _LOCK, timeout=0, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        return False, None
    except OSError:  # a file system without locks
        return is_old(path), None
    return True, lock
