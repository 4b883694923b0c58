"""The table of a batch: one row per drive, as CSV and as a page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from interloc.cli.summary import wrong_detections
from interloc.cli.units import Ended, Unit
from interloc.files import write_file

TABLE, PAGE = "batch.csv", "batch.html"

COLUMNS = (
    "name",
    "state",
    "verdict",
    "precision",
    "recall",
    "ace_m",
    "reasons",
    "intersections",
    "keyframes",
    "seconds",
    "warnings",
    "error",
    "drive",
)
"""Precision and recall are those of the detections at D = 5 m; reasons say why detections are wrong, with numbers."""


def row_of(unit: Unit, ended: Ended, out: Path) -> dict[str, Any]:
    """Return the row of a drive: its figures from the files of its result."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS)
    row |= {"name": unit.name, "drive": unit.drive, "seconds": round(ended.seconds, 1), "error": ended.error}
    warnings = list(ended.warnings)
    row["state"] = "successful" if ended.error is None else "failed"
    if ended.error is None:
        run, report = (_read(out / unit.name / name) for name in ("run.json", "report.json"))
        row["keyframes"] = run.get("keyframes")
        row["intersections"] = _count(out / unit.name)
        if report:
            row |= {"verdict": report["map_line"], "ace_m": report["ace_m"], "reasons": wrong_detections(report)[1]}
            row |= {name: report[name]["5.0"] for name in ("precision", "recall")}
            warnings = list(dict.fromkeys([*report["warnings"], *warnings]))
    row["warnings"] = "; ".join(warnings)
    return row


def write_table(rows: Sequence[dict[str, Any]], out: Path) -> None:
    """Write the table as `batch.csv` and `batch.html`."""
    from interloc.evaluation.report import template

    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    page = template("batch.html", "interloc.cli").render(rows=rows, has_map=(out / "city" / "city.geojson").is_file())
    for name, content in ((TABLE, text.getvalue()), (PAGE, page)):
        write_file(out / name, content)


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_bytes()) if path.is_file() else {}
    return found


def _count(folder: Path) -> int:
    files = [folder / f"intersections.{ending}" for ending in ("geojson", "local.json")]
    return len(_read(next((file for file in files if file.is_file()), files[0])).get("features", []))
