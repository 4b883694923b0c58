"""Compare all rows of the database with all files of the data folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from app.context import Context

Progress = Callable[[int, int, str], None]
"""Called with the number of drives and jobs that were looked at, how many there are, and the name of the next."""


@dataclass(frozen=True)
class Finding:
    """Something that is not as it should be.

    Attributes
    ----------
    kind : str
        A word for programs, for example "file-missing".
    place : str
        Where it is, as a path in the data folder.
    message : str
        What was found, what was expected, what to do.
    repair : str or None
        What was done about it.
    """

    kind: str
    place: str
    message: str
    repair: str | None = None


def check(
    context: Context, *, repair: bool = False, quick: bool = False, progress: Progress | None = None
) -> list[Finding]:
    """Compare rows and files; a server may go on meanwhile.

    Parameters
    ----------
    context
        Opened by `Context.open`, which refuses a database and a data folder that do not belong together.
    repair
        Also do what is safe: no byte of a drive or of a result is removed.
    quick
        Compare sizes and times only, without reading the files.
    progress
    """
    raise NotImplementedError
