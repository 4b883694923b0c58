"""A benchmark over a small simulated drive, from files to files."""

import gzip
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from interloc.config import DEFAULT, PAPER
from interloc.drives.open import open_drive
from interloc.drives.options import DriveOptions
from interloc.errors import ConfigError, DriveError, GeoreferenceError, MapError, OutputError
from interloc.lab import cases
from interloc.lab import run as running
from interloc.lab.cases import folder_cases, semantickitti_cases, twin_cases
from interloc.lab.measure import Cell, MislabelledDrive, Row, parse_level, read_row, write_row
from interloc.lab.run import Benchmark, NamedConfig, run_benchmark, write_benchmark
from tests.lab.conftest import row

DEFAULTS = NamedConfig("default", DEFAULT)
PAPERS = NamedConfig("paper", PAPER)


@pytest.fixture(scope="module")
def benchmark(town: Path) -> Benchmark:
    cases = folder_cases([town], [town / "map.osm"])
    return Benchmark(tuple(cases), (DEFAULTS, PAPERS), ("0/0", "20/20"), seeds=2)


@pytest.fixture(scope="module")
def finished(benchmark: Benchmark, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Row]]:
    out = tmp_path_factory.mktemp("benchmark") / "out"
    return out, run_benchmark(benchmark, out)


def test_every_cell_is_measured_once(finished: tuple[Path, list[Row]]) -> None:
    _, rows = finished
    cells = [(row.cell.preset, row.cell.noise, row.cell.seed) for row in rows]
    assert cells == [
        (preset, *rest) for preset in ("default", "paper") for rest in (("0/0", 0), ("20/20", 0), ("20/20", 1))
    ]
    assert all(row.keyframes == 60 for row in rows)
    assert sum(row.nodes_found for row in rows) > 0


