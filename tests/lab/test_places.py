"""Drawn places whose axes are known, and what is measured of them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from interloc.cli.main import run
from interloc.lab.ground import Surface
from interloc.lab.junction_shapes import KINDS, walk
from interloc.lab.places import CONDITIONS, Place, PlaceDrive, loss_m, see, table_of_kinds


@pytest.mark.parametrize("kind", KINDS)
def test_axes_lead_to_the_nodes_over_road(kind: str) -> None:
    place = Place(kind, 4)
    ways = list(place.ways())
    assert len({name for name, _ in ways}) == len(ways) >= 2
    picture, low = place.picture
    for _, way in ways:
        gaps = np.hypot(*np.diff(way, axis=0).T)
        assert gaps.max() <= 0.6
        cells = ((way - low) / 0.1).astype(int)
        on_road = np.isin(picture[cells[:, 1], cells[:, 0]], [Surface.ROAD, Surface.CAR])
        assert on_road.mean() > 0.97 or "roundabout" in kind
    assert len(place.nodes) >= 1
    if "roundabout" not in kind:
        nearest = [min(np.hypot(*(way - node).T).min() for _, way in ways) for node in place.nodes]
        assert max(nearest) < 0.6


def test_the_same_number_is_the_same_place_and_numbers_take_turns_in_conditions() -> None:
    one, same, other = Place("X", 2), Place("X", 2), Place("X", 3)
    assert (one.picture[0] == same.picture[0]).all()
    assert not np.allclose(one.nodes, other.nodes)
    assert [Place("X", n).conditions for n in range(0, 12, 2)] == [Place("X", n).conditions for n in range(1, 12, 2)]
    assert [Place("X", n).conditions for n in range(0, 12, 2)] == list(CONDITIONS)


def test_scans_show_road_on_both_sides_of_the_way_and_other_ground_beyond() -> None:
    place = Place("T", 0)
    name, way = next(place.ways())
    drive = PlaceDrive(name, place, way, seed=1)
    ground = drive.ground_points(len(drive.frames) // 2)
    assert ground.road_count > 1000 < len(ground.confusable)
    assert np.hypot(*ground.road[:, :2].T).min() < 4.0
    place.conditions = replace(place.conditions, wrong=0.5)
    assert drive.ground_points(len(drive.frames) // 2).road_count < ground.road_count


def test_a_house_hides_all_behind_it_and_a_car_what_its_roof_does_not_let_pass() -> None:
    picture = np.full((100, 100), Surface.ROAD, np.uint8)
    ranges, ahead = np.array([4.0, 20.0, 60.0]), np.array([[1.0, 0.0]])
    for what, seen in ((Surface.ROAD, [1, 1, 1]), (Surface.CAR, [1, 0, 1]), (Surface.BUILDING, [1, 0, 0])):
        picture[50, 5:8] = what
        assert see(picture, np.array([0.5, 50.5]), ahead, ranges, 0.8).astype(int).tolist() == [seen]


def test_a_walk_turns_by_arcs_of_its_length() -> None:
    line = walk(np.zeros(2), 0.0, (10.0, 0.0), (5.0 * np.pi, 180.0))
    assert np.allclose(line[-1], [10.0, 10.0], atol=1e-6)


def test_a_missed_node_counts_and_the_worst_tenth_counts_twice() -> None:
    errors = np.full(10, 0.5)
    errors[3] = np.nan
    assert loss_m(errors) == pytest.approx((9 * 0.5 + 10.0) / 10 + 10.0)
    found = [
        {"kind": "T", "number": 0, "way": "a", "node": 0, "error_m": 1.0, "squared": 1.0},
        {"kind": "T", "number": 2, "way": "a", "node": 0, "error_m": np.nan, "squared": np.nan},
        {"kind": "T", "number": 2, "way": "a", "node": -1, "error_m": np.nan, "squared": np.nan},
    ]
    line = table_of_kinds(pd.DataFrame(found)).loc["T"]
    assert (line["found [%]"], line["false per drive"], line["mean [m]"], line["worst [m]"]) == (50.0, 0.5, 1.0, 1.0)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = tmp_path / "rows.csv"
    t, one = ["--kind", "T"], ["--places", "1"]
    assert run(["benchmark", "places", *t, *t, *one, "--rows", str(rows)]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("T "))
    assert "100.00" in line
    measured = pd.read_csv(rows)
    assert measured["error_m"].max() < 1.0
    assert not measured.duplicated().any()  # a kind given twice is measured once
    assert run(["benchmark", "places", *t, *one, "--rows", str(tmp_path / "nowhere/rows.csv")]) == 1
    answer = capsys.readouterr()
    assert "could not be written: no such file or directory" in answer.err
    assert not answer.out  # before any is measured
    assert run(["benchmark", "places", *t, *one, "--set", "branches.min_surface_m2=10000", "--json"]) == 0
    nothing, _ = json.loads(capsys.readouterr().out)["kinds"]
    assert (nothing["found [%]"], nothing["mean [m]"], nothing["interval"]) == (0.0, None, None)
    assert run(["benchmark", "places", "--kind", "U"]) != 0
    assert "there is no such kind" in capsys.readouterr().err
