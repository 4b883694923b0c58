"""`interloc export`."""

from pathlib import Path
from typing import Literal

import click

from interloc.cli import console, options


@click.command(short_help="Write a result as GeoPackage, project of QGIS, KMZ, PMTiles, CSV and other formats.")
@click.argument("result", type=options.PATH)
@click.option(
    "-o",
    "--out",
    required=True,
    type=options.Place(path_type=Path, dir_okay=False),
    help="File to write; its name ends in .gpkg, .qgz, .kmz, .fgb, .kml, .csv, .geojson, .parquet or .pmtiles, "
    "in .tif for the layer road, or for the roads in .nav2.geojson (Nav2), .osm (Lanelet2) or .xodr (OpenDRIVE).",
)
@click.option(
    "--layer",
    help="Only this layer, such as detections or road; also branches and uncertainty, made of the intersections. "
    "[default: all in a .gpkg, .qgz or .kmz, road in a .tif, else intersections]",
)
@click.option(
    "--traffic",
    type=click.Choice(["right", "left"]),
    show_default="that of the place",
    help="Side of traffic, for Nav2, Lanelet2 and OpenDRIVE.",
)
@options.OUTPUT
def command(result: Path, out: Path, layer: str | None, traffic: Literal["right", "left"] | None) -> None:
    """Write RESULT, the result folder of `interloc run`, as one file for other programs.

    A .qgz is a project of QGIS with its data inside, which draws the layers as the page does, as
    QGIS does with a .gpkg; a .kmz is for Google Earth. The layer road is the road seen by LiDAR, a raster; it needs no
    georeference. Robots, vehicles and simulators read the roads as a route graph of Nav2, a map of Lanelet2, or
    OpenDRIVE; their lanes are assumed from the widths, one-way streets are those of the map it was scored against.

    \b
    Example:
      interloc export out -o out.gpkg
      interloc export out -o out.qgz
      interloc export out -o matches.kml --layer matches
      interloc export out -o intersections.csv
      interloc export out -o map.pmtiles
      interloc export out -o road.tif
      interloc export out -o roads.xodr
    """
    from interloc.output.read import read_run
    from interloc.output.road import RASTER_SUFFIXES, ROAD_LAYER, export_road
    from interloc.output.road_files import road_ending, write_road_file
    from interloc.output.vector_files import PLACE_IT, is_local, write_vector_file

    read_run(result)  # or say that it is no result
    assumed = None
    if layer is None and road_ending(out) is not None:
        assumed = write_road_file(result, out, traffic)
        layers = ["roads"]
    elif layer == ROAD_LAYER or (layer is None and out.suffix.lower() in RASTER_SUFFIXES):
        export_road(result, out)
        layers = [ROAD_LAYER]
    else:
        layers = write_vector_file(result, out, layer=layer)
    facts = [("file", str(out)), ("layers", ", ".join(layers))]
    if assumed is not None:
        facts.append(("assumed", assumed))
    if is_local(result):
        facts.append(("place", f"none: metres in the frame of the first scan. {PLACE_IT}"))
    console.say({"file": str(out), "layers": layers}, facts)
