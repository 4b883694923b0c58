"""Counting how often files are opened."""

import os
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

_counts: list[Counter[Path]] = []


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if _counts and event == "open" and isinstance(arguments[0], str | bytes | os.PathLike):
        _counts[-1][Path(os.fsdecode(arguments[0]))] += 1


@cache
def _listen() -> None:
    sys.addaudithook(_note)  # an audit hook stays until the process ends


@contextmanager
def counted_opens() -> Iterator[Counter[Path]]:
    """Count how often each file is opened meanwhile, by this process."""
    _listen()
    _counts.append(Counter())
    try:
        yield _counts[-1]
    finally:
        _counts.pop()
