"""Rows in their files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import interloc
from interloc.benchmark.fingerprint import file_facts, fingerprint, imported_by
from interloc.benchmark.row import Cell, Row, read_row, write_row
from interloc.errors import OutputError


def test_a_row_comes_back_as_it_was(row: Callable[..., Row], tmp_path: Path) -> None:
    made = row(errors_m=[0.1234, 5.0])
    write_row(made, tmp_path)
    assert read_row(made.cell, "f", tmp_path) == made


def test_a_row_of_other_settings_or_program_is_not_taken(row: Callable[..., Row], tmp_path: Path) -> None:
    made = row()
    write_row(made, tmp_path)
    assert read_row(made.cell, "another", tmp_path) is None


def test_a_damaged_row_is_measured_anew(row: Callable[..., Row], tmp_path: Path) -> None:
    made = row()
    write_row(made, tmp_path)
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:50])
    assert read_row(made.cell, "f", tmp_path) is None


def test_no_row_yet(row: Callable[..., Row], tmp_path: Path) -> None:
    assert read_row(row().cell, "f", tmp_path) is None


def test_a_row_that_cannot_be_read_is_named(row: Callable[..., Row], tmp_path: Path) -> None:
    cell = row().cell
    (tmp_path / f"{cell.file_name}.json").mkdir()
    with pytest.raises(OutputError, match=r"00_default_0-0_seed0\.json could not be read"):
        read_row(cell, "f", tmp_path)


def test_file_names_hold_no_paths() -> None:
    cell = Cell(drive="../monday/00", preset="default bev.resolution_m=0.25", noise="20/20", seed=3)
    assert cell.file_name == "..-monday-00_default-bev.resolution_m-0.25_20-20_seed3"


def test_fingerprints_differ_with_the_facts() -> None:
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    assert fingerprint({"a": 1}) != fingerprint({"a": 2})


def test_a_simulated_drive_depends_on_all_that_the_simulator_imports() -> None:
    package = Path(interloc.__file__).parent
    found = {path.relative_to(package).as_posix() for path in imported_by(package / "simulate")}
    assert {"simulate/town.py", "kernels/raycast.py", "osm/container.py", "geometry.py", "__init__.py"} <= found
    assert not found & {"pipeline.py", "mapping/fusion.py", "benchmark/run.py"}


def test_a_changed_file_is_noticed(tmp_path: Path) -> None:
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / "poses.txt").write_text("1")
    before = file_facts([folder])
    (folder / "poses.txt").write_text("12")
    assert file_facts([folder]) != before
