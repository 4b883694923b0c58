"""A log of the files that a push has sent, so that an interrupted push continues where it stopped.

A push is identified by the server, the folder of the drive and the options that decide what is sent. The service lists
the files that it has with their digests, but the digest of a reduced scan is known only once the scan was read and
reduced. The log spares that: beside every digest it keeps sizes and times of the files that the scan was made from. It
also keeps the id of the drive: names of drives need not be unique, and other clients may use the same.

One line per file is added as soon as the server has accepted it, so nothing is lost when the process is killed; a line
cut short is ignored. Without a log (another machine, an emptied cache) the whole drive is sent again.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any, Self, TextIO

from filelock import FileLock, Timeout
from platformdirs import user_cache_path

from interloc.errors import OutputError
from interloc.files import reason_of

_KEPT_DAYS = 60
_KEY_DIGITS = 32


@dataclass(frozen=True)
class Sent:
    """A file that the service accepted."""

    signature: str
    """See `interloc.client.upload.UploadFile.signature`."""
    sha256: str
    """Digest of what was sent."""


class UploadLog:
    """The log of one push.

    Parameters
    ----------
    folder
        Folder of all logs; created where missing.
    identity
        What distinguishes this push from others.

    Raises
    ------
    OutputError
        The folder cannot be used, or the same push runs in another process.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        key = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:_KEY_DIGITS]
        self._path = folder / f"{key}.jsonl"
        self._process_lock = FileLock(folder / f"{key}.lock")
        self._thread_lock = Lock()
        self.drive_id: str | None = None
        self._sent: dict[str, Sent] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _sweep(folder)
            self._process_lock.acquire(blocking=False)
            self._file: TextIO = self._path.open("a+", encoding="utf-8")
            self._read()
        except Timeout:
            raise OutputError(
                "the same drive is being pushed to the same server by another process. Wait for its end; then the same "
                "command reports the id of the drive without sending it again."
            ) from None
        except OSError as error:
            raise OutputError(f"{self._path} could not be used: {reason_of(error)}.") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()
        self._process_lock.release()

    def begin(self, drive_id: str) -> None:
        """Forget what was sent before: from now on it goes to this drive."""
        self._file.seek(0)
        self._file.truncate()
        self._sent.clear()
        self.drive_id = drive_id
        self._add({"drive": drive_id})

    def sent(self, path: str) -> Sent | None:
        """Return what was sent of a file of the drive, if anything."""
        return self._sent.get(path)

    def add(self, path: str, sent: Sent) -> None:
        """Remember that the service has accepted a file; threads may call this."""
        with self._thread_lock:
            self._sent[path] = sent
            self._add({"path": path, "signature": sent.signature, "sha256": sent.sha256})

    def _add(self, line: dict[str, str]) -> None:
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")
        self._file.flush()

    def _read(self) -> None:
        self._file.seek(0)
        text = self._file.read()
        for line in text.splitlines():
            with suppress(ValueError, TypeError, KeyError):  # cut short when the process was killed
                entry = json.loads(line)
                if "drive" in entry:
                    self.drive_id = str(entry["drive"])
                else:
                    self._sent[str(entry["path"])] = Sent(str(entry["signature"]), str(entry["sha256"]))
        if text and not text.endswith("\n"):
            self._file.write("\n")


def log_folder() -> Path:
    """Return the folder of all logs, in the user's cache."""
    return user_cache_path("interloc") / "push"


def _sweep(folder: Path) -> None:
    """Remove logs that nobody will come back to."""
    for path in folder.glob(f"{'?' * _KEY_DIGITS}.*"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _KEPT_DAYS * 86400:
                path.unlink()
