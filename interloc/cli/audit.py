"""`interloc audit`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.city.models import Kind


@click.command(short_help="List what OpenStreetMap has wrong, by several drives.")
@click.argument("city", type=options.PATH)
@click.option("--osm", required=True, type=options.PATH, help="OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder to write.")
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    type=click.Choice(
        ["missing_junction", "missing_branch", "moved", "not_joined", "no_node", "phantom", "one_junction"]
    ),
    show_default="all but phantom and one_junction",
    help="Kind of findings; as often as needed.",
)
@click.option(
    "--passes", type=click.IntRange(1), show_default="2", help="Number of independent passes that must agree."
)
@options.OUTPUT
def command(city: Path, osm: Path, out: Path, kinds: tuple[Kind, ...], passes: int | None) -> None:
    """Compare CITY, a map of many drives that `interloc merge` wrote, with OpenStreetMap.

    OUT holds the findings as GeoJSON and as tasks for MapRoulette. Each is a question to a person, with a picture
    of the ground. An audit into the same folder keeps the names of findings: uploaded again, none is new.

    \b
    Example:
      interloc audit city --osm map.osm.gz -o audit
    """
    from interloc.city.audit import audit
    from interloc.city.delivery import audit_record, known_findings, write_audit
    from interloc.city.folder import read_city
    from interloc.city.models import AuditConfig
    from interloc.errors import MapError
    from interloc.evaluation.coverage import map_bounds
    from interloc.osm.reader import read_osm

    drives = read_city(city)
    import numpy as np

    track = np.concatenate([np.zeros((0, 2)), *(each.data.track_lonlat for each in drives.drives.values())])
    if not len(track):
        raise MapError(f"{city} holds no drives, so there is nothing to compare with {osm}.")
    graph = read_osm(osm, map_bounds(track))
    chosen: dict[str, Any] = {"kinds": kinds or None, "min_passes": passes}
    config = AuditConfig(**{name: value for name, value in chosen.items() if value is not None})
    found = audit(drives, graph, config, known=known_findings(out))
    write_audit(found, drives, out, config, source=graph.source, made_up=graph.is_made_up)
    record = audit_record(found, config, graph.source)
    facts = [
        ("findings", ", ".join(f"{count} {kind}" for kind, count in record["by_kind"].items())),
        ("junctions", f"{found.junctions} of OpenStreetMap that {config.min_passes} passes or more came by"),
        ("held back", "; ".join(f"{count} {why}" for why, count in found.held_back.items()) or "none"),
        ("written", str(out / "findings.geojson")),
    ]
    console.say({"out": str(out), **record}, facts)
