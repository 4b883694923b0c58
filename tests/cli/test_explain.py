"""`interloc explain`: the pictures of one keyframe."""

from collections.abc import Callable
from pathlib import Path

import cv2


def test_the_steps_of_a_keyframe(
    interloc: Callable, drive: Path, osm: Path, tmp_path: Path, strict_json: Callable
) -> None:
    out = tmp_path / "steps"
    out.mkdir()
    (out / "explain.json").write_text("{}")  # of an earlier call
    outcome = interloc("explain", drive, "--frame", 101, "-o", out, "--osm", osm, "--preset", "paper")
    assert outcome.code == 0
    assert "keyframe 26 of 53 is scan 100" in outcome.err
    assert [Path(line) for line in outcome.out.splitlines()] == [out / "overview.png", out / "explain.json"]
    assert cv2.imread(str(out / "overview.png")).std() > 1  # something is drawn
    record = strict_json(out / "explain.json")
    assert record["keyframe"] == 25
    assert record["ground_truth"]["nodes"]
