"""The roads of a result as files for robots, vehicles and simulators."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from interloc.errors import GeoreferenceError
from interloc.files import write_file
from interloc.output.lanelet2 import lanelet2_map
from interloc.output.nav2 import nav2_graph
from interloc.output.opendrive import opendrive_map
from interloc.output.read import read_results
from interloc.output.roads import roads
from interloc.output.vector_files import PLACE_IT
from interloc.roadmap.network import RoadNetwork

ROAD_FORMATS: dict[str, Callable[[RoadNetwork, str], bytes]] = {
    ".nav2.geojson": lambda network, _: nav2_graph(network),
    ".osm": lambda network, _: lanelet2_map(network),
    ".xodr": opendrive_map,
}
"""Ending -> format: route graph of Nav2, map of Lanelet2, OpenDRIVE."""


def road_ending(out: Path) -> str | None:
    """Return which of `ROAD_FORMATS` a file name asks for."""
    return next((ending for ending in ROAD_FORMATS if out.name.lower().endswith(ending)), None)


def write_road_file(result: Path, out: Path) -> None:
    """Write the roads of a result folder; they are made of its `road.tif`.

    Parameters
    ----------
    result
        Result folder.
    out
        A name with one of the endings of `ROAD_FORMATS`.

    Raises
    ------
    GeoreferenceError
        The result is in local metres, and Lanelet2 knows longitude and latitude only.
    OutputError
        `result` is not a result folder, or `out` could not be written.
    """
    ending = road_ending(out)
    assert ending is not None
    run = read_results(result)
    if ending == ".osm" and not run.is_georeferenced:
        raise GeoreferenceError(
            f"{result} is in metres of its own frame, and Lanelet2 knows longitude and latitude only: the drive has no "
            f"georeference. {PLACE_IT}, or write a .xodr or .nav2.geojson, in metres."
        )
    content = ROAD_FORMATS[ending](roads(run), run.drive)
    write_file(out, content)
