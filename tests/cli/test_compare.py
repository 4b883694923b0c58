"""`interloc compare`."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.config import PAPER


def with_run(finished: Path, out: Path, **changed: object) -> Path:
    """Copy a result folder as if the run had been another one."""
    shutil.copytree(finished, out)
    run = json.loads((out / "run.json").read_text()) | changed
    (out / "run.json").write_text(json.dumps(run))
    return out


@pytest.fixture(scope="module")
def outs(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Result folders of two presets. Shared: do not change them."""
    place = tmp_path_factory.mktemp("outs") / "paper"
    return finished, with_run(finished, place, config=PAPER.model_dump(mode="json"))


def test_figures_and_settings_side_by_side(outs: tuple[Path, Path], interloc: Callable) -> None:
    told = interloc("compare", *outs, "--json").json
    assert told["runs"] == [str(out) for out in outs]
    assert {"name": "preset", "values": ["default", "paper"]} in told["settings"]
    text = interloc("compare", *outs).out
    (line,) = [line.split() for line in text.splitlines() if line.startswith("OSM nodes found")]
    (figure,) = [row["values"] for row in told["figures"] if row["name"] == "map_nodes_found"]
    assert line[3:] == [str(value) for value in figure]
    assert told["found_by_all"] == 1
    assert "1 OSM node found by all, 0 OSM nodes missed by all" in text


def test_inputs_that_differ_are_named(outs: tuple[Path, Path], tmp_path: Path, interloc: Callable) -> None:
    third = with_run(outs[0], tmp_path / "a $b$ 高速", labels="predictions")
    lines = interloc("compare", outs[0], third).out.splitlines()
    assert [line.split()[0] for line in lines if line.endswith(" predictions")] == ["labels"]
    assert "the same settings" in lines


def test_what_cannot_be_compared(outs: tuple[Path, Path], detected: Path, tmp_path: Path, interloc: Callable) -> None:
    assert "two runs or more" in interloc("compare", outs[0]).complaint
    assert "is not an InterLoc result: it has no run.json" in interloc("compare", outs[0], tmp_path).complaint
    outcome = interloc("compare", outs[0], detected)
    assert outcome.code == 2
    assert "interloc evaluate" in outcome.complaint
