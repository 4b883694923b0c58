"""Scan numbers as runs: ``[[0, 3], [7, 1]]`` is 0, 1, 2, 7."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from interloc.arrays import IntArray

Run = tuple[int, int]
"""First number and count."""


def to_runs(numbers: IntArray) -> list[Run]:
    """Write (N,) ascending numbers as runs."""
    if not len(numbers):
        return []
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 2) != 1)
    counts = np.diff(starts, append=len(numbers))
    return [(int(numbers[start]), int(count)) for start, count in zip(starts, counts, strict=True)]


def from_runs(runs: Sequence[Run]) -> IntArray:
    """Return the (N,) numbers of runs."""
    first, count = np.array(runs, dtype=np.int64).reshape(-1, 2).T
    begin = np.cumsum(count) - count
    numbers: IntArray = np.repeat(first - begin, count) + np.arange(count.sum(), dtype=np.int64)
    return numbers
