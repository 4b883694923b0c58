"""The table of placed drives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from interloc.benchmark.locating import LocateRow, MapKind, PieceKind, table_of, write_locating


def row(
    on: MapKind, outcome: str, *, right: bool = False, what: PieceKind = "piece", length_m: float = 500.0
) -> LocateRow:
    made = LocateRow("07", 0.0, length_m, what, on, outcome, 1.0, 0.5, 0.5, right, seconds=2.0)
    if on != "map":
        return made
    errors = [0.4, 0.5, 0.6]
    return replace(made, median_m=0.5, p95_m=0.5, heading_deg=0.5, errors_m=errors, headings_deg=errors)


def test_right_refused_and_wrong_are_counted_by_length(tmp_path: Path) -> None:
    rows = [row("map", "found", right=True, what="whole", length_m=691.0)]
    rows += [row("map", "found", right=True), row("map", "found"), row("map", "ambiguous", right=True)]
    rows += [row("mirrored", "not_found"), row("without", "found")]
    rows += [row("map", "ambiguous", right=True, what="intersection", length_m=150.0)]
    whole, pieces, _, single = table_of(rows).splitlines()[2:]
    assert whole == "| whole sequences | 1 | 1 (100 %) | 0 | 0 | 0.50 / 0.59 | 0.50 | 0 of 0 | 2.0 / 2.0 |"
    assert pieces == "| 500 m | 3 | 1 (33 %) | 1 | 1 | 0.50 / 0.59 | 0.50 | 1 of 2 | 2.0 / 2.0 |"
    assert "100 % of 1" in single
    write_locating(rows, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"locate.json", "locate.md", "locate.svg"}
