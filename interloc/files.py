"""Files and folders that appear whole or not at all.

A run that is stopped half-way (Ctrl-C, full disk) must leave neither half a file nor half a result folder. Both are
therefore written under a temporary name beside their place and renamed when they are complete.

A new folder takes the place of an old one, and what its user keeps there is in its place at every moment. All that the
user has in the old folder gets a second name in the new one first (hard links); then the two folders are exchanged, in
one step where the system can (Linux); then the old one, which holds nothing of its own any more, is removed. Whatever
is killed in between, one folder with everything of the user has the name; what is left over hidden beside it is
recognized by the next run.
"""

import ctypes
import errno
import os
import secrets
import shutil
import signal
import stat
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from interloc.errors import OutputError

_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO}
"""What a failed write to an open file can be; other errors without a file name come from pipes and the network."""


UNFINISHED = ".partial-unfinished"
"""Name of a file in a folder that is still being built."""

_GONE = "-gone"  # end of the name of a folder that is being removed
_HERE, _EXCHANGE = -100, 2  # AT_FDCWD, RENAME_EXCHANGE

IsOurs = Callable[[Path], bool]
"""Whether an entry of an old folder is a part of what was written there, and goes with it."""


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
        os.fsync(handle.fileno())
        handle.close()
        temporary.replace(path)
        _sync_folder(path.parent)
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
    """Build a folder that takes its name only once it is complete; several runs into one come one after the other.

    `out` must not exist, be empty, or hold the file `marker`: then it is replaced when the new one is complete. What is
    in it and neither among `names`, which are all that may be part of such a folder, nor in the new one is the user's
    and moves to the new one; no file of the user is out of its place at any moment, see the head of this module. A
    folder of something else, and what could not be written, is an OutputError; nothing is left behind.

    A folder that cannot be renamed (a mount point, as in a container, or one whose parent is not writable) is
    filled in place instead: built in a hidden folder inside, then its files are renamed into place, `marker` last.
    """
    target = Path(os.path.realpath(out))  # a link to a folder stays a link
    _refuse_foreign(target, out, marker)
    in_place = target.is_dir() and (target.is_mount() or not os.access(target.parent, os.W_OK | os.X_OK))
    temporary = target / f".partial-{secrets.token_hex(4)}" if in_place else _temporary_name(target)
    created: list[Path] = []

    def is_ours(entry: Path) -> bool:
        return entry.name in names or entry.name.startswith(".partial-")

    ours = True  # whether this function is running: an error of the caller may concern something else than the folder
    try:
        _make_parents(temporary, created)
        with ExitStack() as at_work:
            with locked(target.parent):
                if not in_place:
                    take_back(target, _hidden(target), marker, is_ours)
                temporary.mkdir()
                (temporary / UNFINISHED).touch()
                at_work.enter_context(locked(temporary))
            ours = False
            yield temporary
            ours = True
            with locked(target.parent), uninterrupted():
                _refuse_foreign(target, out, marker)
                if in_place:
                    _move_into(temporary, target, marker, is_ours)
                else:
                    exchange(temporary, target, is_ours)
            _sync_folder(target.parent)
    except BaseException as error:
        with suppress(OSError):
            discard(temporary)
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
    return path.parent / f"{_hidden(path)}{secrets.token_hex(4)}"


def _hidden(path: Path) -> str:
    return f".{path.name[:200]}.partial-"


def _concerns(error: OSError, temporary: Path) -> bool:
    """Return whether an error arose from writing there; a failed write to an open file does not name the file."""
    if not isinstance(error.filename, str | bytes):
        return error.errno in _DISK_ERRORS
    return Path(os.fsdecode(error.filename)).is_relative_to(temporary)


def _refuse_foreign(target: Path, out: Path, marker: str) -> None:
    """Raise OutputError where `target` is something that InterLoc may not replace."""
    try:
        if not target.exists():
            return
        if not target.is_dir():
            raise OutputError(f"{out} is a file; a result needs a folder. Give the name of a new or an empty folder.")
        names = sorted(entry.name for entry in target.iterdir())
    except OSError as error:
        raise OutputError(f"{out} could not be written: {reason_of(error)}.") from error
    foreign = [name for name in names if not name.startswith(".partial-")]
    if foreign and marker not in foreign:
        shown = ", ".join(foreign[:3]) + (", ..." if len(foreign) > 3 else "")
        raise OutputError(
            f"{out} exists and is not an InterLoc result: it holds {shown} but no {marker}. "
            "It was not touched. Give the name of a new or an empty folder."
        )


def _make_parents(temporary: Path, created: list[Path]) -> None:
    """Create the missing folders above, noting each, so that a failed run can remove them again."""
    missing = [folder for folder in temporary.parents if not folder.exists()]
    for folder in reversed(missing):
        folder.mkdir(exist_ok=True)
        created.append(folder)


def _move_into(temporary: Path, target: Path, marker: str, is_ours: IsOurs) -> None:
    """Replace the results in `target` by those of `temporary`, file by file; without `marker` meanwhile."""
    (temporary / UNFINISHED).unlink()
    (target / marker).unlink(missing_ok=True)
    for entry in list(target.iterdir()):
        if entry != temporary and is_ours(entry):
            shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    for entry in sorted(temporary.iterdir(), key=lambda e: e.name == marker):
        entry.replace(target / entry.name)
    temporary.rmdir()


def _sync_folder(folder: Path) -> None:
    """Bring a rename to disk where the system can (not on Windows)."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# a new folder in place of an old one ----------------------------------------------------------------------------------


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
    """Deal with what killed runs have left beside a folder, under names of a prefix: nothing of the user stays hidden.

    A folder is complete where it has the file `marker`.
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

    After an OSError the old one is in its place, with all that was in it.
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
