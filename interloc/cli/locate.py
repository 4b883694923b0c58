"""`interloc locate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, locating, options

if TYPE_CHECKING:
    from interloc.drives.folder import FolderDrive


@click.command(cls=options.Command, short_help="Place a drive on the map without GNSS.")
@options.DRIVE
@options.OSM
@locating.near_options
@click.option(
    "--at",
    type=locating.Numbers("LAT", "LON", "HEADING_DEG"),
    metavar="LAT,LON,HEADING_DEG",
    help="Place the drive by this pose of the LiDAR instead of a map; heading clockwise from north.",
)
@click.option("--at-frame", type=int, help="Scan that has the pose of --at.  [default: the first]")
@click.option(
    "--gpx",
    type=options.PATH,
    help="Place the drive by the track of a phone or a watch that was along, by time or else by shape.",
)
@click.option(
    "-o",
    "--out",
    type=options.PATH,
    help="geo.csv to write, a new file: put it into the drive, or give it with --oxts.",
)
@click.option("--overwrite", is_flag=True, help="Let -o replace a file that is there already.")
@click.option("--figure", type=options.PATH, help="Picture to draw, .png or .svg; drawn if not found, too.")
@click.option("--growth", is_flag=True, help="Also find out from which distance on the drive is unique.")
@click.option("--track-only", is_flag=True, help="Do not look for intersections: the trajectory alone.")
@options.config_options
@options.drive_options
@options.workers_option
@options.QUIET
@options.JSON
def command(
    drive: Path,
    osm: Path | None,
    near: tuple[float, float] | None,
    radius_km: float | None,
    at: tuple[float, float, float] | None,
    at_frame: int | None,
    gpx: Path | None,
    out: Path | None,
    overwrite: bool,
    figure: Path | None,
    growth: bool,
    track_only: bool,
    preset: str,
    settings: tuple[str, ...],
    workers: int | None,
    **reading: Any,
) -> None:
    """Place DRIVE on a road map by its trajectory and its intersections; a georeference that it has is not used.

    \b
    Examples:
      interloc locate sequences/07 --osm karlsruhe.osm.pbf -o geo.csv
      interloc locate sequences/07 --osm germany.osm.pbf --near 49.01,8.43 --radius 5 -o geo.csv --figure where.png
      interloc locate sequences/07 --at 48.98523,8.39364,211.5 -o geo.csv
      interloc locate sequences/07 --gpx watch.gpx -o geo.csv

    Exit code 1 where the place is ambiguous or was not found: then no geo.csv is written.
    """
    from interloc.drives.georeference.geo_csv import write_geo_csv
    from interloc.localization.placing import require_found

    if sum(each is not None for each in (osm, at, gpx)) != 1:
        raise click.UsageError(
            "say where to look, in one way: the map by --osm FILE, one pose by --at LAT,LON,HEADING_DEG, or a track by "
            "--gpx FILE"
        )
    if at is None and at_frame is not None:
        raise click.UsageError("--at-frame belongs to --at")
    if osm is None and (near or radius_km or figure or growth or track_only):
        raise click.UsageError("--near, --radius, --figure, --growth and --track-only belong to --osm")
    _check_out(out, overwrite=overwrite)
    search_near, radius_m = locating.search_area(near, radius_km)
    config = options.configure(preset, settings)
    source = options.open_drive(drive, reading).without_georeference()
    if osm is None:
        _place_by_anchor(source, at, at_frame, gpx, out)
        return
    graph = options.read_map(osm)
    assert graph is not None
    result, location = locating.locate_drive(
        source, graph, config, near=search_near, radius_m=radius_m, workers=workers, track_only=track_only
    )
    record = {"drive": source.name, **location.record()}
    facts = []
    if growth:
        from interloc.localization.growth import growth_of, growth_text

        with console.progress("growth", "length") as bar:
            rows = growth_of(source, graph, result=result, near=search_near, radius_m=radius_m, progress=bar)
        record["growth"] = rows
        facts = [("growth", growth_text(rows))]
    if figure is not None and location.places:
        locating.write_figure(location, graph, source.name, figure)
    if console.wants_json():
        console.say_json(record)
    georeference = require_found(location, source.name)
    if out is not None:
        write_geo_csv(out, source.frames, georeference)
        facts.append(("written to", str(out)))
    if not console.wants_json() and not console.is_quiet():
        console.say_facts([*locating.location_facts(location), *facts])


def _check_out(out: Path | None, *, overwrite: bool) -> None:
    """Raise an error where a file would be replaced, before any long work starts."""
    from interloc.errors import ConfigError

    if out is not None and out.exists() and not overwrite:
        raise ConfigError(
            f"{out} is there already, and was not touched: it may be the drive's own. Give another name (-o), or "
            "--overwrite to replace it."
        )


def _place_by_anchor(
    drive: FolderDrive,
    at: tuple[float, float, float] | None,
    at_frame: int | None,
    gpx: Path | None,
    out: Path | None,
) -> None:
    from interloc.drives.georeference.geo_csv import write_geo_csv
    from interloc.gpx import read_gpx
    from interloc.localization.anchors import georeference_at
    from interloc.localization.gpx import georeference_by_gpx

    if at is not None:
        georeference = georeference_at(drive, *at, frame=at_frame)
        uncertainty = (
            "that of the pose given, plus the drift of the poses from there, plus 1.7 m per 100 m of distance for each "
            "degree that its heading is wrong"
        )
        facts = {}
    else:
        assert gpx is not None
        placed = georeference_by_gpx(drive, read_gpx(gpx))
        georeference = placed.georeference
        facts = {
            "matched_by": placed.matched_by,
            "rms_m": round(placed.rms_m, 1),
            "clock_late_s": round(placed.late_s, 2),
            "position_std_m": round(locating.median(placed.position_std_m), 1),
        }
        uncertainty = f"{facts['position_std_m']} m (one sigma, median; what all fixes of a phone share included)"
        uncertainty += f"; {placed.untold}" if placed.untold else ""
    if out is not None:
        write_geo_csv(out, drive.frames, georeference)
    fit = [("fit", f"{facts['rms_m']} m from the track before it was bent onto it")] if facts else []
    written = [] if out is None else [("written to", str(out))]
    console.say(
        {"drive": drive.name, "georeference": georeference.source, "uncertainty": uncertainty, **facts},
        [("placed by", georeference.source), *fit, ("uncertainty", uncertainty), *written],
    )
