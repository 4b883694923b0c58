"""Errors of the road labels: levels, the table beside the paper's, the files."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from interloc.errors import ConfigError, OutputError
from interloc.evaluation.evaluate import Evaluation, evaluate
from interloc.evaluation.label_errors import label_error_table, parse_level, write_label_errors
from interloc.evaluation.published import LABEL_ERRORS
from interloc.osm.graph import RoadGraph
from interloc.results import DriveResult

Levels = list[tuple[str, Evaluation]]


@pytest.fixture(scope="module")
def levels(run: Callable[..., DriveResult], graph: Callable[..., RoadGraph]) -> Levels:
    """Detections that lie further off the more the labels err, and none at all in the end."""
    roads = graph([(0, 0)])
    detections = [[(0, 1.0 + 2.01 * i, 0)] for i in range(4)] + [[]]
    return [(level, evaluate(run([(0, 0)], made), roads)) for level, made in zip(LABEL_ERRORS, detections, strict=True)]


def test_rows_stand_beside_those_of_the_paper(levels: Levels) -> None:
    rows = label_error_table(levels)
    assert [(row.r_fpr, row.r_fnr) for row in rows] == [(0, 0), (0.05, 0.05), (0.05, 0.2), (0.2, 0.05), (0.2, 0.2)]
    assert [row.precision for row in rows] == [1.0, 1.0, 0.0, 0.0, None]
    assert [row.recall for row in rows] == [1.0, 1.0, None, None, 0.0]
    assert rows[3].ace_m == pytest.approx(7.03, abs=1e-2)
    assert (rows[4].ace_m, rows[4].nodes_found, rows[4].nodes_in_zone) == (None, 0, 1)
    last = rows[4]
    assert (last.paper_ace_m, last.paper_precision, last.paper_recall) == (3.23, 0.7883, 0.6800)


def test_a_level_of_our_own_has_no_row_in_the_paper(levels: Levels) -> None:
    (row,) = label_error_table([(" 7.5 / 0 ", levels[0][1])])
    assert (row.level, row.r_fpr, row.r_fnr, row.paper_ace_m) == ("7.5/0", 0.075, 0.0, None)


@pytest.mark.parametrize("level", ["", "5", "5/", "a/b", "5/101", "-1/5", "5/5/5"])
def test_a_level_that_makes_no_sense_is_refused(level: str) -> None:
    with pytest.raises(ConfigError, match="such as 5/20"):
        parse_level(level)


def test_table_and_figure_are_written(levels: Levels, tmp_path: Path) -> None:
    write_label_errors(levels, tmp_path)
    names = ["figures/robustness.png", "figures/robustness.svg", "robustness.html", "robustness.json"]
    assert sorted(str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()) == names
    record = json.loads((tmp_path / "robustness.json").read_text(encoding="utf-8"))
    assert [row["level"] for row in record["levels"]] == list(LABEL_ERRORS)
    assert record["levels"][0]["error_percentiles_m"]["50"] == pytest.approx(1.0, abs=1e-2)
    assert record["levels"][4]["error_percentiles_m"]["50"] is None
    assert record["levels"][1]["f1_by_threshold"]["5.0"] == 1.0
    page = (tmp_path / "robustness.html").read_text(encoding="utf-8")
    assert "80.7 %" in page
    assert "<script" not in page


def test_without_levels_or_folder_it_says_so(levels: Levels, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="at least one"):
        write_label_errors([], tmp_path)
    with pytest.raises(OutputError, match="no such folder"):
        write_label_errors(levels, tmp_path / "none")
