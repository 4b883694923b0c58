"""`make demo`, without the installation."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import pytest

from interloc.cli.main import run

MAKEFILE = Path(__file__).resolve().parents[1] / "Makefile"


def test_the_demo_makes_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = MAKEFILE.read_text().split("\ndemo:")[1].split("\n\n")[0].splitlines()[1:]
    commands = [line for line in recipe if line.startswith("\t$(BIN)/interloc ")]
    promised = [name for line in recipe if line.startswith("\t@echo") for name in re.findall(r"demo/\S+\.\w+", line)]
    assert len(commands) == len(promised) == 2
    monkeypatch.chdir(tmp_path)
    for line in commands:
        assert run(shlex.split(line)[1:]) == 0
    for name in promised:
        assert Path(name).is_file()
    report = json.loads(Path("demo/result/report.json").read_text())
    assert report["nodes_found"] == report["nodes_in_zone"] == 5
    assert report["precision"]["5.0"] > 0.9
