"""A new folder takes the place of an old one, and what its user keeps there is in its place at every moment.

All that the user has in the old folder gets a second name in the new one first (hard links); then the two folders are
exchanged, in one step where the system can (Linux); then the old one, which holds nothing of its own any more, is
removed. Whatever is killed in between, one folder with everything of the user has the name; what is left over hidden
beside it is recognized by the next run.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

UNFINISHED = ".partial-unfinished"
"""Name of a file in a folder that is still being built."""

_GONE = "-gone"  # end of the name of a folder that is being removed
_HERE, _EXCHANGE = -100, 2  # AT_FDCWD, RENAME_EXCHANGE

IsOurs = Callable[[Path], bool]
"""Whether an entry of an old folder is a part of what was written there, and goes with it."""


@contextmanager
def locked(folder: Path, *, wait: bool = True) -> Iterator[bool]:
    """Keep other runs from locking a folder; yields whether that succeeded. Without locks (Windows) it always does."""
    try:
        import fcntl  # noqa: PLC0415 - Unix only

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield True
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            is_free = True
        except BlockingIOError:
            is_free = False
        except OSError:  # a file system without locks
            is_free = True
        yield is_free
    finally:
        os.close(descriptor)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back for the moment that the block takes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before if before is not None else signal.SIG_DFL)
        if came:
            signal.raise_signal(signal.SIGINT)


def take_back(target: Path, prefix: str, marker: str, is_ours: IsOurs) -> None:
    """Deal with what killed runs have left beside a folder: nothing of the user stays hidden.

    Parameters
    ----------
    target
        The folder.
    prefix
        With which the names of what may be left over begin.
    marker
        Name of the file by which a complete folder is known.
    is_ours
    """
    for left in [entry for entry in target.parent.iterdir() if entry.name.startswith(prefix)]:
        if left.is_symlink() or not left.is_dir():
            continue
        with locked(left, wait=False) as is_dead, suppress(OSError):
            if not is_dead:
                continue
            if left.name.endswith(_GONE) or (left / UNFINISHED).exists() or not any(left.iterdir()):
                discard(left)
            elif (left / marker).exists() and not target.exists():
                left.rename(target)
            elif (left / marker).exists():
                _carry_over(left, target, is_ours)
                discard(left)


def exchange(new: Path, target: Path, is_ours: IsOurs) -> None:
    """Put a new folder in place of an old one, or of none; the caller holds the lock of the folder above.

    Raises
    ------
    OSError
        The old one is in its place, with all that was in it.
    """
    if not target.exists():
        _finish(new)
        new.rename(target)
        return
    for entry in target.iterdir():
        if not is_ours(entry) and not os.path.lexists(new / entry.name):
            _link(entry, new / entry.name)
    _finish(new)
    old = _swap(new, target)
    with suppress(OSError):  # the new folder is in place: what fails from here on loses nothing
        _carry_over(old, target, is_ours)  # what came meanwhile
        discard(old)


def discard(folder: Path) -> None:
    """Remove a folder; whatever is killed meanwhile, what is left of it is known to be nobody's."""
    if not folder.name.endswith(_GONE):
        folder = folder.rename(f"{folder}{_GONE}")
    shutil.rmtree(folder, ignore_errors=True)


def _finish(new: Path) -> None:
    (new / UNFINISHED).unlink(missing_ok=True)


def _swap(new: Path, target: Path) -> Path:
    """Let two folders change names; returns that of the old one."""
    if _renameat2(new, target):
        return new
    old = new.with_name(f"{new.name}-old")
    target.rename(old)
    try:
        new.rename(target)
    except BaseException:
        old.rename(target)
        raise
    return old


def _renameat2(one: Path, other: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system cannot."""
    try:
        call: Any = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return bool(call(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0)


def _link(source: Path, target: Path) -> None:
    """Give what the user keeps a second name: folders are made anew, files linked, or copied where that cannot be."""
    mode = source.lstat().st_mode
    if stat.S_ISLNK(mode):
        target.symlink_to(source.readlink())
    elif stat.S_ISDIR(mode):
        target.mkdir()
        for entry in source.iterdir():
            _link(entry, target / entry.name)
        shutil.copystat(source, target)
    elif stat.S_ISREG(mode):
        try:
            os.link(source, target)
        except OSError:
            shutil.copy2(source, target)


def _carry_over(old: Path, target: Path, is_ours: IsOurs) -> None:
    """Move what a folder lacks of an old one."""
    for entry in old.iterdir():
        if not is_ours(entry):
            _move(entry, target / entry.name)


def _move(source: Path, target: Path) -> None:
    if not os.path.lexists(target):
        source.rename(target)
    elif source.is_dir() and not source.is_symlink() and target.is_dir() and not target.is_symlink():
        for entry in source.iterdir():
            _move(entry, target / entry.name)
