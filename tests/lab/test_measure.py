"""Rows in their files."""

from pathlib import Path

import pytest

from interloc.errors import OutputError
from interloc.lab.measure import Cell, read_row, write_row
from tests.lab.conftest import row


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