def test_a_run_goes_on_where_it_stopped(
    benchmark: Benchmark, finished: tuple[Path, list[Row]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, rows = finished
    measure, calls = running.measure, []
    paper = replace(benchmark, configs=(PAPERS,), seeds=1)

    def stop_at_second(cell: Cell, *rest: Any, **options: Any) -> Row:
        calls.append(cell)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return measure(cell, *rest, **options)

    monkeypatch.setattr(running, "measure", stop_at_second)
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(paper, tmp_path / "out")
    assert len(list((tmp_path / "out" / "rows").iterdir())) == 1
    again = run_benchmark(paper, tmp_path / "out")
    assert len(calls) == 2 + 1
    assert again == rows[3:5]


def test_other_settings_are_measured_anew(
    benchmark: Benchmark, finished: tuple[Path, list[Row]], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, _ = finished
    monkeypatch.setattr(running, "measure", None)
    other = NamedConfig("paper", DEFAULT.model_copy(update={"preset": "other"}))
    with pytest.raises(TypeError):
        run_benchmark(Benchmark(benchmark.cases, (other,)), out)


def test_a_folder_of_something_else_is_not_touched(benchmark: Benchmark, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match=r"is not a benchmark: it has no rows/\. It was not touched"):
        run_benchmark(benchmark, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_files_of_a_benchmark(benchmark: Benchmark, finished: tuple[Path, list[Row]]) -> None:
    out, rows = finished
    write_benchmark(benchmark, rows, out)
    record = json.loads((out / "benchmark.json").read_text())
    (pooled,) = (
        entry
        for entry in record["results"]
        if (entry["preset"], entry["noise"], entry["drive"]) == ("paper", "20/20", "all")
    )
    assert pooled["ace_m"]["seeds"] == 2
    assert pooled["ace_m"]["spread"] is not None
    assert "made up by a simulator" in record["attribution"]
    assert "tables II to IV of the paper" in (out / "benchmark.txt").read_text()


def test_twins_in_processes_are_the_same_and_leave_nothing_behind(
    kitti: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two twins at once in processes, one of them again here, from the folder where it was kept."""
    twins = twin_cases(kitti, ["07", "10"], max_scans=8)
    at_once = run_benchmark(Benchmark(tuple(twins), (DEFAULTS,)), tmp_path / "a", workers=2)
    assert [row.cell.drive for row in at_once] == ["07", "10"]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["rows"]

    kept = twin_cases(kitti, ["10"], max_scans=8, keep=tmp_path / "keep")
    (first,) = run_benchmark(Benchmark(tuple(kept), (DEFAULTS,)), tmp_path / "b")
    (scan,) = (tmp_path / "keep").glob("10_seed0_*/velodyne/000000.bin")
    made = scan.stat().st_mtime_ns
    (second,) = run_benchmark(Benchmark(tuple(kept), (DEFAULTS,)), tmp_path / "c")
    assert scan.stat().st_mtime_ns == made
    assert first.errors_m == second.errors_m == at_once[1].errors_m
    monkeypatch.setattr(cases, "versions", dict)
    with replace(kept[0]).opened(tmp_path):
        assert len(list((tmp_path / "keep").iterdir())) == 2  # of another version


@pytest.mark.parametrize("name", ["drive/poses.txt", "scans/0.bin", "map.osm", "oxts.txt", "kitti/osm/00.osm.gz"])
def test_figures_of_a_file_do_not_hold_for_another_in_its_place(kitti_like: Path, tmp_path: Path, name: str) -> None:
    for folder in ("drive", "scans"):
        (tmp_path / folder).mkdir()
    (tmp_path / "drive/velodyne").symlink_to(tmp_path / "scans")
    for path in ("drive/poses.txt", "scans/0.bin", "map.osm", "oxts.txt"):
        (tmp_path / path).write_bytes(b"as it was")

    def inputs() -> str:
        options = DriveOptions(oxts=tmp_path / "oxts.txt")
        (drive,) = folder_cases([tmp_path / "drive"], [tmp_path / "map.osm"], options)
        return drive.inputs + twin_cases(kitti_like, ["00"])[0].inputs

    before = inputs()
    assert before == inputs()
    os.utime(tmp_path / name, ns=(1, 1))
    assert before != inputs()


def test_a_row_comes_back_as_it_was_unless_something_is_new(tmp_path: Path) -> None:
    made = row(errors_m=[0.1234, 5.0])
    assert read_row(made.cell, made.settings, tmp_path) is None
    write_row(made, tmp_path)
    assert read_row(made.cell, made.settings, tmp_path) == made
    assert read_row(made.cell, {"method": "another"}, tmp_path) is None
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:50])
    assert read_row(made.cell, made.settings, tmp_path) is None


def test_a_row_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    cell = row().cell
    (tmp_path / f"{cell.file_name}.json").mkdir()
    with pytest.raises(OutputError, match=r"00_default_0-0_seed0\.json could not be read"):
        read_row(cell, {}, tmp_path)


def test_file_names_hold_no_paths() -> None:
    cell = Cell(drive="../monday/00", preset="default bev.resolution_m=0.25", noise="20/20", seed=3)
    assert cell.file_name == "..-monday-00_default-bev.resolution_m-0.25_20-20_seed3"


@pytest.fixture
def kitti_like(tmp_path: Path) -> Path:
    """A folder with all files of 00, and 03 without a map: empty ones, for nothing looks into them."""
    root = tmp_path / "kitti"
    for folder, ending in (("oxts", "txt.gz"), ("poses_suma", "txt"), ("calib", "txt"), ("times", "txt")):
        (root / folder).mkdir(parents=True)
        for sequence in ("00", "03"):
            (root / folder / f"{sequence}.{ending}").write_bytes(b"")
    (root / "osm").mkdir()
    (root / "osm/00.osm.gz").write_bytes(gzip.compress(b""))
    return root


@pytest.fixture
def data_set(tmp_path: Path) -> Path:
    for name in ("dataset/sequences/00", "dataset/sequences/03", "maps", "oxts", "raw"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "maps/00.osm.pbf").write_bytes(b"")
    (tmp_path / "maps/03.osm").write_bytes(b"")
    return tmp_path


def test_a_twin_for_each_seed(kitti_like: Path) -> None:
    cases = twin_cases(kitti_like, ["00"], seeds=3)
    assert [(case.name, case.seed) for case in cases] == [("00", 0), ("00", 1), ("00", 2)]


@pytest.mark.parametrize(
    ("folder", "sequence", "words"),
    [
        (".", "03", r"sequence 03 has no osm/03\.osm\.gz\. .*all that a twin needs: 00\."),
        (".", "77", r"sequence 77 has no oxts/77\.txt\.gz"),
        ("nowhere", "00", "no such folder"),
    ],
)
def test_what_a_twin_lacks_is_named(kitti_like: Path, folder: str, sequence: str, words: str) -> None:
    with pytest.raises(DriveError, match=words):
        twin_cases(kitti_like / folder, [sequence])


@pytest.mark.parametrize(
    ("sequence", "words"), [("00", "2011_10_03_drive_0027_sync"), ("03", "03 was never published")]
)
def test_a_missing_raw_drive_is_named(data_set: Path, sequence: str, words: str) -> None:
    with pytest.raises(GeoreferenceError, match=words):
        semantickitti_cases(data_set, data_set / "raw", data_set / "maps", [sequence])


def test_rows_of_oxts_are_found(data_set: Path) -> None:
    (data_set / "oxts/00.txt.gz").write_bytes(b"")
    (case,) = semantickitti_cases(data_set, data_set / "oxts", data_set / "maps", ["00"], labels="predictions")
    assert case.path == data_set / "dataset/sequences/00"
    assert case.osm == data_set / "maps/00.osm.pbf"
    assert case.options == DriveOptions(labels="predictions", oxts=data_set / "oxts/00.txt.gz")


@pytest.mark.parametrize("place", ["2011_10_03_drive_0027_sync", "2011_10_03/2011_10_03_drive_0027_sync"])
def test_raw_drives_are_found_under_their_published_names(data_set: Path, place: str) -> None:
    (data_set / "raw" / place / "oxts/data").mkdir(parents=True)
    (case,) = semantickitti_cases(data_set, data_set / "raw", data_set / "maps", ["00"])
    assert case.options.oxts == data_set / "raw" / place


def test_a_missing_sequence_or_map_is_named(data_set: Path) -> None:
    (data_set / "oxts/00.txt").write_bytes(b"")
    with pytest.raises(DriveError, match=r"There are: 00, 03"):
        semantickitti_cases(data_set, data_set / "oxts", data_set / "maps", ["05"])
    with pytest.raises(MapError, match="no map of sequence 00"):
        semantickitti_cases(data_set, data_set / "oxts", data_set / "oxts", ["00"])
    with pytest.raises(DriveError, match="Expected the root of SemanticKITTI"):
        semantickitti_cases(data_set / "maps", data_set / "oxts", data_set / "maps", ["00"])


def test_drives_are_named_so_that_they_differ(tmp_path: Path) -> None:
    osm = tmp_path / "map.osm"
    osm.write_bytes(b"")
    for name in ("a/00", "b/00", "a/01"):
        (tmp_path / name).mkdir(parents=True)
    (first, second) = folder_cases([tmp_path / "a/00", tmp_path / "a/01"], [osm])
    assert (first.name, second.name) == ("00", "01")
    (first, second) = folder_cases([tmp_path / "a/00", tmp_path / "b/00"], [osm])
    assert (first.name, second.name) == ("a/00", "b/00")
    with pytest.raises(ConfigError, match="given twice"):
        folder_cases([tmp_path / "a/00", tmp_path / "a/00"], [osm])


def test_maps_are_one_for_all_or_one_a_drive(tmp_path: Path) -> None:
    maps = [tmp_path / f"{number}.osm" for number in range(3)]
    for path in maps:
        path.write_bytes(b"")
    drives = [tmp_path / "a", tmp_path / "b"]
    for path in drives:
        path.mkdir()
    assert [case.osm for case in folder_cases(drives, maps[:1])] == [maps[0], maps[0]]
    assert [case.osm for case in folder_cases(drives, maps[:2])] == maps[:2]
    with pytest.raises(ConfigError, match="3 maps for 2 drives"):
        folder_cases(drives, maps)
    with pytest.raises(ConfigError, match="2 maps for 1 drive\\."):
        folder_cases(drives[:1], maps[:2])
    with pytest.raises(MapError, match="no such file"):
        folder_cases(drives, [tmp_path / "no.osm"])


def test_no_noise_changes_nothing_and_all_swaps_road_and_the_rest(sequence: Path) -> None:
    drive = open_drive(sequence)
    points = drive.ground_points(2)
    np.testing.assert_array_equal(MislabelledDrive(drive, 0.0, 0.0).ground_points(2).road, points.road)
    np.testing.assert_array_equal(MislabelledDrive(drive, 1.0, 1.0).ground_points(2).road, points.confusable)


def test_shares_are_kept(sequence: Path) -> None:
    drive = open_drive(sequence)
    noisy = MislabelledDrive(drive, 0.2, 0.05, seed=3)
    missed = taken = road = rest = 0
    for index in range(len(drive.frames)):
        clean, points = drive.ground_points(index), noisy.ground_points(index)
        kept = len(set(map(tuple, points.road)) & set(map(tuple, clean.road)))
        road, rest = road + len(clean.road), rest + len(clean.confusable)
        missed, taken = missed + len(clean.road) - kept, taken + len(points.road) - kept
    assert missed / road == pytest.approx(0.05, abs=0.01)
    assert taken / rest == pytest.approx(0.2, abs=0.02)


def test_the_same_points_err_whatever_the_order_and_others_by_another_seed(sequence: Path) -> None:
    drive = open_drive(sequence)
    one, again, other = (MislabelledDrive(drive, 0.2, 0.2, seed=seed) for seed in (1, 1, 2))
    forward = [one.ground_points(index).road for index in range(4)]
    backward = [again.ground_points(index).road for index in reversed(range(4))]
    for a, b in zip(forward, reversed(backward), strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(forward[0]) not in {len(forward[1]), len(other.ground_points(0).road)}


@pytest.mark.parametrize(("r_fpr", "r_fnr", "seed"), [(5, 0, 0), (0, -0.1, 0), (float("nan"), 0, 0), (0, 0, -1)])
def test_shares_that_are_none(sequence: Path, r_fpr: float, r_fnr: float, seed: int) -> None:
    with pytest.raises(ConfigError):
        MislabelledDrive(open_drive(sequence), r_fpr, r_fnr, seed)


@pytest.mark.parametrize("level", ["", "5", "5/", "a/b", "5/101", "-1/5", "5/5/5"])
def test_a_level_that_makes_no_sense_is_refused(level: str) -> None:
    assert parse_level(" 7.5 / 0 ") == (0.075, 0.0)
    with pytest.raises(ConfigError, match="such as 5/20"):
        parse_level(level)
