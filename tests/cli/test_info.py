"""`interloc info`: what is in a drive, and what is wrong with it; the settings of a preset."""

from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.config import DEFAULT, PAPER, flatten, parse_config


def test_a_sound_drive_at_a_glance(interloc: Callable, drive: Path) -> None:
    outcome = interloc("info", drive)
    assert outcome.code == 0
    assert not outcome.err
    facts = dict(line.split(maxsplit=1) for line in outcome.out.splitlines() if not line.startswith("This"))
    assert facts["layout"] == "semantickitti"
    assert facts["scans"].startswith("210 (frames 0 to 209), about 6,0")
    assert facts["poses"].startswith("210, camera frame: it moves along its z axis")
    assert facts["distance"] == "125 m, 0.6 m between scans, 21 s"
    assert facts["labels"] == "labels, scheme semantickitti, 25 % road"
    assert facts["georeference"].startswith("geo.csv")
    assert outcome.out.endswith("This drive can be used.\n")


def test_json_is_one_object(interloc: Callable, drive: Path) -> None:
    outcome = interloc("info", drive, "--json", "--thorough")
    assert outcome.code == 0
    assert not outcome.err
    facts = outcome.json
    assert facts["ok"] is True
    assert (facts["scans"], facts["poses"], facts["pose_frame"]) == (210, 210, "camera")
    assert facts["looked_into"] == 210
    assert {problem["severity"] for problem in facts["problems"]} == {"note"}  # ground only tells no scale


def test_a_drive_that_cannot_be_used(interloc: Callable, short_drive: Path) -> None:
    damaged = short_drive / "velodyne" / "000004.bin"
    damaged.write_bytes(damaged.read_bytes()[:-7])
    (short_drive / "labels" / "000009.label").write_bytes(b"1234")
    outcome = interloc("info", short_drive)
    assert outcome.code == 1
    errors = [line for line in outcome.out.splitlines() if line.startswith("ERROR: ")]
    assert [error.split(": ")[1] for error in errors] == ["velodyne/000004.bin", "labels/000009.label"]
    assert outcome.out.endswith("This drive cannot be used as it is.\n")
    assert not outcome.err


def test_a_drive_that_is_not_there(interloc: Callable, tmp_path: Path) -> None:
    outcome = interloc("info", tmp_path / "none")
    assert outcome.code == 1
    assert "does not exist. Expected the folder of one drive." in outcome.out
    assert "georeference" not in outcome.out  # which nobody could look for


@pytest.mark.parametrize(("arguments", "preset"), [([], DEFAULT), (["--preset", "paper"], PAPER)])
def test_the_output_is_the_preset(arguments: list[str], preset: object, interloc: Callable) -> None:
    outcome = interloc("info", "--settings", "--json", *arguments)
    assert outcome.code == 0
    assert parse_config(outcome.json) == preset


def test_every_setting_is_explained(interloc: Callable) -> None:
    said = interloc("info", "--settings", "--set", "branches.inner_widths=null").out
    assert "branches.inner_widths = null" in said
    names = {line.partition(" = ")[0] for line in said.splitlines() if not line.startswith(" ")}
    assert names >= {name for name, _ in flatten(DEFAULT.model_dump()) if name.count(".") == 1}
