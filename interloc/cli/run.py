"""`interloc run`."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import console, options
from interloc.errors import Beside

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drives.folder import FolderDrive
    from interloc.drives.options import DriveOptions
    from interloc.osm.graph import RoadGraph
    from interloc.results import DriveResult


@click.command(cls=options.Command, short_help="Find the intersections along a drive; with a map, score them.")
@options.DRIVE
@options.INPUT
@options.METHOD
@options.WORKERS
@options.TRUTH
@options.PLACING
@options.OUT
@options.OUTPUT
def run(
    drive: Path,
    reading: DriveOptions,
    config: DetectorConfig,
    workers: int | None,
    truth: options.Truth,
    placing: options.Placing,
    out: Path,
) -> None:
    """Find the intersections along DRIVE. With a map they are scored, and the report is OUT/report.html.

    \b
    Example:
      interloc run sequences/07 -o out                                           without a map
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --oxts 2011_09_30_drive_0027_sync
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --locate          without GNSS
      interloc run drive.mcap -o out --osm karlsruhe.osm.pbf --near 49.01,8.43   points and poses alone
    """
    from interloc.drives.open import open_to_check
    from interloc.output.layout import result_folder
    from interloc.pipeline import detect

    locate = placing.locate or placing.near is not None
    has_map = truth.is_given or locate
    if has_map:
        truth.check()
    source, check = open_to_check(drive, reading)
    if placing.near is not None and not placing.locate and source.georeference is not None:
        locate = False
        console.note("--near is not used: the drive has a georeference (--locate leaves that out)")
    if has_map and not locate and source.georeference is None:  # before any long work starts
        check()
        raise options.no_georeference(
            source.name,
            "place it by its roads (`interloc run --locate`), or leave the map out: intersections are found without.",
        )
    graph = None

    def meanwhile() -> None:
        nonlocal graph
        check()
        graph = _read_map(source, config, truth, placing if locate else None)
        _load_what_writes(is_georeferenced=source.georeference is not None)

    beside, report = Beside(), None
    with result_folder(out) as folder:
        if locate:
            source = source.without_georeference()
        with console.progress("detect", "keyframe") as bar:
            result = scored = detect(source, config, workers=workers, progress=bar, meanwhile=meanwhile)
        from interloc.output.write import write_results

        if locate and graph is not None:
            result, scored = _place(result, source, graph, truth, placing, folder)
        network = write_results(result, folder, beside=beside)
        if has_map:
            with beside.part("the score"):
                from interloc.evaluation.evaluate import evaluate
                from interloc.evaluation.report import write_report

                graph = options.fetch_roads(result.keyframes.degrees) if graph is None else graph
                roads = network if scored is result else None
                evaluation = evaluate(scored, graph, policy=truth.policy, tolerance_m=truth.tolerance_m, network=roads)
                report = write_report(evaluation, folder, result=result, beside=beside)
    facts = console.run_facts(result, out)
    if not has_map:
        facts += [*console.doubt_facts(result), ("not scored", options.no_map(result))]
    if report is not None:
        first, *others = console.report_facts(report, out)
        facts = [first, *facts[:-1], *others]
    console.say({"run": console.run_summary(result, out), "report": report}, facts)
    beside.check(out)


def _load_what_writes(*, is_georeferenced: bool) -> None:
    """Have ready what the result is made with once all keyframes are done: it is slow to load."""
    for module in ("interloc.output.write", "interloc.roadmap.extract", "numpy.fft", "tifffile"):
        import_module(module)
    if is_georeferenced:
        import_module("pyproj")
    from interloc.kernels.streets import compile_for_streets
    from interloc.results import versions

    versions()
    compile_for_streets()


def _read_map(
    drive: FolderDrive, config: DetectorConfig, truth: options.Truth, placing: options.Placing | None
) -> RoadGraph | None:
    """Return the map that needs no result: around the keyframes, or around the place where the drive is looked for."""
    if placing is not None:
        return placing.read_map(truth.osm)
    if truth.osm is None:
        return None
    from interloc.detection.keyframes import select_keyframes

    assert drive.georeference is not None
    rows = select_keyframes(drive.T_world_lidar, config.keyframes)
    return options.read_map(truth.osm, drive.georeference.lonlat[rows])


def _place(
    result: DriveResult,
    drive: FolderDrive,
    graph: RoadGraph,
    truth: options.Truth,
    placing: options.Placing,
    folder: Path,
) -> tuple[DriveResult, DriveResult]:
    """Return the run placed on the map, and the fair copy of it to score."""
    from interloc.localization.apply import place_run, write_places

    with console.progress("locate", "place") as bar:
        placed = place_run(
            result,
            drive,
            graph,
            policy=truth.policy,
            tolerance_m=truth.tolerance_m,
            near=placing.near,
            radius_m=placing.radius_m,
            progress=bar,
        )
    write_places(placed, graph, folder)
    return placed.result, placed.scored
