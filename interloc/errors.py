"""Everything that can go wrong for a user, in one place.

A message names the file or field, what was found, what was expected, and the usual mistake.
"""

import logging
import re
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

logger = logging.getLogger(__name__)


class InterLocError(Exception):
    """Base of all errors that InterLoc raises on purpose; its text is for the user."""

    exit_code = 1
    http_status = 500


class InputError(InterLocError):
    """Something wrong with what was given."""

    http_status = 422


class ConfigError(InputError):
    """A setting, an option or a combination of them that has no meaning."""

    exit_code = 2


class DriveError(InputError):
    """A drive that cannot be read or trusted: files, labels, poses."""


class GeoreferenceError(InputError):
    """A georeference that is missing where it is needed, or that does not fit the drive."""


class LocationError(InputError):
    """A drive that could not be placed on a map by its roads."""


class MapError(InputError):
    """An OpenStreetMap file or answer that cannot be used."""


class ModelError(InputError):
    """A segmentation network that cannot be read, does not fit its settings, or does not run."""


class NetworkError(InterLocError):
    """A remote service (Overpass) that did not answer as needed."""

    http_status = 502


class OutputError(InterLocError):
    """A result that could not be written or is not where it is looked for."""

    http_status = 507


class IncompleteError(InterLocError):
    """A result that was written without something beside the answer."""


class DamagedResultError(OutputError):
    """A result that was written, and is no longer what it was."""

    http_status = 500


_KINDS = {
    "DetectorConfig": "settings, as interloc.preset('paper') returns",
    "Drive": "a drive, as interloc.open_drive(folder) returns",
    "DriveResult": "a result, as interloc.detect(drive) or interloc.read_results(folder) returns",
    "RoadGraph": "a map, as interloc.read_osm(file) returns",
}
"""What a user gives to the functions of the library, and where to have it from."""


def expect(value: object, kind: type[object]) -> None:
    """Refuse, by a ConfigError, an argument of another kind than expected, one of `_KINDS`."""
    if not isinstance(value, kind):
        raise ConfigError(f"expected {_KINDS[kind.__name__]}; found {type(value).__name__}: {reprlib.repr(value)}")


def install(extra: str) -> str:
    """Return the command that installs an optional part of InterLoc, by the packages that it needs.

    InterLoc itself is in no registry, so an extra cannot be asked for by its name there.
    """
    from importlib.metadata import requires  # noqa: PLC0415 - slow to import

    needs = (line.partition(";") for line in requires("interloc") or ())
    packages = [need.strip() for need, _, only in needs if re.search(rf"extra == ['\"]{extra}['\"]", only)]
    named = " ".join(f'"{package}"' for package in packages)
    return f"pip install {named}" if named else f'pip install ".[{extra}]" in the clone of InterLoc'


def require_lab() -> None:
    """Refuse what needs `interloc.lab`, which an installation may leave out."""
    if find_spec("interloc.lab") is None:
        raise InterLocError(
            "this installation has no interloc.lab, which simulates drives and measures presets on them. "
            "Install the whole of InterLoc for that; everything else works without."
        )


def is_interruption(error: BaseException) -> bool:
    """Tell whether Ctrl-C is behind an error.

    In a compiled loop it comes as "SystemError: CPUDispatcher(...) returned a result with an exception set".
    """
    compiled = isinstance(error, SystemError) and "returned a result with an exception set" in str(error)
    behind = error.__cause__  # where a class was being made
    return compiled or isinstance(error, KeyboardInterrupt) or (behind is not None and is_interruption(behind))


def in_words(error: Exception) -> str:
    """Return what an error says; one that was not raised on purpose is a fault of InterLoc itself."""
    is_known = isinstance(error, InterLocError)
    return str(error) if is_known else f"a fault of InterLoc itself: {type(error).__name__}: {error}"


class Beside:
    """What is beside the answer of a run, and cannot lose it: roads, figures, the score.

    What failed is missing, and said. A file that could not be written (a full disk) is no such failure: it ends the
    work, as does everything where it is strict.
    """

    def __init__(self, *, is_strict: bool = False) -> None:
        self.missing: list[str] = []
        """What is missing, each with the reason."""
        self._is_strict = is_strict

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Make a part of a result; go on without it where that fails."""
        try:
            yield
        except Exception as error:
            is_output = isinstance(error, OutputError) and not isinstance(error, DamagedResultError)
            if self._is_strict or is_output or is_interruption(error) or isinstance(error, MemoryError):
                raise
            logger.info("%s: %s", name, in_words(error), exc_info=not isinstance(error, InterLocError))
            self.missing.append(f"{name}: {in_words(error)}")

    def check(self, out: object) -> None:
        """Raise an IncompleteError where anything is missing of a result that was written to a place."""
        if self.missing:
            raise IncompleteError(f"{out} was written without {'; without '.join(self.missing)}")
