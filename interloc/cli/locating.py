"""What the commands that place a drive on a map share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.files import write_file

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drive import Drive
    from interloc.localization.locate import Location
    from interloc.osm.graph import RoadGraph
    from interloc.results import DriveResult


class Numbers(click.ParamType):  # type: ignore[type-arg, unused-ignore] # generic in the newest click only
    """Numbers with commas between them: 49.01,8.43."""

    def __init__(self, *names: str) -> None:
        self.name = ",".join(names)
        self._count = len(names)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Read them, or fail with what was expected."""
        if isinstance(value, tuple):
            return value
        parts = str(value).split(",")
        try:
            numbers = tuple(float(part) for part in parts)
        except ValueError:
            numbers = ()
        if len(numbers) != self._count:
            self.fail(f"{value!r} is not {self.name}: {self._count} numbers with commas between them.", param, ctx)
        return numbers


locate_option = click.option(
    "--locate",
    is_flag=True,
    help="Place the drive on the map by its roads; a georeference is not used. --near does that where there is none.",
)

near_options = options.together(
    click.option(
        "--near",
        type=Numbers("LAT", "LON"),
        metavar="LAT,LON",
        help="Search only around here; with --radius.",
    ),
    click.option(
        "--radius", "radius_km", type=click.FloatRange(min=0.1), help="How far around --near, km.  [default: 3]"
    ),
)
"""Where to search."""


def search_area(
    near: tuple[float, float] | None, radius_km: float | None
) -> tuple[tuple[float, float] | None, float | None]:
    """Return `near` and `radius_m` of `locate` by the values of `near_options`."""
    if near is not None:
        return near, 1000.0 * (3.0 if radius_km is None else radius_km)
    if radius_km is not None:
        raise click.UsageError("--radius says how far around --near to search; give --near too")
    return None, None


def fetch_map_around(near: tuple[float, float] | None, radius_m: float | None) -> RoadGraph:
    """Fetch the map to search from Overpass."""
    import numpy as np

    if near is None or radius_m is None:
        raise click.UsageError("the map of which place is to be fetched? Say it by --near LAT,LON, or give --osm FILE")
    return options.fetch_roads(np.array([near[::-1]]), margin_m=radius_m)


def locate_drive(
    drive: Drive,
    graph: RoadGraph,
    config: DetectorConfig,
    *,
    near: tuple[float, float] | None,
    radius_m: float | None,
    workers: int | None,
    track_only: bool,
) -> tuple[DriveResult | None, Location]:
    """Find the intersections along a drive without georeference, and place it on a map.

    Returns
    -------
    DriveResult or None
        None where the drive is too short to be placed, or only its track was to be used.
    Location
    """
    from interloc.localization.decision import MIN_LENGTH_M
    from interloc.localization.locate import locate
    from interloc.localization.track import track_of
    from interloc.pipeline import detect

    result = None
    if not track_only and track_of(drive.T_world_lidar).length_m >= MIN_LENGTH_M:
        with console.progress("detect", "keyframe") as bar:
            result = detect(drive, config, workers=workers, progress=bar)
    with console.progress("locate", "place") as bar:
        location = locate(drive, graph, result=result, near=near, radius_m=radius_m, progress=bar)
    return result, location


def location_facts(location: Location) -> list[tuple[str, str]]:
    """Return names and values for a person."""
    facts = location.facts
    best = location.places[0]
    assert location.position_std_m is not None
    assert location.heading_std_deg is not None
    evidence = (
        f"{100 * best.evidence.road:.0f} % of {facts['length_m']:.0f} m on roads, {best.evidence.at_nodes} of "
        f"{best.evidence.seen} intersections seen are on the map, {best.evidence.missed} of {best.evidence.passed} "
        "passed were not seen"
    )
    uncertainty = (
        f"{median(location.position_std_m):.1f} m, {median(location.heading_std_deg):.1f} degrees "
        "(one sigma, median; errors of the map included)"
    )
    return [
        ("found", location.decision.reason),
        ("first scan", f"{best.lonlat[1]:.6f},{best.lonlat[0]:.6f}, heading {best.heading_deg:.1f} degrees"),
        ("evidence", evidence),
        ("uncertainty", uncertainty),
        ("map", f"{facts['map']}: {facts['map_km']:g} km of roads"),
        ("time", f"{facts['seconds']:.1f} s"),
    ]


def write_figure(location: Location, graph: RoadGraph, drive: str, path: Path) -> None:
    """Draw a location into a .png or .svg file."""
    from interloc.drawing import image
    from interloc.localization.figures import location_figure

    figure = location_figure(location, graph, drive)
    write_file(path, image(figure, "svg" if path.suffix.lower() == ".svg" else "png"))


def median(values: Any) -> float:
    """Return the median of an array."""
    import numpy as np

    return float(np.median(values))
