"""Evaluations of one drive side by side: which inputs and settings differ, which figures, which nodes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from interloc.config import flatten
from interloc.drawing import image
from interloc.errors import ConfigError
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M
from interloc.evaluation.report import data_address, template, threshold_name
from interloc.files import write_file
from interloc.output.layout import refuse_result_file, settings_of

_STANDARD = threshold_name(STANDARD_THRESHOLD_M)


def compare_reports(
    names: Sequence[str], reports: Sequence[Mapping[str, Any]], runs: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """Put the reports of several runs over one drive side by side.

    Parameters
    ----------
    names
        Names of the runs; every list of values in the outcome is in their order.
    reports, runs
        Contents of each `report.json` and `run.json`.

    Returns
    -------
    dict
        ``inputs`` and ``settings`` (those that differ), ``figures``, ``nodes`` (those with other outcomes: found,
        missed, or outside of the zone in which they count), ``found_by_all``, ``missed_by_all``, ``found_only_by``,
        ``warnings``.

    Raises
    ------
    ConfigError
        Fewer than two runs.
    """
    if len(names) < 2 or not len(names) == len(reports) == len(runs):
        raise ConfigError(f"a comparison takes two runs or more, each with its report; {len(names)} given")
    outcomes = [{node["osm_id"]: node for node in report["nodes"]} for report in reports]
    nodes = [_node(osm_id, outcomes) for osm_id in dict.fromkeys(id_ for table in outcomes for id_ in table)]
    found = [{node["osm_id"] for node in nodes if node["outcomes"][i] == "found"} for i in range(len(names))]
    missed = [{node["osm_id"] for node in nodes if node["outcomes"][i] == "missed"} for i in range(len(names))]
    return {
        "runs": list(names),
        "inputs": differing_inputs(runs),
        "settings": differing_settings(runs),
        "figures": [
            {"name": name, "title": title, "values": [figure(report) for report in reports]}
            for name, title, figure in _FIGURES
        ],
        "nodes": [node for node in nodes if len(set(node["outcomes"])) > 1],
        "found_by_all": len(set.intersection(*found)),
        "missed_by_all": len(set.intersection(*missed)),
        "found_only_by": [
            sorted(mine - set().union(*(other for other in found if other is not mine))) for mine in found
        ],
        "warnings": _warnings(reports, runs),
    }


def write_comparison(comparison: Mapping[str, Any], reports: Sequence[Mapping[str, Any]], out: Path) -> None:
    """Write a comparison as a page, or the curves of all runs over D as a picture.

    Parameters
    ----------
    comparison
        What `compare_reports` returned.
    reports
        Contents of each `report.json`, in the order of the runs.
    out
        ``.html``, ``.svg`` or ``.png``; an older file of that name is replaced.

    Raises
    ------
    ConfigError
        The format is unknown, or `out` is a file that makes up a result folder.
    OutputError
        The file could not be written.
    """
    from interloc.evaluation.figures import comparison_figure  # noqa: PLC0415 - slow to import

    suffix = out.suffix.lower()
    if suffix not in {".html", ".svg", ".png"}:
        raise ConfigError(f"{out}: unknown format {out.suffix!r}. Expected one of .html, .svg, .png.")
    refuse_result_file(out)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")  # of a name; the page has it in full
        content = image(comparison_figure(comparison["runs"], reports), "png" if suffix == ".png" else "svg")
    if suffix == ".html":
        picture = data_address(content, "image/svg+xml")
        made_up = all(report["osm"].get("made_up", False) for report in reports)
        page: str = template("compare.html").render(
            comparison=comparison, drive=reports[0]["drive"], picture=picture, made_up=made_up
        )
        content = page.encode()
    write_file(out, content)


def differing_inputs(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return what runs read that differs, as ``{"name": "labels", "values": ["labels", "network salsanext"]}``."""
    return _differing([{name: run.get(key) for name, key in _INPUTS.items()} for run in runs])


