"""`interloc run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, locating, options, summary

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drive import Drive
    from interloc.osm.graph import RoadGraph
    from interloc.osm.policies import Policy
    from interloc.results import DriveResult


@click.command(short_help="Detect, map and evaluate in one go.")
@options.evaluation_options
@click.option("--locate", is_flag=True, help="Place the drive on the map by its roads; a georeference is not used.")
@locating.near_options
def command(
    drive: Path,
    out: Path,
    policy: Policy,
    tolerance_m: float,
    workers: int | None,
    locate: bool,
    near: tuple[float, float] | None,
    radius_km: float | None,
    quiet: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Detect, map and evaluate DRIVE in one go; the report is OUT/report.html.

    \b
    Example:
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --oxts 2011_09_30_drive_0027_sync
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --locate          without GNSS
    """
    from interloc.evaluation.evaluate import evaluate
    from interloc.evaluation.report import report_record, write_report
    from interloc.output.layout import result_folder
    from interloc.output.write import write_results
    from interloc.pipeline import detect

    if near is not None and not locate:
        raise click.UsageError("--near and --radius belong to --locate")
    source, config, graph = options.open_for_evaluation(drive, quiet=quiet, needs_georeference=not locate, **given)
    with result_folder(out) as folder:
        if locate:
            if graph is None:
                raise click.UsageError("--locate searches a map: give it by --osm FILE")
            result, scored = _locate(
                locating.without_georeference(source),
                graph,
                config,
                policy=policy,
                near=near,
                radius_km=radius_km,
                workers=workers,
                quiet=quiet,
            )
            write_results(result, folder)
            evaluation = evaluate(scored, graph, policy=policy, tolerance_m=tolerance_m)
            write_report(evaluation, result, folder)
        else:
            with console.progress("detect", "keyframe", quiet=quiet) as bar:
                result = detect(source, config, workers=workers, progress=bar)
            write_results(result, folder)
            if graph is None:
                graph = options.fetch_map(result, quiet=quiet)
            evaluation = evaluate(result, graph, policy=policy, tolerance_m=tolerance_m)
            write_report(evaluation, result, folder)
    report = report_record(evaluation)
    if as_json:
        console.say_json({"run": summary.run_summary(result, out), "report": report})
    elif not quiet:
        console.say_facts(summary.run_facts(result, out)[:-1] + summary.report_facts(report, out))


def _locate(
    drive: Drive,
    graph: RoadGraph,
    config: DetectorConfig,
    *,
    policy: Policy,
    near: tuple[float, float] | None,
    radius_km: float | None,
    workers: int | None,
    quiet: bool,
) -> tuple[DriveResult, DriveResult]:
    """Return the run placed on the map, and the fair copy of it to score."""
    from interloc.localization.placing import FAIR, fair_result, place_result, require_found
    from interloc.osm.intersections import intersection_nodes

    result, location = locating.locate_drive(
        drive, graph, config, near=near, radius_km=radius_km, workers=workers, quiet=quiet, leave_one_out=True
    )
    georeference = require_found(location, drive.name)
    assert result is not None  # else the drive was too short to be found
    about = {"source": "map", **location.record(), "scored": FAIR}
    placed = place_result(result, drive, georeference, about)
    return placed, fair_result(placed, drive, location, intersection_nodes(graph, policy))
