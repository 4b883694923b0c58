"""`interloc live`."""

from __future__ import annotations

import json

from tests.cli.conftest import Interloc


def test_answers_are_printed_as_lines_of_json_as_fast_as_they_come(interloc: Interloc, drive: str) -> None:
    outcome = interloc("live", drive, "--print", "--lookahead", "0", "--speed", "1000")
    lines = [json.loads(line) for line in outcome.out.splitlines()]
    assert [line["type"] for line in lines] == ["scan"] * (len(lines) - 1) + ["end"]
    assert all(line["keyframe"]["frame"] == line["frame"] for line in lines[:-1])
    assert lines[0].keys() == {
        "type", "frame", "is_keyframe", "vehicle", "keyframe", "events", "road", "processing_time_ms", "dropped"
    }  # fmt: skip
    events = [event for line in lines[:-1] for event in line["events"]]
    assert events[0]["kind"] == "new"
    (intersection,) = lines[-1]["intersections"]
    assert intersection["confirmed"]
    assert intersection["branch_count"] == 4


def test_it_is_said_where_answers_go(interloc: Interloc, drive: str) -> None:
    outcome = interloc("live", drive)
    assert (outcome.code, "--print" in outcome.err) == (2, True)
