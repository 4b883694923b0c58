"""What can be wrong with a drive, to be raised (`open_drive`) or listed (`inspect_drive`)."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, get_args

from interloc.errors import DriveError, GeoreferenceError, InterLocError

Severity = Literal["error", "warning", "note"]

_log = logging.getLogger(__name__)


class _FileMessage:
    """A message that belongs to a file of the drive (pickles like any exception: all its arguments are in `args`)."""

    args: tuple[str, str]

    @property
    def path(self) -> str:
        """File or folder, relative to the drive where it lies inside."""
        return self.args[0]

    @property
    def message(self) -> str:
        """What was found, what was expected, the usual mistake."""
        return self.args[1]

    def __str__(self) -> str:
        return f"{self.args[0]}: {self.args[1]}"


class DriveFileError(_FileMessage, DriveError):
    """A `DriveError` that knows its file: ``DriveFileError(path, message)``."""


class GeoreferenceFileError(_FileMessage, GeoreferenceError):
    """A `GeoreferenceError` that knows its file: ``GeoreferenceFileError(path, message)``."""


@dataclass(frozen=True)
class Finding:
    """One thing to say about a drive.

    Attributes
    ----------
    severity : {"error", "warning", "note"}
        An error makes the drive unusable; a warning may make its results poor; a note explains what was assumed.
    path : str
        File or folder, relative to the drive where it lies inside.
    message : str
        What was found, what was expected, the usual mistake.
    """

    severity: Severity
    path: str
    message: str


def by_severity(found: Iterable[Finding]) -> list[Finding]:
    """Sort findings: errors first, then warnings and notes, else in their order."""
    return sorted(found, key=lambda finding: get_args(Severity).index(finding.severity))


@dataclass
class Findings:
    """Collects what the checks find."""

    stop_at_first: bool
    """True: the first error is raised (`open_drive`). False: it is listed, and the checks that do not depend on it go
    on (`inspect_drive`)."""
    found: list[Finding] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """True where nothing makes the drive unusable."""
        return not self.errors

    @property
    def errors(self) -> int:
        """How many there are."""
        return sum(finding.severity == "error" for finding in self.found)

    def error(self, fault: InterLocError) -> None:
        """Raise the fault, or list it."""
        if self.stop_at_first:
            raise fault
        path, message = (fault.path, fault.message) if isinstance(fault, _FileMessage) else ("", str(fault))
        self._add(Finding("error", path, message))

    def refuse(
        self, path: str, message: str, kind: type[DriveFileError | GeoreferenceFileError] = DriveFileError
    ) -> None:
        """Raise, or list, what makes the drive unusable."""
        self.error(kind(path, message))

    def tell(self, finding: Finding) -> None:
        """Take what other findings hold."""
        if finding.severity == "error":
            self.refuse(finding.path, finding.message)
        else:
            (self.warning if finding.severity == "warning" else self.note)(finding.path, finding.message)

    def warning(self, path: str, message: str) -> None:
        """List something that may make the results poor."""
        if self._add(Finding("warning", path, message)) and self.stop_at_first:
            _log.warning("%s: %s", path, message)

    def note(self, path: str, message: str) -> None:
        """List what was assumed."""
        if self._add(Finding("note", path, message)) and self.stop_at_first:
            _log.info("%s: %s", path, message)

    def undecided(self, path: str, message: str) -> None:
        """List what no check could tell. It is not logged: most drives have something of the kind."""
        self._add(Finding("note", path, message))

    @contextmanager
    def stage(self) -> Iterator[None]:
        """Run checks that end at their first error, which is raised or listed."""
        try:
            yield
        except InterLocError as fault:
            if self.stop_at_first:
                raise
            self.error(fault)
        except OSError as error:
            unreadable = DriveFileError(str(error.filename or "drive"), f"cannot be read: {error.strerror or error}.")
            if self.stop_at_first:
                raise unreadable from error
            self.error(unreadable)

    def _add(self, finding: Finding) -> bool:
        if finding in self.found:
            return False
        self.found.append(finding)
        return True
