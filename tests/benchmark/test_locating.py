"""The table of placed drives."""

from __future__ import annotations

from interloc.benchmark.locating import LocateRow, MapKind, table_of


def row(on: MapKind, outcome: str, *, right: bool = False, whole: bool = False, length_m: float = 500.0) -> LocateRow:
    error = 0.5 if on == "map" else None
    return LocateRow("07", 0.0, length_m, whole, on, outcome, right, error, error, error, 1.0, 0.5, 0.5)


def test_right_refused_and_wrong_are_counted_by_length() -> None:
    rows = [row("map", "found", right=True, whole=True, length_m=691.0)]
    rows += [row("map", "found", right=True), row("map", "found"), row("map", "ambiguous", right=True)]
    rows += [row("mirrored", "not_found"), row("without", "found")]
    whole, pieces = table_of(rows).splitlines()[2:]
    assert whole == "| whole sequences | 1 | 1 (100 %) | 0 | 0 | 0.50 / 0.50 | 0.50 | 0 of 0 |"
    assert pieces == "| 500 m | 3 | 1 (33 %) | 1 | 1 | 0.50 / 0.50 | 0.50 | 1 of 2 |"
