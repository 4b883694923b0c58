"""`interloc locate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.errors import ConfigError

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drive import Drive, Georeference
    from interloc.drives.options import DriveOptions
    from interloc.localization.locate import Location


@click.command(cls=options.Command, short_help="Place a drive on the map without GNSS.")
@options.DRIVE
@options.INPUT
@options.METHOD
@options.WORKERS
@options.OSM
@options.NEAR
@click.option(
    "--gpx", type=options.PATH, help="Place the drive by the track of a phone or a watch that was along, by time."
)
@click.option(
    "-o",
    "--out",
    type=options.PATH,
    help="geo.csv to write, a new file: put it into the drive, or give it with --oxts.",
)
@click.option("--overwrite", is_flag=True, help="Let -o replace a file that is there already.")
@click.option("--track-only", is_flag=True, help="Do not look for intersections: the trajectory alone.")
@options.OUTPUT
def locate(
    drive: Path,
    reading: DriveOptions,
    config: DetectorConfig,
    workers: int | None,
    osm: Path | None,
    placing: options.Placing,
    gpx: Path | None,
    out: Path | None,
    overwrite: bool,
    track_only: bool,
) -> None:
    """Place DRIVE on a road map by its trajectory and its intersections; a georeference that it has is not used.

    \b
    Examples:
      interloc locate sequences/07 --osm karlsruhe.osm.pbf -o geo.csv
      interloc locate sequences/07 --osm germany.osm.pbf --near 49.01,8.43 --radius 5 -o geo.csv
      interloc locate sequences/07 --gpx watch.gpx -o geo.csv

    Exit code 1 where the place is ambiguous or was not found: then no geo.csv is written.
    """
    from interloc.drives.open import open_drive
    from interloc.localization.apply import require_found
    from interloc.localization.evidence import MIN_LENGTH_M
    from interloc.localization.locate import locate
    from interloc.localization.track import track_of
    from interloc.pipeline import detect

    if (osm is None) == (gpx is None):
        raise click.UsageError("say where to look, in one way: the map by --osm FILE, or a track by --gpx FILE")
    if osm is None and (placing.near or track_only):
        raise click.UsageError("--near, --radius and --track-only belong to --osm")
    if out is not None and out.exists() and not overwrite:  # before any long work starts
        raise ConfigError(
            f"{out} is there already, and was not touched: it may be the drive's own. Give another name (-o), or "
            "--overwrite to replace it."
        )
    source = open_drive(drive, reading).without_georeference()
    if gpx is not None:
        _place_by_gpx(source, gpx, out)
        return
    graph = placing.read_map(osm)
    result = None
    if not track_only and track_of(source.T_world_lidar).length_m >= MIN_LENGTH_M:
        with console.progress("detect", "keyframe") as bar:
            result = detect(source, config, workers=workers, progress=bar)
    with console.progress("locate", "place") as bar:
        location = locate(source, graph, result=result, near=placing.near, radius_m=placing.radius_m, progress=bar)
    if console.wants_json():
        console.say_json({"drive": source.name, **location.record()})
    written = _write(out, source, require_found(location, source.name))
    if not console.wants_json():
        fair = ("to score it", "by the same map `interloc run --locate` is fairer: it leaves out what placed each node")
        console.say_facts([*_facts(location), *written, fair])


def _write(out: Path | None, drive: Drive, georeference: Georeference) -> list[tuple[str, str]]:
    """Write the geo.csv, if one is asked for, and return what to say of it."""
    from interloc.drives.georeference.read import write_geo_csv

    if out is None:
        return []
    write_geo_csv(out, drive.frames, georeference)
    return [("written to", str(out))]


def _place_by_gpx(drive: Drive, gpx: Path, out: Path | None) -> None:
    from interloc.localization.gpx import georeference_by_gpx, read_gpx

    placed = georeference_by_gpx(drive, read_gpx(gpx))
    source, std_m = placed.georeference.source, round(_median(placed.georeference.position_std_m), 1)
    uncertainty = f"{std_m} m (one sigma, median; what all fixes of a phone share included)"
    uncertainty += f"; {placed.doubts}" if placed.doubts else ""
    facts = {"rms_m": round(placed.rms_m, 1), "clock_late_s": round(placed.late_s, 2), "position_std_m": std_m}
    fit = f"{facts['rms_m']} m from the track before it was bent onto it"
    console.say(
        {"drive": drive.name, "georeference": source, "uncertainty": uncertainty, **facts},
        [
            *(("placed by", source), ("fit", fit), ("uncertainty", uncertainty)),
            *_write(out, drive, placed.georeference),
        ],
    )


def _facts(location: Location) -> list[tuple[str, str]]:
    """Return names and values for a person."""
    facts, best = location.facts, location.places[0]
    evidence = (
        f"{100 * best.evidence.road:.0f} % of {facts['length_m']:.0f} m on roads, {best.evidence.at_nodes} of "
        f"{best.evidence.seen} intersections seen are on the map, {best.evidence.missed} of {best.evidence.passed} "
        "passed were not seen"
    )
    uncertainty = (
        f"{_median(location.position_std_m):.1f} m, {_median(location.heading_std_deg):.1f} degrees "
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


def _median(values: Any) -> float:
    import numpy as np

    return float(np.median(values))
