"""The files of an evaluation: report.json, report.html, osm_nodes.geojson, matches.geojson, figures."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from interloc.drawing import image, metres, percent, write_image
from interloc.errors import OutputError
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.metrics import STANDARD_THRESHOLD_M
from interloc.evaluation.record import report_record, threshold_name
from interloc.files import atomic_write, reason_of
from interloc.osm.policies import POLICIES
from interloc.output.geojson import encode, point, positions, rounded, write_collection
from interloc.results import DriveResult

SETTINGS = ("config", "fusion")
"""What of `run.json` is settings; the rest is facts about the run."""


def write_report(evaluation: Evaluation, result: DriveResult, out_dir: Path) -> None:
    """Write the report of an evaluation into the result folder of its run.

    Parameters
    ----------
    evaluation
        Of `result`.
    result
        The run; its configuration and timings are part of the report.
    out_dir
        Folder of the run. Files of an older report are replaced, each whole or not at all.

    Raises
    ------
    OutputError
        The folder is missing, or a file could not be written.
    """
    if not out_dir.is_dir():
        raise OutputError(f"{out_dir}: no such folder. Expected the result folder of `interloc detect`.")
    pictures = _write_figures(evaluation, result, out_dir / "figures")
    write_collection(out_dir / "osm_nodes.geojson", _node_features(evaluation), local=False)
    write_collection(out_dir / "matches.geojson", _match_features(evaluation), local=False)
    record = report_record(evaluation)
    with atomic_write(out_dir / "report.html") as handle:
        handle.write(render_html(record, result, pictures).encode())
    with atomic_write(out_dir / "report.json") as handle:  # last: whoever waits for it finds the rest
        handle.write(encode(record, indent=2).encode() + b"\n")


def render_html(record: dict[str, Any], result: DriveResult, pictures: dict[str, str]) -> str:
    """Return the page of a report as one file that asks no server for anything.

    Parameters
    ----------
    record
        What `report_record` returned.
    pictures
        Data addresses of the figures `map`, `errors` and `thresholds`.
    """
    standard = threshold_name(STANDARD_THRESHOLD_M)
    nodes = sorted(
        record["nodes"],
        key=lambda n: (not n["in_zone"], n["found"], -(n["median_error_m"] or 0.0)),
    )
    page: str = template("report.html").render(
        record=record,
        at={name: record[name][standard] for name in ("tp", "fp", "fn", "precision", "recall", "f1")},
        standard=standard,
        threshold=f"{STANDARD_THRESHOLD_M:g}\N{NO-BREAK SPACE}m",
        policy_meaning=POLICIES[record["policy"]].meaning,
        nodes=nodes,
        pictures=pictures,
        # Read by people only, so what JSON does not know may appear as its text.
        config=json.dumps(_settings(result.run), indent=2, default=str),
        facts=_flatten({key: value for key, value in result.run.items() if key not in SETTINGS}),
    )
    return page


def _settings(run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a run; those of the fusion stood beside the others in older ones."""
    beside = {key: run[key] for key in ("fusion",) if key not in run.get("config", {}) and key in run}
    return {**run.get("config", {}), **beside}


def template(name: str) -> Any:  # noqa: ANN401 - jinja2 is imported late
    """Return a page template of this package, with our ways to say numbers as filters."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - slow to import

    environment = Environment(
        loader=PackageLoader("interloc.evaluation"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"percent": percent, "metres": metres}
    return environment.get_template(name)


def data_address(content: bytes, mime_type: str) -> str:
    """Return bytes as an address that a page can show without asking a server."""
    return f"data:{mime_type};base64,{base64.b64encode(content).decode()}"


def make_folder(folder: Path) -> None:
    """Create a folder inside a result folder.

    Raises
    ------
    OutputError
        It cannot be created.
    """
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder} could not be created: {reason_of(error)}.") from error


def _write_figures(evaluation: Evaluation, result: DriveResult, folder: Path) -> dict[str, str]:
    from interloc.evaluation.figures import error_figure, map_figure, threshold_figure  # noqa: PLC0415 - slow to import

    make_folder(folder)
    pictures = {}
    for name, figure in (
        ("map", map_figure(evaluation, result)),
        ("errors", error_figure(evaluation)),
        ("thresholds", threshold_figure(evaluation)),
    ):
        png, svg = image(figure, "png"), image(figure, "svg")
        write_image(folder / f"{name}.png", png)
        write_image(folder / f"{name}.svg", svg)
        # Thousands of marks are smaller and faster as pixels; curves are sharper as curves.
        pictures[name] = data_address(png, "image/png") if name == "map" else data_address(svg, "image/svg+xml")
    return pictures


def _node_features(evaluation: Evaluation) -> list[dict[str, Any]]:
    nodes, table = evaluation.nodes, evaluation.node_table
    return [
        point(
            position,
            {
                "osm_id": int(nodes.osm_id[row]),
                "degree": int(nodes.degree[row]),
                "in_zone": bool(table.in_zone[row]),
                "found": bool(table.found[row]),
                "keyframes_in_zone": int(table.zone_keyframes[row]),
                "keyframes_missed": int(table.missed_keyframes[row]),
                "detections": int(table.detections[row]),
                "median_error_m": rounded(table.median_error_m[row], 4),
            },
        )
        for row, position in enumerate(positions(nodes.lonlat, local=False))
    ]


def _match_features(evaluation: Evaluation) -> list[dict[str, Any]]:
    detections, matching = evaluation.detections, evaluation.matching
    assert detections.lonlat is not None
    seen = positions(detections.lonlat, local=False)
    truth = positions(evaluation.nodes.lonlat, local=False)
    return [
        {
            "type": "Feature",
            "geometry": {"type": "LineString", "coordinates": [seen[row], truth[matching.node[row]]]},
            "properties": {
                "frame": int(evaluation.keyframes.frame[detections.keyframe[row]]),
                "error_m": rounded(matching.error_m[row], 4),
                "outcome": "TP" if matching.error_m[row] < STANDARD_THRESHOLD_M else "FP",
                "osm_id": int(evaluation.nodes.osm_id[matching.node[row]]),
            },
        }
        for row in np.flatnonzero(matching.is_matched).tolist()
    ]


def _flatten(value: object, name: str = "") -> list[tuple[str, str]]:
    """Turn nested values into rows of a table: ("versions.interloc", "0.1.0")."""
    if isinstance(value, dict):
        return [row for key, each in value.items() for row in _flatten(each, f"{name}.{key}" if name else str(key))]
    if isinstance(value, list | tuple):
        return [(name, ", ".join(str(each) for each in value))]
    if name.endswith("_bytes") and isinstance(value, int):
        return [(name.removesuffix("_bytes"), f"{value / 1e6:,.0f} MB")]
    return [(name, f"{value:.4g}" if isinstance(value, float) else str(value))]
