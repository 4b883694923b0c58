"""The kinds of work: which module does each, and what its stages are called."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from types import ModuleType


@dataclass(frozen=True)
class Kind:
    """A kind of work.

    Attributes
    ----------
    module : str
        It has the functions `prepare`, `run` and `finish` (see `app.work.task`).
    stages : tuple of str
        What the work is doing meanwhile, for the client.
    urgent : bool
        Somebody waits for it: it goes first, and never behind long work.
    changes_drive : bool
        It works on a drive that is not ready yet, and its end is written into the drive (`app.drives.finish`).
    """

    module: str
    stages: tuple[str, str, str]
    urgent: bool = True
    changes_drive: bool = True

    def load(self) -> ModuleType:
        """Import the module; workers do that, the server need not."""
        return import_module(self.module)


KINDS: dict[str, Kind] = {
    "intersections": Kind(
        "app.work.intersections", ("preparing", "detecting", "mapping"), urgent=False, changes_drive=False
    ),
    "commit": Kind("app.work.commit", ("checking", "reducing", "storing")),
    "unpack": Kind("app.work.unpack", ("checking", "unpacking", "storing")),
    "demo": Kind("app.work.demo", ("preparing", "simulating", "storing")),
}

URGENT = tuple(name for name, kind in KINDS.items() if kind.urgent)
DRIVE_CHANGING = tuple(name for name, kind in KINDS.items() if kind.changes_drive)
