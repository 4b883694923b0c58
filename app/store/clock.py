"""The clock of the database jumps when somebody sets it; this notices, so that nobody is taken for dead or expired."""

from __future__ import annotations

import time
from collections.abc import Callable


class ClockWatch:
    """Compares the clock of the database with one that never jumps; between looks they may part by a tolerance."""

    def __init__(self, tolerance_s: float, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._tolerance_s = tolerance_s
        self._monotonic = monotonic
        self._last: tuple[float, float] | None = None
        self._since = float("inf")
        self.has_jumped = False

    def look(self, now: float) -> float:
        """Take note of the time by the database; return the seconds since it jumped last, or since the first look.

        What happened before that is not known.
        """
        moment = self._monotonic()
        if self._last is None:
            self._since = moment
        elif abs((now - self._last[0]) - (moment - self._last[1])) > self._tolerance_s:
            self._since = moment
            self.has_jumped = True
        self._last = now, moment
        return moment - self._since
