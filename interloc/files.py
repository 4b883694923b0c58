"""Files and folders that appear whole or not at all.

A run that is stopped half-way (Ctrl-C, full disk) must leave neither half a file nor half a result folder. Both are
therefore written under a temporary name and renamed when they are complete. Where a folder of that name is there, its
files are replaced one by one, and what its user keeps beside them is not touched.
"""

import errno
import os
import secrets
import shutil
import time
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from interloc.errors import OutputError

_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}
"""What a failed write to an open file can be; other errors without a file name come from pipes and the network."""


PARTIAL = ".partial-"
_LEFT_S = 7 * 86400.0  # what a killed run has left is removed when it is as old as no run


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a file for writing that takes its name only once it is complete and on disk.

    An older one of that name is replaced, or stays untouched where anything fails; then nothing is left behind. What
    the system refuses (no space left, no permission) is an OutputError.
    """
    temporary = _temporary_name(path)
    handle: BinaryIO | None = None
    try:
        handle = temporary.open("xb")
        yield handle
        handle.flush()
        is_alone = PARTIAL not in path.parent.name  # else it is brought to disk with all others, at their end
        if is_alone:
            os.fsync(handle.fileno())
        handle.close()
        temporary.replace(path)
        if is_alone:
            _sync(path.parent)
    except BaseException as error:
        if handle is not None:
            with suppress(OSError):  # closing flushes once more, and a full disk fails once more
                handle.close()
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and _concerns(error, temporary):
            raise OutputError(f"{path} could not be written: {reason_of(error)}.") from error
        raise


def write_file(path: Path, content: bytes | str) -> None:
    """Write a file, whole or not at all: `atomic_write` of all that is in it."""
    with atomic_write(path) as handle:
        handle.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def atomic_folder(out: Path, *, marker: str, names: Collection[str] = ()) -> Iterator[Path]:
    """Build a folder that is complete where it has the file `marker`.

    `out` must not exist, be empty, or hold `marker`. A new one takes its name when it is complete. In an old one, what
    is among `names`, which are all that may be part of such a folder, is then replaced, file by file; `marker` goes
    first and comes last, so that a run that is killed meanwhile leaves an incomplete folder, which the next one fills.
    All else in it is the user's and stays. A folder of something else, and what could not be written, is an
    OutputError; nothing is left behind.
    """
    target = Path(os.path.realpath(out))  # a link to a folder stays a link
    with _locked(target):  # nobody replaces it at this moment
        refuse_foreign(target, out, marker)
    in_place = target.is_dir()
    temporary = target / f"{PARTIAL}{secrets.token_hex(4)}" if in_place else _temporary_name(target)
    created: list[Path] = []
    ours = True  # whether this function is running: an error of the caller may concern something else than the folder
    is_begun = False  # what is half replaced is kept, as where the process is killed: `finish_replacing` goes on
    try:
        for folder in reversed([each for each in temporary.parents if not each.exists()]):
            folder.mkdir(exist_ok=True)
            created.append(folder)  # so that a failed run can remove it again
        temporary.mkdir()
        ours = False
        yield temporary
        ours = True
        with ThreadPoolExecutor() as pool:  # the disk takes as long for all as for one
            list(pool.map(_sync, temporary.iterdir()))
        _sync(temporary)
        if not in_place and not target.exists():
            temporary.rename(target)
        else:
            with _locked(target):
                refuse_foreign(target, out, marker)
                is_begun = True
                _replace(temporary, target, marker, names)
        _sync(target.parent)
    except BaseException as error:
        if not is_begun:
            shutil.rmtree(temporary, ignore_errors=True)
        for folder in reversed(created):
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, OutputError):
            raise OutputError(str(error).replace(str(temporary), str(out))) from error
        if isinstance(error, OSError) and (ours or _concerns(error, temporary)):
            named = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else temporary
            place = out / named.relative_to(temporary) if named.is_relative_to(temporary) else out
            raise OutputError(f"{place} could not be written: {reason_of(error)}.") from error
        raise


def reason_of(error: OSError) -> str:
    """Return why the system refused, to stand within a sentence: "no space left on device"."""
    reason = error.strerror or str(error)
    return reason[:1].lower() + reason[1:]


def _temporary_name(path: Path) -> Path:
    """Return a hidden name beside `path`, another one at each call: leftovers of a killed run are no obstacle."""
    return path.parent / f".{path.name[:50]}{PARTIAL}{secrets.token_hex(4)}"


def _concerns(error: OSError, temporary: Path) -> bool:
    """Return whether an error arose from writing there; a failed write to an open file does not name the file."""
    if not isinstance(error.filename, str | bytes):
        return error.errno in _DISK_ERRORS
    return Path(os.fsdecode(error.filename)).is_relative_to(temporary)


def refuse_foreign(target: Path, out: Path, marker: str) -> None:
    """Raise OutputError where `target` is something that InterLoc may not replace."""
    try:
        if not target.exists():
            return
        if not target.is_dir():
            raise OutputError(f"{out} is a file; a result needs a folder. Give the name of a new or an empty folder.")
        there = sorted(entry.name for entry in target.iterdir())
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    foreign = [name for name in there if not name.startswith(PARTIAL)]
    if foreign and marker not in there and foreign == there:
        shown = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
        raise OutputError(
            f"{out} exists and is not an InterLoc result: it holds {shown} but no {marker}. "
            "It was not touched. Give the name of a new or an empty folder."
        )


def _replace(new: Path, target: Path, marker: str, names: Collection[str]) -> None:
    """Replace what is ours in a folder by what is in a new one, which is removed; without `marker` meanwhile."""
    (target / marker).unlink(missing_ok=True)
    for entry in list(target.iterdir()):
        is_left = entry.name.startswith(PARTIAL) and time.time() - entry.stat().st_mtime > _LEFT_S
        if is_left or (entry.name in names and not os.path.lexists(new / entry.name)):
            _remove(entry)
    _move_into(new, target, marker, names)


def finish_replacing(target: Path, *, marker: str, names: Collection[str]) -> None:
    """Go on where `atomic_folder` was killed while it replaced a folder: the new content lies in it, complete."""
    if target.is_dir() and not (target / marker).exists():
        whole = [each for each in target.glob(f"{PARTIAL}*") if (each / marker).is_file()]
        if whole:
            _move_into(max(whole, key=lambda each: (each / marker).stat().st_mtime), target, marker, names)


def _move_into(new: Path, target: Path, last: str = "", names: Collection[str] = ()) -> None:
    for entry in sorted(new.iterdir(), key=lambda each: each.name == last):
        there = target / entry.name
        if there.is_dir() and not there.is_symlink():
            if entry.is_dir() and not entry.is_symlink() and entry.name not in names:
                _move_into(entry, there)
                continue
            _remove(there)
        entry.replace(there)
    new.rmdir()


def _remove(entry: Path) -> None:
    shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()


def _sync(path: Path) -> None:
    """Bring a file, or the renames in a folder, to disk where the system can (not on Windows)."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        if error.errno in _DISK_ERRORS:
            raise


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let other runs into a folder wait; where the system has no locks (Windows), they do not."""
    try:
        import fcntl  # noqa: PLC0415 - Unix only

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
