"""`interloc run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options, summary

if TYPE_CHECKING:
    from interloc.drives.folder import FolderDrive
    from interloc.osm.graph import RoadGraph
    from interloc.osm.policies import Policy
    from interloc.results import DriveResult


@click.command(cls=options.Command, short_help="Find the intersections along a drive; with a map, score them.")
@options.evaluation_options
@options.locate_option
@options.near_options
def command(
    drive: Path,
    out: Path,
    policy: Policy,
    tolerance_m: float,
    workers: int | None,
    locate: bool,
    near: tuple[float, float] | None,
    radius_km: float | None,
    **given: Any,
) -> None:
    """Find the intersections along DRIVE. With a map they are scored, and the report is OUT/report.html.

    \b
    Example:
      interloc run sequences/07 -o out                                           without a map
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --oxts 2011_09_30_drive_0027_sync
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --locate          without GNSS
      interloc run drive.mcap -o out --osm karlsruhe.osm.pbf --near 49.01,8.43   points and poses alone
    """
    from interloc.errors import Beside
    from interloc.output.layout import result_folder
    from interloc.output.write import write_results
    from interloc.pipeline import detect

    search = options.search_area(near, radius_km)
    may_locate = locate or near is not None
    has_map = given["osm"] is not None or given["overpass"] or may_locate
    source, config, graph = options.open_for_evaluation(
        drive, needs_georeference=has_map and not may_locate, needs_map=has_map, **given
    )
    if near is not None and not locate:
        locate = source.georeference is None
        if not locate:
            console.note("--near is not used: the drive has a georeference (--locate leaves that out)")
    if locate and graph is None:
        graph = options.fetch_map_around(*search)
    beside, report = Beside(), None
    with result_folder(out) as folder:
        if locate:
            source = source.without_georeference()
        with console.progress("detect", "keyframe") as bar:
            result = scored = detect(source, config, workers=workers, progress=bar)
        if locate and graph is not None:
            result, scored = _place(result, source, graph, policy, tolerance_m, search, folder)
        network = write_results(result, folder, beside=beside)
        if has_map:
            with beside.part("the score"):
                from interloc.evaluation.evaluate import evaluate
                from interloc.evaluation.report import write_report

                graph = options.fetch_map(result) if graph is None else graph
                roads = network if scored is result else None
                evaluation = evaluate(scored, graph, policy=policy, tolerance_m=tolerance_m, network=roads)
                report = write_report(evaluation, folder, result=result, beside=beside)
    facts = summary.run_facts(result, out)
    if not has_map:
        facts += [*summary.doubt_facts(result), ("not scored", options.no_map(result))]
    if report is not None:
        first, *others = summary.report_facts(report, out)
        facts = [first, *facts[:-1], *others]
    console.say({"run": summary.run_summary(result, out), "report": report}, facts)
    beside.check(out)


def _place(
    result: DriveResult,
    drive: FolderDrive,
    graph: RoadGraph,
    policy: Policy,
    tolerance_m: float,
    search: tuple[tuple[float, float] | None, float | None],
    folder: Path,
) -> tuple[DriveResult, DriveResult]:
    """Return the run placed on the map, and the fair copy of it to score."""
    from interloc.localization.placing import place_run, write_places

    near, radius_m = search
    with console.progress("locate", "place") as bar:
        placed = place_run(
            result,
            drive,
            graph,
            policy=policy,
            tolerance_m=tolerance_m,
            near=near,
            radius_m=radius_m,
            progress=bar,
        )
    write_places(placed, graph, folder)
    return placed.result, placed.scored
