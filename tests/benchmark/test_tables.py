"""The tables as a person reads them."""

from __future__ import annotations

from collections.abc import Callable

from interloc.benchmark.row import Row
from interloc.benchmark.tables import (
    Measured,
    Table,
    axes_table,
    comparison_table,
    noise_table,
    performance_table,
    sensor_table,
    tables,
    text,
)
from interloc.evaluation.published import SEQUENCES

Rows = Callable[..., Row]


def lines_of(table: Table) -> dict[tuple[str, str], tuple[str, ...]]:
    """Cells of a table by the words of their row; the first word holds for the rows below."""
    found = {}
    for group in table.groups:
        for line in group:
            found[group[0][0], line[1]] = line[2:]
    return found


def test_text_is_aligned() -> None:
    table = Table("T", ("", "ACE [m]"), ((("published", "1.28"), ("ours", "0.50 ± 0.10")),), notes=("A note.",))
    assert text(table).splitlines() == [
        "T",
        "----------------------",
        "               ACE [m]",
        "----------------------",
        "published         1.28",
        "ours       0.50 ± 0.10",
        "----------------------",
        "A note.",
    ]


def test_performance_stands_beside_the_published_figures(row: Rows) -> None:
    measured = Measured((row("00", [1.0, 2.0], fn=1), row("town", [7.0])), ("00", "town"), ("default",), ("0/0",))
    table = performance_table(measured, "0/0")
    lines = lines_of(table)
    assert table.header == ("", "", "00", "town", "all")
    assert lines["ACE [m]", "published"] == ("1.28", "–", "–")  # noqa: RUF001
    assert lines["ACE [m]", "preset default"] == ("1.50", "7.00", "3.33")
    assert lines["Pre@5 [%]", "published"] == ("97.2", "–", "–")  # noqa: RUF001
    assert lines["Pre@5 [%]", "preset default"] == ("100.0", "0.0", "66.7")
    assert lines["Rec@5 [%]", "preset default"] == ("66.7", "–", "66.7")  # noqa: RUF001
    assert lines["nodes found / in zone", "preset default"] == ("1/1", "1/1", "2/2")
    assert lines["ms per keyframe", "preset default"] == ("5.0", "5.0", "5.0")


def test_the_published_average_stands_only_beside_its_own_eight_sequences(row: Rows) -> None:
    measured = Measured(tuple(row(name) for name in SEQUENCES), SEQUENCES, ("default",), ("0/0",))
    assert lines_of(performance_table(measured, "0/0"))["ACE [m]", "published"][-1] == "1.92"
    assert not any("all eight" in note for note in comparison_table(measured).notes)
    some = Measured((row("07"),), ("07",), ("default",), ("0/0",))
    assert performance_table(some, "0/0").header == ("", "", "07")
    assert comparison_table(some).notes == ("Published: all eight sequences of SemanticKITTI; this run: 07.",)


def test_drives_of_no_known_sequence_have_no_published_row(row: Rows) -> None:
    measured = Measured((row("town"),), ("town",), ("default",), ("0/0",))
    assert "published" not in text(performance_table(measured, "0/0")).lower()


def test_comparison(row: Rows) -> None:
    measured = Measured((row("00", [1.0, 6.0, 8.0, 20.0], fn=1),), ("00",), ("default",), ("0/0",))
    assert [line for group in comparison_table(measured).groups for line in group] == [
        ("MMInsectDet", "4.25", "89.2", "83.1"),
        ("InterLoc, published", "1.92", "94.4", "84.3"),
        ("InterLoc, preset default", "8.75", "50.0", "75.0"),
    ]


def test_levels_of_label_errors(row: Rows) -> None:
    rows = [
        row(errors_m=[error], preset=preset, noise=noise)
        for preset, noise, error in (
            ("default", "0/0", 1.0),
            ("default", "20/20", 2.0),
            ("paper", "0/0", 3.0),
            ("paper", "20/20", 9.0),
        )
    ]
    measured = Measured(tuple(rows), ("00",), ("default", "paper"), ("0/0", "20/20"))
    lines = lines_of(noise_table(measured))
    assert lines["0/0", "published"] == ("1.86", "90.1", "80.7")
    assert lines["20/20", "published"] == ("3.23", "78.8", "68.0")
    assert lines["20/20", "preset default"] == ("2.00", "100.0", "100.0")
    assert lines["20/20", "preset paper"] == ("9.00", "0.0", "–")  # noqa: RUF001


