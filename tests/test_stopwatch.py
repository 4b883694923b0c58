"""Time a stage."""

from __future__ import annotations

import pytest

from interloc import stopwatch
from interloc.stopwatch import Stopwatch


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time of day, set by hand."""
    now = [100.0]
    monkeypatch.setattr(stopwatch.time, "perf_counter", lambda: now[0])
    return now


def test_time_between_laps_adds_up_by_stage(clock: list[float]) -> None:
    watch = Stopwatch()
    for seconds, stage in ((1.0, "read"), (4.0, "bev"), (0.5, "read")):
        clock[0] += seconds
        watch.lap(stage)
    assert watch.seconds == {"read": 1.5, "bev": 4.0}


def test_time_before_a_start_is_forgotten(clock: list[float]) -> None:
    watch = Stopwatch()
    clock[0] += 60.0
    watch.start()
    clock[0] += 2.0
    watch.lap("read")
    assert watch.seconds == {"read": 2.0}


def test_times_of_another_are_added() -> None:
    watch = Stopwatch()
    watch.add({"read": 1.0})
    watch.add({"read": 2.0, "bev": 3.0})
    assert watch.seconds == {"read": 3.0, "bev": 3.0}
