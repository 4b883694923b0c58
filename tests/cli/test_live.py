"""`interloc live` and `interloc ros`; the node itself: tests/ros."""

import ast
import json
from pathlib import Path
from typing import Any, cast

import pytest

from interloc.cli import live
from interloc.client import live as client
from interloc.config import preset
from interloc.drives.folder import FolderDrive
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


def test_dropped_scans_are_told_once_a_second(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Sender:
        def __init__(self, _server: str, _token: str | None, begin: dict[str, Any], hear: Any, **_: Any) -> None:
            self.begin, self.hear = begin, hear

        def run(self, _scans: object) -> None:
            for number in range(1, 500):
                self.hear({"type": "dropped", "frame": number, "dropped": number})
            self.hear({"type": "end", "keyframes": 1, "dropped": 499, "intersections": []})

    monkeypatch.setattr(client, "LiveSender", Sender)
    live._send_scans(cast("FolderDrive", None), preset("default"), 1.0, "http://x", None, {}, prints=False)
    first, *more, last = capsys.readouterr().out.splitlines()
    assert first == "dropped    1 scan so far: the service is too slow, or the drive is played too fast (--speed)."
    assert len(more) < 3
    assert last == "end        1 keyframes, 0 intersections, 499 of 500 scans dropped"


def test_the_files_for_ros_are_told(interloc: Interloc) -> None:
    folder = Path(interloc("ros", "--files").out.strip())
    ast.parse((folder / "interloc.launch.py").read_text())
    assert "/interloc/markers" in (folder / "interloc.rviz").read_text()
