"""A benchmark over a small simulated drive, from files to files."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from interloc.config import DEFAULT, PAPER
from interloc.errors import OutputError
from interloc.lab import run as running
from interloc.lab.cases import folder_cases, twin_cases
from interloc.lab.measure import Cell, Row
from interloc.lab.run import Benchmark, NamedConfig, run_benchmark, write_benchmark

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


def test_finished_rows_are_kept(
    benchmark: Benchmark, finished: tuple[Path, list[Row]], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, rows = finished
    monkeypatch.setattr(running, "measure", None)  # nothing may be measured
    assert run_benchmark(benchmark, out) == rows


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


def test_twins_in_processes_are_the_same_and_leave_nothing_behind(kitti: Path, tmp_path: Path) -> None:
    """Two twins at once in processes, one of them again here, from the folder where it was kept."""
    cases = twin_cases(kitti, ["07", "10"], max_scans=8)
    at_once = run_benchmark(Benchmark(tuple(cases), (DEFAULTS,)), tmp_path / "a", workers=2)
    assert [row.cell.drive for row in at_once] == ["07", "10"]
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["rows"]

    kept = twin_cases(kitti, ["10"], max_scans=8, keep=tmp_path / "keep")
    (first,) = run_benchmark(Benchmark(tuple(kept), (DEFAULTS,)), tmp_path / "b")
    scan = tmp_path / "keep/10_seed0_first8/velodyne/000000.bin"
    made = scan.stat().st_mtime_ns
    (second,) = run_benchmark(Benchmark(tuple(kept), (DEFAULTS,)), tmp_path / "c")
    assert scan.stat().st_mtime_ns == made
    assert first.errors_m == second.errors_m == at_once[1].errors_m