def differing_settings(runs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the settings in which runs differ, as ``{"name": "bev.resolution_m", "values": [...]}``."""
    return _differing([dict(flatten(settings_of(run))) for run in runs])


_INPUTS = {"drive": "drive_name", "labels": "labels", "georeference": "georeference"}
"""What `compare_reports` calls an input -> where `run.json` has it; the map is that of the report."""


def _differing(flat: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    names = dict.fromkeys(name for each in flat for name in each)
    rows = [{"name": name, "values": [each.get(name) for each in flat]} for name in names]
    return [row for row in rows if any(value != row["values"][0] for value in row["values"])]


def _node(osm_id: int, outcomes: Sequence[Mapping[int, Mapping[str, Any]]]) -> dict[str, Any]:
    rows = [table.get(osm_id) for table in outcomes]
    known = next(row for row in rows if row is not None)
    return {
        "osm_id": osm_id,
        "lon": known["lon"],
        "lat": known["lat"],
        "degree": known["degree"],
        "outcomes": [_outcome(row) for row in rows],
        "median_error_m": [None if row is None else row["median_error_m"] for row in rows],
    }


def _outcome(row: Mapping[str, Any] | None) -> str:
    if row is None or not row["in_zone"]:
        return "outside"
    return str(row.get("outcome") or ("found" if row["found"] else "missed"))  # versions before had none


_FIGURES: tuple[tuple[str, str, Callable[[Mapping[str, Any]], Any]], ...] = (
    ("map_right", "intersections right", lambda report: report["map_level"]["true"]),
    ("map_wrong", "intersections wrong", lambda report: report["map_level"]["false"]),
    (
        "map_nodes_found",
        "OSM nodes found",
        lambda report: report["map_level"]["nodes_in_zone"] - report["map_level"]["missed"],
    ),
    ("map_median_m", "median error of intersections [m]", lambda report: report["map_level"]["median_m"]),
    ("map_precision", "precision of intersections", lambda report: report["map_level"]["precision"]),
    ("map_recall", "recall of intersections", lambda report: report["map_level"]["recall"]),
    ("map_mean_m", "mean error of intersections [m]", lambda report: report["map_level"]["mean_m"]),
    ("keyframes", "keyframes", lambda report: report["keyframes"]),
    ("detections", "detections", lambda report: report["detections"]),
    ("ace_m", "mean error of detections (ACE) [m]", lambda report: report["ace_m"]),
    ("median_m", "median error of detections [m]", lambda report: report["median_m"]),
    ("p95_m", "95 % of detections within [m]", lambda report: report["p95_m"]),
    ("precision_at_5", "precision, D = 5 m", lambda report: report["precision"][_STANDARD]),
    ("recall_at_5", "recall, D = 5 m", lambda report: report["recall"][_STANDARD]),
    ("f1_at_5", "F1, D = 5 m", lambda report: report["f1"][_STANDARD]),
    ("nodes_in_zone", "OSM nodes in the zone", lambda report: report["nodes_in_zone"]),
    ("nodes_found", "OSM nodes with a detection within 5 m", lambda report: report["nodes_found"]),
)


def _warnings(reports: Sequence[Mapping[str, Any]], runs: Sequence[Mapping[str, Any]]) -> list[str]:
    notes = []
    for what, values in (
        ("drives", [run.get("drive_name") for run in runs]),
        ("ground truth policies", [report["policy"] for report in reports]),
        ("maps", [report["osm"]["source"] for report in reports]),
        ("dates of the map", [report["osm"]["date"] for report in reports]),
        ("numbers of keyframes", [report["keyframes"] for report in reports]),
    ):
        if len({str(value) for value in values}) > 1:
            listed = ", ".join(str(value) for value in values)
            notes.append(f"The runs have different {what} ({listed}): their figures cannot be compared.")
    return notes
