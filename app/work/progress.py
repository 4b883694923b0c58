"""The progress of an attempt: small files in the scratch folder, written by workers, read by their server.

Files need nothing but the data folder that servers and workers share anyway, and they outlive whoever wrote them.
"""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from app.work.documents import JobRequest
from app.work.task import Cancelled, Part, Report, Task

_INTERVAL_S = 0.25  # between two reports of a part


@dataclass(frozen=True)
class WorkProgress:
    """What the workers of an attempt last reported."""

    done: dict[int, int]
    """Units done of each part that has begun."""
    stage: str | None = None
    message: str | None = None
    """What the work as a whole is doing or waiting for, where it reported that."""


class _Content(TypedDict, total=False):
    done: int
    stage: str | None
    message: str | None


class ProgressFiles:
    """The files of one attempt at a job, below its scratch folder."""

    def __init__(self, scratch: Path, attempt: str) -> None:
        self._folder = scratch / f"attempt-{attempt}"
        self._stop = self._folder / "stop"

    @classmethod
    def of(cls, task: Task[JobRequest]) -> ProgressFiles:
        """Return the files of an attempt that works on a task."""
        return cls(task.scratch, task.attempt)

    def open(self) -> None:
        """Make the folder; without it, all work of the attempt takes itself for cancelled."""
        self._folder.mkdir(parents=True, exist_ok=True)

    def stop(self) -> None:
        """Ask all work of the attempt to end soon."""
        with suppress(OSError):  # disk full: the work then ends when the folder of the attempt is removed
            self._stop.touch()

    def check(self) -> None:
        """Raise `Cancelled` when nobody waits for the work any more."""
        if self._stop.exists() or not self._folder.is_dir():
            raise Cancelled("The job was cancelled.")

    def report_stage(self, stage: str, message: str | None = None) -> None:
        """Report what the work is doing, or waiting for; raises `Cancelled` when nobody waits for it any more."""
        self.check()
        self._write("stage", {"stage": stage, "message": message})

    def forget_stage(self) -> None:
        """Forget the stage that was reported: the work enters its next phase."""
        with suppress(OSError):
            (self._folder / "stage").unlink(missing_ok=True)

    def report_of(self, part: Part) -> Report:
        """Return the function that counts the units of a part."""
        next_at = 0.0

        def report(done: int) -> None:
            nonlocal next_at
            now = time.monotonic()
            if now < next_at and done < part.stop - part.start:
                return
            next_at = now + _INTERVAL_S
            self.check()
            self._write(f"part-{part.number}", {"done": done})

        return report

    def read(self) -> WorkProgress:
        """Return what the workers reported last."""
        done: dict[int, int] = {}
        reported: _Content = {}
        with suppress(FileNotFoundError):
            for entry in os.scandir(self._folder):
                content = _read(Path(entry.path))
                kind, _, number = entry.name.partition("-")
                if kind == "part" and number.isdigit():
                    done[int(number)] = content.get("done", 0)
                elif entry.name == "stage":
                    reported = content
        return WorkProgress(done, reported.get("stage"), reported.get("message"))

    def _write(self, name: str, content: _Content) -> None:
        # Renamed into place, so that no reader sees half; not synced: it is worth nothing after a crash.
        temporary = self._folder / f"{name}.{os.getpid()}.new"
        try:
            temporary.write_text(json.dumps(content))
            temporary.replace(self._folder / name)
        except FileNotFoundError:
            raise Cancelled("The job was cancelled.") from None


def _read(path: Path) -> _Content:
    try:
        content: _Content = json.loads(path.read_bytes())
    except (OSError, ValueError):  # gone meanwhile, or of a worker that is just writing it
        return {}
    return content if isinstance(content, dict) else {}
