"""A job as worker processes see it: a task that is cut into parts and works on files in the data folder.

Every kind of job is a module of this package with three functions that run in worker processes, on this machine or on
a cluster, and know neither the database nor the web:

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

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from interloc.errors import GeoreferenceError, InterLocError

Report = Callable[[int], None]
"""Called with the number of units of the part that are done; raises `Cancelled` when nobody waits for the rest."""


class Cancelled(InterLocError):  # noqa: N818 - it is not a fault
    """The job was cancelled while it ran."""


class DriveGoneError(InterLocError):
    """A committed drive whose files were removed from outside."""

    http_status = 410


@dataclass(frozen=True)
class Task:
    """What is to be done.

    Attributes
    ----------
    kind, job_id : str
    drive_name : str
    request : dict
        The request as the client sent it, checked.
    drive : Path
        Folder of the drive: ``files/`` as uploaded, ``reduced/`` once it is committed.
    scratch : Path
        Folder of this job for checkpoints and progress; it outlives a restart and goes when the job ends.
    result : Path
        Folder of the result of this attempt; the runner moves it to its place when the job was successful.
    limits : dict
        Settings of the service by name: limits that the work must keep to, how many workers there are, ...
    attempt : str
        Name of this attempt, so that two servers that take each other for dead do not stop each other's work.
    """

    kind: str
    job_id: str
    drive_name: str
    request: dict[str, Any]
    drive: Path
    scratch: Path
    result: Path
    limits: dict[str, Any] = field(default_factory=dict)
    attempt: str = ""


@dataclass(frozen=True)
class Part:
    """A part of a task: the units ``start..stop`` of it."""

    number: int
    start: int
    stop: int


@dataclass(frozen=True)
class Plan:
    """How a task is cut.

    Attributes
    ----------
    parts
    total : int
        Number of units of all parts: keyframes, scans, files.
    notes : dict
        What `prepare` passes on to `finish`.
    """

    parts: list[Part]
    total: int
    notes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task.

    Attributes
    ----------
    summary : dict
        Figures for the client.
    report : dict or None
        What a check found (`DriveReport.to_dict`).
    """

    summary: dict[str, Any]
    report: dict[str, Any] | None = None


def no_georeference(drive_name: str) -> GeoreferenceError:
    """Return the error of a job that is to be scored against a map, of a drive without georeference."""
    return GeoreferenceError(
        f"{drive_name}: the drive has no georeference, so its detections cannot be compared with "
        'OpenStreetMap. Let the job place it by the roads of the map ("georeference": "map"), upload oxts/data or '
        "geo.csv with the drive (or name one by its option oxts), or start a job without a map, which needs none."
    )
