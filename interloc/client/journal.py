"""What was sent already, remembered on this machine, so that an interrupted push goes on where it stopped.

A push is known by the server, the folder of the drive and the options that decide what is sent. The service lists the
files that it has with their digests, but the digest of a reduced scan is known only once the scan was read and reduced.
The journal spares that: beside every digest it keeps sizes and times of the files that the scan was made from. It also
keeps the id of the drive: names of drives need not be unique, and other clients may use the same.

One line a file is added as the file is accepted, so nothing is lost when the process is killed; a line cut short is
ignored. Without a journal (another machine, an emptied cache) the drive is sent anew.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any, Self, TextIO

from interloc.errors import OutputError

_KEPT_DAYS = 60
_KEY_DIGITS = 32


@dataclass(frozen=True)
class Sent:
    """A file that the service took.

    Attributes
    ----------
    signature : str
        Of what it was made from.
    sha256 : str
        Of what was sent.
    """

    signature: str
    sha256: str


class Journal:
    """The memory of one push.

    Parameters
    ----------
    folder
        Of all journals; created where missing.
    identity
        What makes the push this one.

    Raises
    ------
    OutputError
        The folder cannot be used, or the same push runs in another process.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        key = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:_KEY_DIGITS]
        self._path = folder / f"{key}.jsonl"
        self._lock = Lock()
        self.drive_id: str | None = None
        self._sent: dict[str, Sent] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _sweep(folder)
            self._file: TextIO = self._path.open("a+", encoding="utf-8")
            self._lock_file()
            self._read()
        except OSError as error:
            raise OutputError(f"{self._path} could not be used: {error.strerror or error}.") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._file.close()

    def begin(self, drive_id: str) -> None:
        """Forget what was sent before: from now on it goes to this drive."""
        self._file.seek(0)
        self._file.truncate()
        self._sent.clear()
        self.drive_id = drive_id
        self._add({"drive": drive_id})

    def sent(self, path: str) -> Sent | None:
        """Return what is known of a file of the drive."""
        return self._sent.get(path)

    def add(self, path: str, sent: Sent) -> None:
        """Remember that the service took a file; threads may call this."""
        with self._lock:
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

    def _lock_file(self) -> None:
        """Keep out a second process with the same push; the lock dies with the process."""
        try:
            import fcntl  # noqa: PLC0415
        except ImportError:  # Windows: there both would send, which wastes time and harms nothing
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise OutputError(
                "the same drive is being pushed to the same server by another process. Wait for its end; then the same "
                "command tells the drive's id without sending it again."
            ) from None


def journal_folder() -> Path:
    """Return the folder of journals in the cache of the user."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "interloc" / "push"


def signature(*paths: Path, made_by: str = "") -> str:
    """Describe files by size and time of change, and how something was made from them."""
    facts = [path.stat() for path in paths]
    return " ".join([*(f"{fact.st_size}:{fact.st_mtime_ns}" for fact in facts), made_by]).strip()


def _sweep(folder: Path) -> None:
    """Remove journals that nobody will come back to."""
    for path in folder.glob(f"{'?' * _KEY_DIGITS}.jsonl"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > _KEPT_DAYS * 86400:
                path.unlink()
