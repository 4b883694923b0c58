"""`interloc robustness`: the paper's experiment on label errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


def test_levels_and_seeds(interloc: Callable, drive: Path, osm: Path, tmp_path: Path, strict_json: Callable) -> None:
    out = tmp_path / "out"
    outcome = interloc("robustness", drive, "-o", out, "--osm", osm, "--levels", "0/0, 20/20")
    assert outcome.code == 0
    assert [line.split()[0] for line in outcome.out.splitlines()] == ["r-FPR/r-FNR", "0/0", "20/20", "report"]
    assert {path.name for path in out.iterdir()} == {"robustness.json", "robustness.html", "figures"}
    clean, noisy = strict_json(out / "robustness.json")["levels"]
    assert (clean["level"], noisy["level"]) == ("0/0", "20/20")
    assert clean["paper_ace_m"] == 1.86
    assert clean["precision"] == clean["recall"] == 1.0
    assert clean["ace_m"] <= noisy["ace_m"] < 2.0
    same, other = (
        interloc("robustness", drive, "-o", out, "--osm", osm, "--levels", "20/20", "--seed", seed, "--json").json
        for seed in (0, 1)
    )
    assert same["levels"][0]["ace_m"] == pytest.approx(noisy["ace_m"], abs=1e-6)
    assert other["levels"][0]["ace_m"] != pytest.approx(noisy["ace_m"], abs=1e-6)


@pytest.mark.parametrize("level", ["5-5", "500/5", "5/", "-5/5", "nan/0", ""])
def test_a_level_that_has_no_meaning(level: str, interloc: Callable, drive: Path, osm: Path, tmp_path: Path) -> None:
    outcome = interloc("robustness", drive, "-o", tmp_path / "out", "--osm", osm, "--levels", level)
    assert outcome.code == 2
    assert "Expected r-FPR/r-FNR in percent, such as 5/20." in outcome.complaint
    assert not list(tmp_path.iterdir())


def test_without_georeference_it_refuses(interloc: Callable, local_drive: Path, osm: Path, tmp_path: Path) -> None:
    outcome = interloc("robustness", local_drive, "-o", tmp_path / "out", "--osm", osm)
    assert "the drive has no georeference" in outcome.complaint


def test_a_result_of_detect_is_not_replaced(interloc: Callable, drive: Path, osm: Path, detected: Path) -> None:
    outcome = interloc("robustness", drive, "-o", detected, "--osm", osm, "--levels", "0/0")
    assert outcome.code == 1
    assert (detected / "run.json").exists()


def test_label_errors_cost_little_where_scans_are_sparse(
    interloc: Callable, data: Callable[[str], Path], tmp_path: Path
) -> None:
    arguments = ("-o", tmp_path / "out", "--osm", data("kitti/osm/00.osm.gz"), "--levels", "0/0,20/20", "--json")
    levels = interloc("robustness", data("kitti360_0009"), "--labels", "predictions", *arguments).json["levels"]
    for level in levels:
        assert level["precision"] >= 0.82
        assert level["nodes_found"] == level["nodes_in_zone"] == 5
