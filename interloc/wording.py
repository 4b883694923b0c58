"""Numbers, and what is wrong with what was read, as a person reads them."""

from __future__ import annotations

import re
from collections.abc import Collection
from itertools import islice
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError  # slow to import, and no command is without this module


def first_fault(error: ValidationError) -> str:
    """Return the first thing that a model refuses, with its place: "features.2.id: Field required"."""
    first = error.errors(include_url=False, include_input=False)[0]
    place = ".".join(str(part)[:40] for part in first["loc"])
    return f"{place and f'{place}: '}{first['msg'].removeprefix('Value error, ')}"


def printable(text: str) -> str:
    """Return a text without control characters, which XML cannot hold and terminals obey."""
    return re.sub(r"[\x00-\x1f\x7f]", "\N{REPLACEMENT CHARACTER}", text)


def counted(count: int, noun: str) -> str:
    """Return a number and what it counts: "1 keyframe", "1,250 keyframes"."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def listed(items: Collection[object], maximum: int = 5) -> str:
    """Name some of many: "3, 4, 5 and 12 more"."""
    head = ", ".join(map(str, islice(items, maximum)))
    rest = len(items) - maximum
    return head if rest <= 0 else f"{head} and {rest:,} more"


def percent(value: float | None) -> str:
    """Return a ratio: "94.2 %", or a dash where it is undefined."""
    return "–" if value is None else f"{100.0 * value:.1f} %"  # noqa: RUF001 - a dash, not a minus


def metres(value: float | None) -> str:
    """Return a distance: "1.28 m", or a dash where it is undefined."""
    return "–" if value is None else f"{value:.2f} m"  # noqa: RUF001