def test_predicted_labels_stand_beside_the_published_network(row: Rows) -> None:
    measured = Measured((row(),), ("00",), ("default",), ("0/0",), labels="predictions")
    assert lines_of(noise_table(measured))["0/0", "published"] == ("1.92", "89.5", "76.7")


def test_a_level_that_the_paper_does_not_have(row: Rows) -> None:
    measured = Measured((row(), row(noise="10/10")), ("00",), ("default",), ("0/0", "10/10"))
    assert ("10/10", "published") not in lines_of(noise_table(measured))


def test_seeds_show_their_spread(row: Rows) -> None:
    rows = (row(errors_m=[1.0], seed=0, nodes=(1, 2)), row(errors_m=[2.0], seed=1, nodes=(2, 2)))
    table = performance_table(Measured(rows, ("00",), ("default",), ("0/0",)), "0/0")
    lines = lines_of(table)
    assert lines["ACE [m]", "preset default"] == ("1.50 ± 0.71",)
    assert lines["nodes found / in zone", "preset default"] == ("1.5/2.0",)
    assert table.notes[-1] == "2 seeds: mean ± standard deviation over the seeds."


def test_a_drive_without_detections_shows_dashes(row: Rows) -> None:
    measured = Measured((row("00", [], fused=(0, 0, 0, 0), map_errors_m=[]),), ("00",), ("default",), ("0/0",))
    lines = lines_of(performance_table(measured, "0/0"))
    for name in ("ACE [m]", "Pre@5 [%]", "Rec@5 [%]", "map precision [%]", "map recall [%]", "map median error [m]"):
        assert lines[name, "preset default"] == ("–",)  # noqa: RUF001
    assert all(text(table) for table in tables(measured))


def test_sensors_side_by_side(row: Rows) -> None:
    rows = [
        row(drive, [error], preset=preset, fn=fn, nodes=(1, 2))
        for drive, preset, error, fn in (
            ("05 vlp-16", "default", 1.0, 0),
            ("07 vlp-16", "default", 3.0, 1),
            ("05 vlp-16", "default, causal", 9.0, 0),
            ("05", "default", 0.5, 0),
            ("05", "default, causal", 0.75, 0),
        )
    ]
    drives, sensors = ("05 vlp-16", "07 vlp-16", "05"), {"vlp-16": ("05 vlp-16", "07 vlp-16"), "hdl-64e": ("05",)}
    measured = Measured(tuple(rows), drives, ("default", "default, causal"), ("0/0",), sensors=sensors)
    lines = lines_of(sensor_table(measured, "0/0"))
    assert lines["vlp-16", "preset default"] == ("2.00", "100.0", "66.7", "2/4", "5.0")
    assert lines["vlp-16", "preset default, causal"] == ("9.00", "0.0", "–", "1/2", "5.0")  # noqa: RUF001
    assert lines["hdl-64e", "preset default"] == ("0.50", "100.0", "100.0", "1/2", "5.0")
    first, second, _ = tables(measured)
    assert first.title == "Performance per sensor"
    assert second.header == ("", "", *drives)  # pooling over sensors would mean nothing


def test_errors_from_the_axes_stand_beside_those_from_the_nodes(row: Rows) -> None:
    known = row("real", map_axes_errors_m=[(2.0, 0.5), (1.0, 0.2), (3.0, 2.0)])
    measured = Measured((known, row("town")), ("real", "town"), ("default",), ("0/0",))
    lines = lines_of(axes_table(measured))
    assert lines["real", "preset default"] == ("3", "2.00", "2.00", "3.00", "0.90", "0.50", "2.00")
    assert lines["town", "preset default"][:2] == ("0", "–")  # noqa: RUF001
    assert axes_table(measured) in tables(measured)
    unknown = Measured((row("town"),), ("town",), ("default",), ("0/0",))
    assert not [table for table in tables(unknown) if table.title.startswith("Errors from")]
