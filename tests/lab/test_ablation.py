"""What each setting gives: literal rows worked out by eye, and one small simulated drive."""

from pathlib import Path

import numpy as np
import pytest

from interloc.config import DEFAULT, PAPER
from interloc.errors import ConfigError, DriveError
from interloc.evaluation.metrics import UNMATCHED
from interloc.geometry import enu_from_lonlat
from interloc.lab import cases
from interloc.lab.cases import FolderCase, folder_cases
from interloc.lab.measure import Place
from interloc.lab.run import NOTHING, SETS, Benchmark, ablation_table, run_benchmark, taken_out
from interloc.osm.intersections import intersection_nodes
from interloc.osm.reader import read_osm
from tests.lab.conftest import row

CONFIGS = taken_out(DEFAULT, ["compound"])


def place(
    node: int, detections: int, error_m: float, *, right: int = 0, missed: int = 0, axes_m: float | None = None
) -> Place:
    return Place(node=node, detections=detections, right=right, missed=missed, error_m=error_m, axes_error_m=axes_m)


def test_each_setting_is_taken_out_alone() -> None:
    nothing, *others = taken_out(DEFAULT)
    assert (nothing.name, nothing.config) == (NOTHING, DEFAULT)
    by_name = {each.name: each for each in others}
    assert by_name["compound"].config == DEFAULT.model_copy(update={"compound": None})
    assert by_name["candidates"].config.candidates == PAPER.candidates
    assert by_name["branches.square_std_deg"].config.branches.square_std_deg is None
    assert by_name["bev.vote"].config.bev.vote is False
    assert not [name for name in by_name if name.startswith(("fusion", "calibration"))]
    assert taken_out(PAPER) == [type(nothing)(NOTHING, PAPER)]


def test_an_unknown_setting_is_named_with_those_that_can_be_taken_out() -> None:
    with pytest.raises(ConfigError, match=r"--take-out branches\.fork: expected one of bev\.min_points, .*compound"):
        taken_out(DEFAULT, ["branches.fork"])


def test_the_parts_have_no_place_in_common() -> None:
    choosing, reporting = SETS["choosing"], SETS["reporting"]
    assert not {*choosing.sequences} & {*reporting.sequences}
    assert not {*choosing.recorded} & {*reporting.recorded}


def test_changes_stand_with_their_interval() -> None:
    with_it = [row(preset=NOTHING, places=[place(n, 10, 10.0, right=10, axes_m=5.0) for n in range(8)])]
    without = [row(preset="compound", places=[place(n, 10, 20.0, right=5, axes_m=10.0) for n in range(8)])]
    table = ablation_table([*with_it, *without], CONFIGS, "choosing")
    assert table.frame.loc[NOTHING].values.tolist() == [["1.00", "0.50", "100.0"]]
    assert table.frame.loc["compound"].values.tolist() == [
        ["2.00 (+1.00; 1.00 to 1.00)*", "1.00 (+0.50; 0.50 to 0.50)*", "66.7 (-33.3; -33.3 to -33.3)*"]
    ]


def test_a_change_that_is_none_as_it_is_written_has_no_star() -> None:
    with_it = row(preset=NOTHING, places=[place(n, 10, 10.0, right=10) for n in range(8)])
    without = row(preset="compound", places=[place(n, 10, 10.01, right=10) for n in range(8)])
    table = ablation_table([with_it, without], CONFIGS, "choosing")
    assert table.frame.loc["compound"].values[0][0] == "1.00 (+0.00; 0.00 to 0.00) "
    assert table.notes[0].startswith("1 drive, 8 places.")


def test_one_place_among_many_decides_nothing() -> None:
    places = [place(n, 10, 10.0, right=10) for n in range(7)]
    with_it = row(preset=NOTHING, places=[*places, place(7, 10, 10.0, right=10)])
    without = row(preset="compound", places=[*places, place(7, 10, 90.0, missed=3)])
    ((ace, axes, f1),) = ablation_table([with_it, without], CONFIGS, "choosing").frame.loc["compound"].values.tolist()
    assert not (ace + f1).count("*")
    assert axes == "–"  # noqa: RUF001


def test_detections_without_a_node_are_false_but_have_no_error() -> None:
    rows = [row(preset=NOTHING, places=[place(1, 4, 4.0, right=4), place(-1, 4, 0.0)])]
    assert ablation_table(rows, CONFIGS[:1], "choosing").frame.values.tolist() == [["1.00", "–", "66.7"]]  # noqa: RUF001


def test_errors_from_the_axes_are_those_from_the_nodes_where_axes_meet_there(
    town: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cases, "KNOWN_AXES", tmp_path / "axes")
    nodes = intersection_nodes(read_osm(town / "map.osm"))
    lines = [
        f"{number},{lon!r},{lat!r}" for number, (lon, lat) in zip(nodes.osm_id, nodes.lonlat.tolist(), strict=True)
    ]
    (tmp_path / "axes").mkdir()
    (tmp_path / "axes/town.csv").write_text("\n".join(["osm_id,lon,lat", *lines]))
    (case,) = folder_cases([town], [town / "map.osm"])
    rows = run_benchmark(Benchmark((case,), tuple(CONFIGS)), tmp_path / "out")
    assert sum(each.detections for each in rows[0].places) == len(rows[0].errors_m) + rows[0].unmatched
    assert sum(each.missed for each in rows[0].places) == rows[0].fn
    assert sum(each.error_m for each in rows[0].places) == pytest.approx(sum(rows[0].errors_m), abs=1e-2)
    known = [each for each in rows[0].places if each.node != UNMATCHED]
    assert [each.axes_error_m for each in known] == pytest.approx([each.error_m for each in known], abs=1e-3)
    assert rows[0].map_axes_errors_m == tuple((each, pytest.approx(each, abs=1e-3)) for each in rows[0].map_errors_m)
    assert rows[0].map_axes_errors_m
    assert len(ablation_table(rows, CONFIGS, "town").frame) == 2


def test_axes_of_a_recorded_drive_are_read(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    (tmp_path / "map.osm").write_text("<osm/>")
    (case,) = folder_cases([tmp_path / "drive"], [tmp_path / "map.osm"])
    (tmp_path / "drive/axes.csv").write_text("osm_id,lon,lat,note\n7,8.4,49.0,\n8,,,a yard\n")
    assert case.axes() == {7: (8.4, 49.0)}
    (tmp_path / "drive/axes.csv").write_text("osm_id,lon,lat\n7,east,north\n")
    with pytest.raises(DriveError, match=r"axes\.csv: expected a line osm_id,lon,lat"):
        case.axes()


def test_axes_of_the_drawn_maps_are_known_by_their_nodes(tmp_path: Path) -> None:
    axes = FolderCase("any", tmp_path, tmp_path / "map.osm").axes()
    lonlat = np.array(list(axes.values()))
    assert len(axes) == 32
    assert np.abs(enu_from_lonlat(48.9842, 8.3922, lonlat)).max() < 7000.0  # all in one town
    twins = enu_from_lonlat(48.9832, 8.3941, np.array([axes[1702371750], axes[1702371766]]))  # one crossing, two nodes
    assert np.hypot(*(twins[0] - twins[1])) < 1.0
