"""Time spent per stage."""

from __future__ import annotations

import time

from interloc.stopwatch import Stopwatch


def test_the_time_between_laps_adds_up_by_stage() -> None:
    began = time.perf_counter()
    watch = Stopwatch()
    for stage, seconds in (("read", 0.02), ("bev", 0.01), ("read", 0.03)):
        time.sleep(seconds)
        watch.lap(stage)
    assert watch.seconds["read"] >= 0.05
    assert watch.seconds["bev"] >= 0.01
    assert sum(watch.seconds.values()) <= time.perf_counter() - began


def test_the_time_before_a_start_does_not_count() -> None:
    watch = Stopwatch()
    time.sleep(0.05)
    began = time.perf_counter()
    watch.start()
    watch.lap("read")
    assert watch.seconds["read"] <= time.perf_counter() - began


def test_times_of_another_are_added() -> None:
    watch = Stopwatch()
    watch.add({"read": 1.0})
    watch.add({"read": 2.0, "bev": 3.0})
    assert watch.seconds == {"read": 3.0, "bev": 3.0}
