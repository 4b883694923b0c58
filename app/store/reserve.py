"""Disk space that is spoken for: kept for deleting, which the database has to record, or booked by bodies under way.

Bodies are booked when they are announced, and their space is free again when they have come. Without that many could
begin at once where there is room for one, each not knowing of the others.
"""

from __future__ import annotations

import logging
import os
import secrets
import shutil
import threading
from contextlib import suppress
from pathlib import Path

RESERVE = "reserve"
"""Name of the file in the data folder."""

_NEARLY_FULL_BYTES = 4 * 1024**2  # a transaction of the database and the entries of folders fit in
_PIECE = 1024**2

_log = logging.getLogger(__name__)


class Reserve:
    """A file of some megabytes that is given up when the disk is full, and made again when there is room.

    Parameters
    ----------
    folder
        The data folder.
    size
        Bytes; 0: no reserve.
    keep_free
        Bytes that stay free when it is made.
    """

    def __init__(self, folder: Path, size: int, keep_free: int) -> None:
        self._folder = folder
        self._file = folder / RESERVE
        self._size = size
        self._keep_free = keep_free

    def fill(self) -> None:
        """Make the file if there is room for it; it is there whole or not at all."""
        if not self._size or self._holds() == self._size:
            return
        with suppress(OSError):
            if shutil.disk_usage(self._folder).free - self._size < max(self._keep_free, _NEARLY_FULL_BYTES):
                return
            new = self._folder / f".{RESERVE}-{secrets.token_hex(4)}"
            try:
                _allocate(new, self._size)
                new.replace(self._file)
            finally:
                new.unlink(missing_ok=True)

    def give_up_if_full(self) -> None:
        """Free the space if there is hardly any other."""
        with suppress(OSError):
            if shutil.disk_usage(self._folder).free < _NEARLY_FULL_BYTES:
                self.give_up()

    def give_up(self) -> None:
        """Free the space."""
        try:
            self._file.unlink()
        except OSError:
            return
        _log.warning("the disk is full: the reserve of %d bytes was given up; delete what is not needed", self._size)

    def _holds(self) -> int:
        try:
            return self._file.stat().st_size
        except OSError:
            return 0


def _allocate(path: Path, size: int) -> None:
    """Write a file whose blocks exist: of zeros in a row a file system may keep the number only."""
    with path.open("xb") as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        if getattr(os.fstat(file.fileno()), "st_blocks", 0) * 512 < size:
            for start in range(0, size, _PIECE):
                file.write(os.urandom(min(_PIECE, size - start)))
        file.flush()
        os.fsync(file.fileno())


class Bookings:
    """The sum of what is announced and has not come yet.

    Attributes
    ----------
    lock
        Held while the free space is looked at and a booking is made: no two see the same space.
    size_bytes : int
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.size_bytes = 0
