"""Naming what went wrong on drives made by hand, and rows in their files."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.errors import OutputError
from interloc.evaluation.evaluate import evaluate
from interloc.lab.measure import Cell, find_failures, read_row, write_row
from interloc.osm.graph import RoadGraph
from tests.evaluation.made import graph, run
from tests.lab.conftest import row


def crossings(*places: tuple[float, float, str]) -> RoadGraph:
    """One node of four arms at each (east, north), of some class of highway."""
    roads = graph([place[:2] for place in places])
    highway = tuple(np.repeat([place[2] for place in places], 4).tolist())
    return replace(roads, ways=replace(roads.ways, highway=highway))


def failures(detections: list[tuple[int, float, float]], *places: tuple[float, float, str]) -> list[dict[str, Any]]:
    """Drive from (0, 0) 100 m east, a keyframe every 10 m; detections are (keyframe, east, north)."""
    result = run([(10.0 * row, 0.0) for row in range(11)], detections)
    return find_failures(evaluate(result, crossings(*places)), lambda frame: [f"show {frame}"])


HERE = (51.0, 0.0, "residential")


def test_false_detections_of_one_place_are_one_failure() -> None:
    detections = [(k, 50.0, 0.0) for k in range(3, 8)] + [(2, 20.0, 30.0), (3, 22.0, 30.0), (4, 24.0, 33.0)]
    (failure,) = failures(detections, HERE)
    assert (failure["what"], failure["kind"], failure["times"]) == ("false", "nothing", 3)
    assert failure["frames"] == [20, 30, 40]
    assert failure["see"] == ["show 30"]
    assert failure["osm_id"] == 100
    assert abs(failure["off_m"] - np.hypot(29, 30)) < 0.1


def test_kinds_of_false_detections() -> None:
    places = (HERE, (0.0, 40.0, "service"), (90.0, -40.0, "footway"))
    detections = [(1, 1.0, 41.0), (4, 50.0, 0.0), (4, 58.0, 0.0), (8, 42.0, -10.0), (9, 91.0, -40.0)]
    found = [failure["kind"] for failure in failures(detections, *places) if failure["what"] == "false"]
    assert sorted(found) == ["left_out", "nothing", "off", "second"]


def test_a_node_that_nothing_was_matched_to() -> None:
    (failure,) = failures([], HERE)
    assert (failure["what"], failure["kind"], failure["times"]) == ("missed", "not_seen", 4)
    assert failure["frames"] == [40, 50, 60, 70]  # within 20 m
    assert failure["off_m"] is None


def test_a_node_found_at_some_keyframes_only() -> None:
    (failure,) = failures([(3, 50.0, 1.0), (4, 50.0, 1.0)], HERE)
    assert (failure["kind"], failure["frames"]) == ("part_of_the_time", [50, 60, 70])


def test_a_node_seen_in_the_wrong_place() -> None:
    (failure,) = (each for each in failures([(k, 51.0, 7.0) for k in range(3, 8)], HERE) if each["what"] == "missed")
    assert (failure["kind"], failure["times"], failure["off_m"]) == ("too_few", 1, 7.0)


def test_nothing_went_wrong() -> None:
    assert failures([(k, 50.0, 0.0) for k in range(3, 8)], HERE) == []


def test_a_row_comes_back_as_it_was_unless_something_is_new(tmp_path: Path) -> None:
    made = row(errors_m=[0.1234, 5.0])
    assert read_row(made.cell, "f", tmp_path) is None
    write_row(made, tmp_path)
    assert read_row(made.cell, "f", tmp_path) == made
    assert read_row(made.cell, "another", tmp_path) is None
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:50])
    assert read_row(made.cell, "f", tmp_path) is None


def test_a_row_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    cell = row().cell
    (tmp_path / f"{cell.file_name}.json").mkdir()
    with pytest.raises(OutputError, match=r"00_default_0-0_seed0\.json could not be read"):
        read_row(cell, "f", tmp_path)


def test_file_names_hold_no_paths() -> None:
    cell = Cell(drive="../monday/00", preset="default bev.resolution_m=0.25", noise="20/20", seed=3)
    assert cell.file_name == "..-monday-00_default-bev.resolution_m-0.25_20-20_seed3"
