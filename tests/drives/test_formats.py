"""The table of formats of scans, and formats that other packages bring."""

import json
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from interloc.cli.main import run
from interloc.drives.formats import FORMATS, installed_formats
from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.errors import ConfigError, DriveError
from tests.small_drives import IDS, lidar_poses, pose_text, write_scans

ROOT = Path(__file__).parents[2]
EXAMPLE = re.compile(r"^## A format of scans of your own$.*?^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install the package of docs/library.md, which brings a format."""
    folder = tmp_path / "site"
    (folder / "tables-1.0.dist-info").mkdir(parents=True)
    example = EXAMPLE.search((ROOT / "docs/library.md").read_text())
    (folder / "tables_of_points.py").write_text(example[1])
    (folder / "tables-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: tables\nVersion: 1.0\n")
    (folder / "tables-1.0.dist-info/entry_points.txt").write_text(
        "[interloc.recordings]\ntables = tables_of_points:open_tables\n"
    )
    monkeypatch.syspath_prepend(folder)
    installed_formats.cache_clear()
    yield folder / "tables_of_points.py"
    installed_formats.cache_clear()
    sys.modules.pop("tables_of_points", None)


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    """A drive in that format."""
    root, poses = tmp_path / "07", lidar_poses()
    write_scans(root / "tables", root / "labels", poses, IDS["semantickitti"], list(range(12)), 6)
    for path in (root / "tables").iterdir():
        np.save(path.with_suffix(".npy"), np.fromfile(path, np.float32).reshape(-1, 4))
        path.unlink()
    (root / "poses.txt").write_text(pose_text(poses))
    return root


def test_every_format_of_the_table_can_be_opened() -> None:
    for each in FORMATS:
        module, _, name = each.opener.partition(":")
        assert callable(getattr(import_module(module), name))


@pytest.mark.usefixtures("package")
def test_a_format_of_another_package(tables: Path, tmp_path: Path) -> None:
    report = inspect_drive(tables)
    assert (report.layout, report.scans, report.label_folder) == ("tables", 12, "labels")
    assert report.problems == []
    arguments = ["--layout", "tables", "-o", str(tmp_path / "reduced"), "--quiet"]
    assert run(["convert", "--reduce", str(tables), *arguments]) == 0
    assert json.loads((tmp_path / "reduced/reduced.json").read_text())["layout"] == "tables"


def test_a_package_that_is_damaged_is_named(package: Path, tables: Path) -> None:
    package.write_text("from tables_of_numbers import open_tables\n")
    with pytest.raises(DriveError, match="tables: tables_of_points:open_tables cannot be loaded: No module named"):
        open_drive(tables)


def test_without_the_package(tables: Path) -> None:
    with pytest.raises(DriveError, match=r"is not a drive\. It holds 12 \.npy files"):
        open_drive(tables)
    with pytest.raises(ConfigError, match="layout 'tables': expected 'auto', 'semantickitti'"):
        open_drive(tables, layout="tables")
