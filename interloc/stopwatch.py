"""Time spent per stage."""

import time
from collections.abc import Mapping


class Stopwatch:
    """Adds up the time between laps under the names of the stages: `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def start(self) -> None:
        """Forget the time since the last lap."""
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Count the time since the last lap, or start, to a stage."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now

    def add(self, seconds: Mapping[str, float]) -> None:
        """Add the times of another stopwatch."""
        for stage, time_s in seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time_s
