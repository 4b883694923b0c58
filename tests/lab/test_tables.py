"""Figures from literal rows, worked out by eye, and the tables as a person reads them."""

from typing import Any

import numpy as np
import pytest

from interloc.lab.tables import Measured, Table, axes_table, figures, results_table, tables
from tests.lab.conftest import row


def lines_of(table: Table) -> dict[tuple[str, ...], tuple[str, ...]]:
    """Cells of a table by the words of their row."""
    return {words: tuple(line) for words, line in zip(table.frame.index, table.frame.values.tolist(), strict=True)}


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (  # the paper's column "Average" is no mean of its columns: long drives weigh more; 5.0 is not under 5
            [{"errors_m": [1.0, 1.0, 1.0, 5.0], "fn": 1}, {"drive": "02", "errors_m": [2.0, 8.0], "fn": 4}],
            {"ace_m": 18 / 6, "precision_at_5": 4 / 6, "recall_at_5": 4 / 9, "f1_at_5": 2 * 4 / (4 + 6 + 5)},
        ),
        ([{"errors_m": [1.0, 3.0], "unmatched": 2}], {"ace_m": 2.0, "precision_at_5": 0.5}),  # false, but no error
        ([{"errors_m": [1.0, 3.0, 50.0]}], {"ace_m": 18.0, "ace_under_10_m": 2.0}),
        ([{"errors_m": [1.0, 6.0, 13.0, 20.0], "fn": 1}], {"precision_at_6_9": 2 / 4, "recall_at_13_3": 3 / 4}),
        (
            [
                {"fused": (3, 1, 0, 3), "map_errors_m": [0.1, 0.2, 0.9]},
                {"drive": "02", "fused": (0, 0, 2, 2), "map_errors_m": []},
            ],
            {"map_precision": 3 / 4, "map_recall": 3 / 5, "map_median_m": 0.2},
        ),
    ],
)
def test_figures_are_pooled_over_drives(rows: list[dict[str, Any]], expected: dict[str, float]) -> None:
    found = figures([row(**each) for each in rows])
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_nothing_measured_is_undefined_or_none_found() -> None:
    assert all(value == 0.0 if name.startswith("nodes") else np.isnan(value) for name, value in figures([]).items())


def test_seeds_give_mean_and_spread_where_a_figure_is_defined() -> None:
    errors = ([1.0], [2.0], [3.0], [])
    rows = tuple(row(errors_m=values, seed=seed) for seed, values in enumerate(errors))
    estimate = Measured(rows, ("00",), ("default",), ("0/0",)).estimates.loc["default", "0/0", "00"]["ace_m"]
    assert estimate.tolist() == pytest.approx([2.0, 1.0, 3])
    (one,) = Measured(rows[:1], ("00",), ("default",), ("0/0",)).estimates["ace_m"].drop_duplicates().values
    assert one.tolist() == pytest.approx([1.0, np.nan, 1], nan_ok=True)


def test_a_drive_with_one_seed_takes_part_in_every_pool() -> None:
    rows = (row("00", [0.0]), row("02", [2.0], seed=0), row("02", [4.0], seed=1))
    estimates = Measured(rows, ("00", "02"), ("default",), ("0/0",)).estimates
    assert estimates.loc["default", "0/0", "all"]["ace_m", "mean"] == pytest.approx((1.0 + 2.0) / 2)


def test_drives_and_levels_stand_beside_the_published_figures() -> None:
    rows = (
        row("00", [1.0, 2.0], fn=1),
        row("town", [7.0]),
        row("00", [9.0], noise="20/20"),
        row("town", [7.0], noise="20/20"),
    )
    table = results_table(Measured(rows, ("00", "town"), ("default",), ("0/0", "20/20")))
    lines = lines_of(table)
    assert [words for words in lines if words[:2] == ("0/0", "all")] == [
        ("0/0", "all", "published"),
        ("0/0", "all", "published, hand labels"),
        ("0/0", "all", "MMInsectDet, published"),
        ("0/0", "all", "preset default"),
    ]
    assert lines["0/0", "00", "published"][:4] == ("1.28", "–", "97.2", "94.2")  # noqa: RUF001
    assert lines["0/0", "00", "preset default"][:4] == ("1.50", "1.50", "100.0", "66.7")
    assert ("0/0", "town", "published") not in lines
    assert lines["0/0", "town", "preset default"][:4] == ("7.00", "7.00", "0.0", "–")  # noqa: RUF001
    assert lines["0/0", "all", "published"][:6] == ("1.92", "–", "89.5", "76.7", "94.4", "84.3")  # noqa: RUF001
    assert lines["0/0", "all", "MMInsectDet, published"][4:6] == ("89.2", "83.1")
    assert lines["0/0", "all", "preset default"][0] == "3.33"
    assert lines["0/0", "all", "preset default"][6:8] == ("2.0", "2.0")
    assert lines["20/20", "all", "published"][:4] == ("3.23", "–", "78.8", "68.0")  # noqa: RUF001
    assert lines["20/20", "all", "preset default"][:3] == ("8.00", "8.00", "0.0")
    assert not any("seeds" in note for note in table.notes)


def test_seeds_show_their_spread() -> None:
    rows = (row(errors_m=[1.0], seed=0, nodes=(1, 2)), row(errors_m=[2.0], seed=1, nodes=(2, 2)))
    table = results_table(Measured(rows, ("00",), ("default",), ("0/0",)))
    line = lines_of(table)["0/0", "00", "preset default"]
    assert (line[0], line[6], line[7]) == ("1.50 ± 0.71", "1.5 ± 0.7", "2.0 ± 0.0")
    assert table.notes[-1] == "2 seeds: mean ± standard deviation over the seeds."


def test_a_drive_without_detections_shows_dashes() -> None:
    measured = Measured((row("town", [], fused=(0, 0, 0, 0), map_errors_m=[]),), ("town",), ("default",), ("0/0",))
    line = lines_of(results_table(measured))["0/0", "town", "preset default"]
    assert [line[column] for column in (0, 1, 2, 3, 8, 9, 10)] == ["–"] * 7  # noqa: RUF001
    assert all(table.text() for table in tables(measured))


def test_errors_from_the_axes_stand_beside_those_from_the_nodes() -> None:
    known = row("real", map_axes_errors_m=[(2.0, 0.5), (1.0, 0.2), (3.0, 2.0)])
    measured = Measured((known, row("town")), ("real", "town"), ("default",), ("0/0",))
    lines = lines_of(axes_table(measured))
    assert lines["real", "preset default"] == ("3", "2.00", "2.00", "3.00", "0.90", "0.50", "2.00")
    assert lines["town", "preset default"][:2] == ("0", "–")  # noqa: RUF001
    assert axes_table(measured).title in {table.title for table in tables(measured)}
    unknown = Measured((row("town"),), ("town",), ("default",), ("0/0",))
    assert not [table for table in tables(unknown) if table.title.startswith("Errors from")]
