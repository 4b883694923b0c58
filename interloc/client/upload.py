"""Sending of many files over several connections; what the server has already is left out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from urllib.parse import quote

from interloc.client.answers import FileAnswer, FilesAnswer, Refusal
from interloc.client.connection import Connection
from interloc.client.journal import Journal, Sent
from interloc.client.parcels import Load, Parcel
from interloc.errors import NetworkError

_PAGE = 10_000
_TOLD_EVERY_S = 0.1


@dataclass
class Tally:
    """How far an upload is.

    Attributes
    ----------
    total : int
        Files in all.
    done : int
        Files that the server has.
    sent, bytes_sent : int
        Files that were sent by this upload, not before, and their size.
    began_s : float
        By the monotonic clock.
    """

    total: int
    done: int = 0
    sent: int = 0
    bytes_sent: int = 0
    began_s: float = field(default_factory=time.monotonic)

    @property
    def bytes_per_s(self) -> float:
        """Since the upload began."""
        return self.bytes_sent / max(time.monotonic() - self.began_s, 1e-3)


OnProgress = Callable[[Tally], None]
"""Called in the thread that called `upload`; may raise to give up."""


def files_of(connection: Connection, drive_id: str) -> dict[str, FileAnswer]:
    """List what the server has of a drive, by path."""
    found: dict[str, FileAnswer] = {}
    after: str | None = None
    while True:
        params: dict[str, str | int] = {"limit": _PAGE} if after is None else {"limit": _PAGE, "after": after}
        page = connection.ask("GET", f"/drives/{drive_id}/files", FilesAnswer, params=params)
        found |= {file.path: file for file in page.files}
        if page.next is None or not page.files:
            return found
        after = page.next


def upload(
    connection: Connection,
    drive_id: str,
    parcels: Sequence[Parcel],
    journal: Journal,
    *,
    threads: int,
    on_progress: OnProgress | None = None,
) -> Tally:
    """Send what is missing on the server or differs there.

    Memory is bounded: each thread holds one file.

    Raises
    ------
    DriveError
        A file of the drive cannot be read.
    NetworkError
        The server refuses, or cannot be reached. What it took before stays there.
    """
    there = files_of(connection, drive_id)
    work = _Work(connection, drive_id, there, journal, iter(parcels))
    work.tally.total = len(parcels)
    workers = [threading.Thread(target=work.run, daemon=True) for _ in range(min(threads, len(parcels)) or 1)]
    for worker in workers:
        worker.start()
    try:
        while any(worker.is_alive() for worker in workers):
            work.changed.wait(_TOLD_EVERY_S)
            if on_progress is not None:
                on_progress(work.tally)
            if work.changed.is_set():
                work.changed.clear()
                time.sleep(_TOLD_EVERY_S / 2)  # told often enough, not once a file
    except BaseException:
        work.stop()
        raise
    if work.fault is not None:
        raise work.fault
    return work.tally


@dataclass
class _Work:
    """What the threads share."""

    connection: Connection
    drive_id: str
    there: Mapping[str, FileAnswer]
    journal: Journal
    parcels: Iterator[Parcel]
    tally: Tally = field(default_factory=lambda: Tally(0))
    fault: BaseException | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    changed: threading.Event = field(default_factory=threading.Event)
    stopped: bool = False

    def stop(self) -> None:
        self.stopped = True
        self.connection.closing.set()

    def run(self) -> None:
        try:
            while (parcel := self._next()) is not None:
                size, is_sent = self._deliver(parcel)
                with self.lock:
                    tally = self.tally
                    tally.done += 1
                    if is_sent:
                        tally.sent += 1
                        tally.bytes_sent += size
                self.changed.set()
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits for us
            with self.lock:
                if self.fault is None:
                    self.fault = error
            self.stopped = True
            self.changed.set()

    def _next(self) -> Parcel | None:
        with self.lock:
            return None if self.stopped else next(self.parcels, None)

    def _deliver(self, parcel: Parcel) -> tuple[int, bool]:
        """See to it that the server has a file; return its size, and whether it had to be sent."""
        there, known, signature = self.there.get(parcel.path), self.journal.sent(parcel.path), parcel.signature
        if there is not None and known == Sent(signature, there.sha256):
            return there.size_bytes, False
        load = parcel.load()
        is_there = there is not None and there.sha256 == load.sha256
        if not is_there:
            self._put(parcel.path, load)
        self.journal.add(parcel.path, Sent(signature, load.sha256))
        return load.size, not is_there

    def _put(self, path: str, load: Load) -> None:
        address = file_address(self.drive_id, path)
        try:
            answer = self.connection.ask("PUT", address, FileAnswer, body=load.body, headers=load.headers)
        except Refusal as error:
            raise Refusal(error.status, error.problem, f"(while sending {path}, {load.size:,} bytes)") from error
        if answer.sha256 != load.sha256:
            raise NetworkError(
                f"{self.connection.server} took {path}, but with other contents than were sent (SHA-256 "
                f"{answer.sha256[:12]}... instead of {load.sha256[:12]}...). Usual cause: a proxy that changes bodies."
            )


def file_address(drive_id: str, path: str) -> str:
    """Return the address of a file of a drive."""
    return f"/drives/{drive_id}/files/{quote(path)}"
