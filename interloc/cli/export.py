"""`interloc export`."""

from __future__ import annotations

from pathlib import Path

import click

from interloc.cli import console, options


@click.command(short_help="Write a result as GeoPackage, FlatGeobuf or KML.")
@click.argument("result", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="File to write; its name ends in .gpkg, .fgb or .kml.",
)
@click.option("--layer", help="Only this layer, such as detections. [default: all in a .gpkg, else intersections]")
@options.QUIET
@options.JSON
def command(result: Path, out: Path, layer: str | None, quiet: bool, as_json: bool) -> None:
    """Write RESULT, the result folder of `interloc detect` or `run`, as one file for QGIS or Google Earth.

    \b
    Example:
      interloc export out -o out.gpkg
      interloc export out -o matches.kml --layer matches
    """
    from interloc.output.vector_files import PLACE_IT, is_local, write_vector_file

    console.set_up_log(quiet=quiet)
    layers = write_vector_file(result, out, layer=layer)
    if as_json:
        console.say_json({"file": str(out), "layers": layers})
    elif not quiet:
        facts = [("file", str(out)), ("layers", ", ".join(layers))]
        if is_local(result):
            facts.append(("place", f"none: metres in the frame of the first scan. {PLACE_IT}"))
        console.say_facts(facts)
