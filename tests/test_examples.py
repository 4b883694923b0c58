"""The notebooks in examples/ run from top to bottom, as a newcomer would run them."""

import ast
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zlib import crc32

import matplotlib.pyplot as plt
import pytest

from interloc.lab.config import SimulationOptions
from interloc.lab.drive import Trip, simulate
from tests.once import once

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(notebook: Path) -> tuple[dict[str, Any], list[Any]]:
    """Run the cells of a notebook; return its names, and the values of the cells that end with one."""
    names: dict[str, Any] = {}
    shown = []
    for cell in json.loads(notebook.read_text())["cells"]:
        if cell["cell_type"] != "code":
            continue
        body = ast.parse("".join(cell["source"])).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), notebook.name, "exec"), names)  # noqa: S102 - our own
        if isinstance(last, ast.Expr):
            shown.append(eval(compile(ast.Expression(last.value), notebook.name, "eval"), names))  # noqa: S307
    return names, [value for value in shown if value is not None]


@pytest.fixture(autouse=True)
def _no_windows(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Iterator[None]:
    """Draw without a screen, and make the town that both simulate once."""

    def simulate_once(trip: Trip, out: Path, options: SimulationOptions) -> None:
        name = f"example-{crc32(repr(options).encode())}"
        made = once(tmp_path_factory, name, lambda place: simulate(trip, place, options))
        shutil.copytree(made, out)

    monkeypatch.setattr("interloc.lab.drive.simulate", simulate_once)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with plt.rc_context({"backend": "agg"}):
        yield
    plt.close("all")


def test_a_drive_to_a_map() -> None:
    names, shown = run(EXAMPLES / "drive_to_map.ipynb")
    assert {each.severity for each in names["report"].problems} <= {"note"}
    assert set(names["intersections"].outcome) == {"right"}
    assert {"report.html", "intersections.geojson"} <= set(shown[-1])


def test_two_label_sources_are_compared() -> None:
    names, shown = run(EXAMPLES / "compare_label_sources.ipynb")
    by_hand, by_network = names["evaluations"].values()
    assert by_hand.ace_m < by_network.ace_m
    assert [len(table) for table in shown[-2:]] == [2, 5]  # a row per source; a row per place
