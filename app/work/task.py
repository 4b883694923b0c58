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
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import BaseModel, ConfigDict

from app.work.documents import JobRequest
from interloc.errors import GeoreferenceError, InterLocError

Report = Callable[[int], None]
"""Called with the number of units of the part that are done; raises `Cancelled` when nobody waits for the rest."""

Request_co = TypeVar("Request_co", bound=JobRequest, covariant=True)


class Cancelled(InterLocError):  # noqa: N818 - it is not a fault
    """The job was cancelled while it ran."""


class DriveGoneError(InterLocError):
    """A committed drive whose files were removed from outside."""

    http_status = 410


class WorkSettings(BaseModel):
    """What work must know of `Settings`, from which it is made by names; secrets are not among it."""

    model_config = ConfigDict(frozen=True, from_attributes=True)

    max_file_bytes: int
    max_recording_bytes: int
    max_archive_ratio: float
    max_drive_bytes: int
    max_drive_files: int
    max_demo_scans: int | None
    min_free_bytes: int
    models: Path | None
    overpass_url: str
    source_prefixes: tuple[str, ...] = ()


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
