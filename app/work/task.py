"""A job as worker processes see it: a task that is cut into parts and works on files in the data folder.

The work of every kind of job is a module with three functions that run in worker processes, on this machine or on a
cluster, and know neither the database nor the web:

``prepare(task) -> Plan``
    Look at the input, cut the work into parts.
``run(task, part, report) -> None``
    Do one part and leave its outcome in the scratch folder, written whole or not at all. A part whose outcome exists
    already (after a restart) is not done again.
``finish(task, plan) -> Outcome``
    Join the parts into the result.

They raise `InterLocError` if the input is at fault: the job fails with that message and is not tried again.
Their progress lies in small files in the scratch folder, written by workers and read by their server: that needs
nothing but the data folder that servers and workers share anyway, and outlives whoever wrote it.
"""

import json
import os
import shutil
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Generic, TypedDict, TypeVar

from pydantic import BaseModel

from app.work.requests import JobRequest
from interloc.errors import GeoreferenceError, InterLocError
from interloc.output.layout import file_names

_INTERVAL_S = 0.25  # between two reports of a part

Report = Callable[[int], None]
"""Called with the number of units of the part that are done; raises `Cancelled` when nobody waits for the rest."""

Request_co = TypeVar("Request_co", bound=JobRequest, covariant=True)


class Cancelled(InterLocError):  # noqa: N818 - it is not a fault
    """The job was cancelled while it ran."""


class DriveGoneError(InterLocError):
    """A committed drive whose files were removed from outside."""

    http_status = 410


class WorkSettings(BaseModel, frozen=True, from_attributes=True):
    """What work must know of `Settings`, from which it is made by names; secrets are not among it."""

    max_file_bytes: int
    max_recording_bytes: int
    max_archive_ratio: float
    max_drive_bytes: int
    max_drive_files: int
    max_demo_scans: int | None
    min_free_bytes: int
    models: Path | None
    overpass_url: str
    sources: tuple[str, ...] = ()


@dataclass(frozen=True)
class Task(Generic[Request_co]):
    """What is to be done."""

    kind: str
    job_id: str
    drive_name: str
    request: Request_co
    """That of its kind."""
    drive: Path
    """Folder of the drive: ``files/`` as uploaded, ``reduced/`` once it is committed."""
    scratch: Path
    """Folder of this job for checkpoints and progress; it outlives a restart and goes when the job ends."""
    result: Path
    """Folder of the result of this attempt; the runner moves it to its place when the job was successful."""
    cache: Path
    """Folder of the service for what is fetched or measured once, for all jobs."""
    settings: WorkSettings
    workers: int
    """Number of parts that are done at the same time."""
    attempt: str
    """Name of this attempt, so that two servers that take each other for dead do not stop each other's work."""


@dataclass(frozen=True)
class Part:
    """A part of a task: the units ``start..stop`` of it."""

    number: int
    start: int
    stop: int


@dataclass(frozen=True)
class Plan:
    """How a task is cut; a kind of work that passes more on from `prepare` to `finish` has a plan of its own."""

    parts: list[Part]
    total: int
    """Number of units of all parts: keyframes, scans, files."""
    began: float = field(default_factory=time.time, kw_only=True)
    """When it was made, seconds since 1970."""
    stage: str | None = field(default=None, kw_only=True)
    """What is done in the parts, where that is not what the kind of work says."""


def no_georeference(drive_name: str) -> GeoreferenceError:
    """Return the error of a job that is to be scored against a map, of a drive without georeference."""
    return GeoreferenceError(
        f"{drive_name}: the drive has no georeference, so its detections cannot be compared with "
        'OpenStreetMap. Let the job place it by the roads of the map ("georeference": "map"), upload oxts/data or '
        "geo.csv with the drive (or name one by its option oxts), or start a job without a map, which needs none."
    )


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
    def of(cls, task: Task[JobRequest]) -> "ProgressFiles":
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


# Names of the files through which a worker hands its result to the server.

REDUCED = "reduced"
"""Folder of the reduced drive in the result of a commit, and in the folder of a drive."""

TRAJECTORY = tuple(file_names(georeferenced=known)["trajectory"] for known in (True, False))
"""Names of the trajectory beside it, with and without georeference."""

UNPACKED = "unpacked"
"""Folder of unpacked files in the scratch folder."""

LISTING = "unpacked.json"
"""File beside it that lists their paths, sizes and SHA-256."""


def link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no links."""
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:
        shutil.copyfile(source, target)


@dataclass(frozen=True)
class UnpackedFile:
    """A file below `UNPACKED`, as `LISTING` names it."""

    path: str
    size_bytes: int
    sha256: str


def read_listing(scratch: Path) -> list[UnpackedFile]:
    """Return the files that `place_unpacked` has placed."""
    return [UnpackedFile(**file) for file in json.loads((scratch / LISTING).read_text())]


def place_unpacked(files: Path, listing: Iterable[UnpackedFile], scratch: Path) -> None:
    """Move files and their list to where the server expects them; the list comes last and marks them as complete.

    Files without a list are those of an attempt that was killed in between.
    """
    listed = files.with_name("listing")
    listed.write_text(json.dumps([asdict(file) for file in listing]))
    os.sync()
    shutil.rmtree(scratch / UNPACKED, ignore_errors=True)
    files.rename(scratch / UNPACKED)
    listed.rename(scratch / LISTING)
