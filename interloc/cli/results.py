"""`interloc evaluate`, `compare`, `explain` and `export`: what is done with a drive or a result that is there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from interloc.cli import console, options
from interloc.errors import Beside, ConfigError
from interloc.files import write_file
from interloc.wording import counted


@click.command(cls=options.Command, short_help="Score a result against OpenStreetMap.")
@click.argument("out", type=options.PATH)
@options.TRUTH
@options.OUTPUT
def evaluate(out: Path, truth: options.Truth) -> None:
    """Score OUT, the result folder of `interloc run`, against OpenStreetMap.

    \b
    Example:
      interloc evaluate out --osm map.osm.gz
    """
    from interloc.evaluation.evaluate import evaluate
    from interloc.evaluation.report import write_report
    from interloc.output.layout import RUN_NAMES, result_folder
    from interloc.output.read import read_results

    truth.check()
    result = read_results(out)
    graph = options.read_map(truth.osm, result.keyframes.lonlat)
    if graph is None:
        graph = options.fetch_roads(result.keyframes.degrees)
    evaluation = evaluate(result, graph, policy=truth.policy, tolerance_m=truth.tolerance_m)
    beside = Beside()
    with result_folder(out) as folder:  # the whole new report, or the folder as it was
        for name in filter(lambda name: (out / name).is_file(), RUN_NAMES):
            write_file(folder / name, (out / name).read_bytes())
        report = write_report(evaluation, folder, beside=beside)
    console.say(report, console.report_facts(report, out))
    beside.check(out)


@click.command(short_help="Put the reports of several results side by side.")
@click.argument("results", nargs=-1, required=True, type=options.PATH)
@options.JSON
def compare(results: tuple[Path, ...]) -> None:
    """Show in which inputs and settings RESULTS differ, their figures, and which intersections only one of them found.

    RESULTS are two or more result folders of `interloc run` over one drive.

    \b
    Example:
      interloc compare out_default out_paper
    """
    from interloc.evaluation.compare import compare_reports
    from interloc.evaluation.record import REPORT_FILE, read_report
    from interloc.output.read import read_run

    names = [console.shown(str(result)) for result in results]
    runs = [read_run(result) for result in results]
    for result in results:
        if not (result / REPORT_FILE).is_file():
            raise ConfigError(
                f"{result} was not scored against a map: `interloc evaluate {result} --osm FILE` does that"
            )
    reports = [read_report(result) for result in results]
    comparison = compare_reports(names, reports, runs)
    if console.wants_json():
        console.say_json(comparison.model_dump())
        return
    for name, report in zip(names, reports, strict=True):
        click.echo(f"{name}: {report['map_line']}")
    click.echo()
    _print_table(["", *names], [[row.title, *map(_text, row.values)] for row in comparison.figures])
    _print_table(["input", *names], [[row.name, *map(_text, row.values)] for row in comparison.inputs])
    _print_table(["setting", *names], [[row.name, *map(_text, row.values)] for row in comparison.settings])
    if not comparison.settings:
        click.echo("the same settings\n")
    found, missed = comparison.found_by_all, comparison.missed_by_all
    click.echo(f"{counted(found, 'OSM node')} found by all, {counted(missed, 'OSM node')} missed by all")
    for name, only in zip(names, comparison.found_only_by, strict=True):
        click.echo(f"only {name}: {len(only)}" + (f" ({', '.join(map(str, only[:20]))})" if only else ""))
    for warning in comparison.warnings:
        click.echo(f"note: {warning}")


def _print_table(head: list[str], rows: list[list[str]]) -> None:
    """Print a table, where it has rows, and an empty line."""
    if not rows:
        return
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    for row in [head, *rows]:
        first, *rest = (
            text.ljust(w) if i == 0 else text.rjust(w) for i, (text, w) in enumerate(zip(row, widths, strict=True))
        )
        click.echo("  ".join([first, *rest]).rstrip())
    click.echo()


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else str(value)


if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drives.options import DriveOptions
    from interloc.osm.policies import Policy


@click.command(cls=options.Command, short_help="Draw the steps of the method for one keyframe.")
@options.DRIVE
@click.option("--frame", required=True, type=int, help="Scan number; the nearest keyframe is taken.")
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder for the sheet and explain.json.")
@options.INPUT
@options.METHOD
@click.option("--osm", type=options.PATH, help="OSM file to draw on top.")
@options.POLICY
@options.OUTPUT
def explain(
    drive: Path, frame: int, out: Path, reading: DriveOptions, config: DetectorConfig, osm: Path | None, policy: Policy
) -> None:
    """Draw the steps of the method for one keyframe of DRIVE on one sheet, and write the numbers behind them.

    \b
    Example:
      interloc explain sequences/07 --frame 300 -o steps
    """
    from interloc.drives.open import open_drive
    from interloc.explain import explain

    source = open_drive(drive, reading)
    graph = options.read_map(osm, None if source.georeference is None else source.georeference.lonlat)
    paths = explain(source, frame, config, out, graph=graph, policy=policy)
    files = [str(path) for path in paths]
    console.say({"files": files}, "\n".join(files))


@click.command(short_help="Write a result as GeoPackage, project of QGIS, KMZ, PMTiles, CSV and other formats.")
@click.argument("result", type=options.PATH)
@click.option(
    "-o",
    "--out",
    required=True,
    type=options.Place(path_type=Path, dir_okay=False),
    help="File to write; its name ends in .gpkg, .qgz, .kmz, .fgb, .kml, .csv, .geojson, .parquet or .pmtiles, "
    "or for the roads in .nav2.geojson (Nav2), .osm (Lanelet2) or .xodr (OpenDRIVE).",
)
@click.option(
    "--layer",
    help="Only this layer, such as detections, or all; branches and uncertainty are made of the intersections. "
    "[default: four in a .gpkg or .kmz, all in a .qgz, else intersections]",
)
@click.option(
    "--traffic",
    type=click.Choice(["right", "left"]),
    show_default="that of the place",
    help="Side of traffic, for Nav2, Lanelet2 and OpenDRIVE.",
)
@options.OUTPUT
def export(result: Path, out: Path, layer: str | None, traffic: Literal["right", "left"] | None) -> None:
    """Write RESULT, the result folder of `interloc run`, as one file for other programs.

    A .qgz is a project of QGIS with its data inside, which draws the layers as the page does, as QGIS does with a
    .gpkg; a .kmz is for Google Earth. The raster of the road seen by LiDAR is road.tif of RESULT. Robots, vehicles and
    simulators read the roads as a route graph of Nav2, a map of Lanelet2, or OpenDRIVE; their lanes are assumed from
    the widths, one-way streets are those of the map it was scored against.

    \b
    Example:
      interloc export out -o out.gpkg
      interloc export out -o out.qgz
      interloc export out -o matches.kml --layer matches
      interloc export out -o intersections.csv
      interloc export out -o map.pmtiles
      interloc export out -o roads.xodr
    """
    from interloc.output.read import read_run
    from interloc.output.road_files import road_ending, write_road_file
    from interloc.output.vector_files import PLACE_IT, is_local, write_vector_file

    read_run(result)  # or say that it is no result
    assumed = None
    if road_ending(out) is not None:
        if layer not in {None, "roads"}:
            raise ConfigError(
                f"{out}: it holds the roads, whatever the layer. Leave --layer out, or take another ending."
            )
        assumed = write_road_file(result, out, traffic)
        layers = ["roads"]
    else:
        layers = write_vector_file(result, out, layer=layer)
    facts = [("file", str(out)), ("layers", ", ".join(layers))]
    if assumed is not None:
        facts.append(("assumed", assumed))
    if is_local(result):
        facts.append(("place", f"none: metres in the frame of the first scan. {PLACE_IT}"))
    console.say({"file": str(out), "layers": layers, **dict(facts[2:])}, facts)
