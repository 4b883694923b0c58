"""The kinds of work, and the three calls by which a worker process does a task, whatever its kind."""

import socket
from dataclasses import dataclass
from importlib import import_module
from types import ModuleType

from app.states import JobKind
from app.work.requests import CommitJob, IntersectionsJob, JobRequest, Outcome, UnpackJob
from app.work.task import Part, Plan, ProgressFiles, Task
from interloc.config import PRESETS
from interloc.errors import InterLocError


@dataclass(frozen=True)
class Kind:
    """A kind of work."""

    module: str
    """It has the functions `prepare`, `run` and `finish` (see `app.work.task`)."""
    request: type[JobRequest]
    stages: tuple[str, str, str]
    """What the work is doing in each of the three calls, for the client."""
    urgent: bool = True
    """Somebody waits for it: it goes first, and never behind long work."""
    changes_drive: bool = True
    """It works on a drive that is not ready yet, and its end is written into the drive (`app.drives.commit`)."""

    def load(self) -> ModuleType:
        """Import the module; workers do that, the server need not."""
        return import_module(self.module)


KINDS: dict[str, Kind] = {
    JobKind.INTERSECTIONS: Kind(
        "app.jobs.work.intersections",
        IntersectionsJob,
        ("preparing", "detecting", "mapping"),
        urgent=False,
        changes_drive=False,
    ),
    JobKind.COMMIT: Kind("app.drives.work.commit", CommitJob, ("checking", "reducing", "storing")),
    JobKind.UNPACK: Kind("app.drives.work.unpack", UnpackJob, ("checking", "unpacking", "storing")),
    JobKind.DEMO: Kind("app.demo.work", JobRequest, ("preparing", "simulating", "storing")),
}

WARM = "app.work.warm"
"""What workers import ahead of their first work."""

URGENT = tuple(name for name, kind in KINDS.items() if kind.urgent)
DRIVE_CHANGING = tuple(name for name, kind in KINDS.items() if kind.changes_drive)


def compile_kernels() -> None:
    """Compile the kernels of the method where this machine has none yet, so that no job waits for that."""
    from interloc.detection.warm import are_cold, warm_up  # noqa: PLC0415 - the method, which the server does without
    from interloc.kernels.streets import compile_for_streets  # noqa: PLC0415

    if are_cold():
        for config in PRESETS.values():
            warm_up(config)
        compile_for_streets()


def prepare(task: Task[JobRequest]) -> Plan:
    """Look at the input of a task, and cut it into parts."""
    _check(task)
    plan: Plan = KINDS[task.kind].load().prepare(task)
    return plan


def run(task: Task[JobRequest], part: Part) -> None:
    """Do one part of a task."""
    _check(task)
    KINDS[task.kind].load().run(task, part, ProgressFiles.of(task).report_of(part))


def finish(task: Task[JobRequest], plan: Plan) -> Outcome:
    """Join the parts of a task into its result."""
    _check(task)
    outcome: Outcome = KINDS[task.kind].load().finish(task, plan)
    return outcome


def _check(task: Task[JobRequest]) -> None:
    if not task.scratch.is_dir():
        raise InterLocError(
            f"The worker on {socket.gethostname()} does not see {task.scratch}. "
            "Workers of a cluster need the data folder of the service at the same place."
        )
    ProgressFiles.of(task).check()
