"""`interloc merge` and `audit`: many drives on one map, and what it contradicts."""

from __future__ import annotations

from dataclasses import replace as changed
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from interloc.cli import console, options
from interloc.errors import ConfigError, MapError
from interloc.osm.policies import FindingKind
from interloc.wording import counted

if TYPE_CHECKING:
    from interloc.arrays import JsonObject


@click.command(short_help="Put many drives together to one map.")
@click.argument("results", nargs=-1)
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder of the map; drives are added to one there.")
@click.option("--replace", is_flag=True, help="Replace drives that are on the map already under the same name.")
@click.option("--remove", multiple=True, metavar="NAME", help="Take a drive out of the map; as often as needed.")
@options.OUTPUT
def merge(results: tuple[str, ...], out: Path, replace: bool, remove: tuple[str, ...]) -> None:
    """Put RESULTS, result folders of `interloc run`, together to one map: one point per intersection.

    Offsets between the drives are found where they overlap. A map that exists grows by the drives.
    NAME=FOLDER gives a drive another name: no two of a map may have the same.

    \b
    Examples:
      interloc merge out_monday out_tuesday -o city
      interloc merge wednesday=out -o city
    """
    from interloc.city.citymap import CityMap
    from interloc.city.drives import Pass
    from interloc.city.folder import city_record, is_city, locked, read_city, write_city
    from interloc.output.read import read_results
    from interloc.storage import fetch_older

    if not results and not remove:
        raise click.UsageError("give one or more result folders, or --remove")
    passes = []
    for given in results:
        name, _, folder = given.rpartition("=") if not Path(given).is_dir() else ("", "", given)
        data = Pass.of(read_results(options.PATH.convert(folder, None, None)))
        passes.append(changed(data, name=name) if name else data)
    with locked(fetch_older(out)):
        city = read_city(out) if remove or is_city(out) else CityMap()
        city.remove(*remove)
        replaced = {each.name for each in passes} if replace else set()
        known = {drive.data.key: name for name, drive in city.drives.items() if name not in replaced}
        there = [each for each in passes if each.key in known]
        new = [each for each in passes if each not in there]
        clash = [each.name for each in new if each.name in city.drives]
        if clash and not replace:
            raise ConfigError(
                f"drive {clash[0]!r} is on the map {out} already, with another result. Give --replace to put the new "
                f"one in its place, or another name: NEW_NAME=FOLDER."
            )
        if new:
            city.replace(*new)
        if new or remove or not is_city(out):
            write_city(city, out)
        record = city_record(city)
    already = [("added before", f"{each.name} is on the map already, as {known[each.key]}") for each in there]
    console.say({"out": str(out), "added": [each.name for each in new], **record}, [*already, *_facts(record, out)])


def _facts(record: JsonObject, out: Path) -> list[tuple[str, str]]:
    drives = record["drives"]
    shown = [f"{each['drive']} {each['offset_m'][0]:+.2f}, {each['offset_m'][1]:+.2f} m" for each in drives[:8]]
    facts = [
        ("drives", str(len(drives))),
        ("intersections", f"{record['intersections']}, {record['seen_by_several']} of them seen in several passes"),
        ("left out", f"{counted(record['left_out'], 'place')} that too few of the drives near it saw"),
        ("offsets", "; ".join(shown) + ("; ..." if len(drives) > len(shown) else "")),
    ]
    std, relative = record["median_position_std_m"], record["median_relative_std_m"]
    if std is not None:
        facts.append(("uncertainty", f"{std:.2f} m on the Earth, {relative:.2f} m against the places around (median)"))
    return [*facts, ("written", str(out / "city.geojson"))]


@click.command(short_help="List what OpenStreetMap has wrong, by several drives.")
@click.argument("city", type=options.PATH)
@click.option("--osm", required=True, type=options.PATH, help="OSM file: .osm, .osm.gz, .osm.bz2 or .osm.pbf.")
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder to write.")
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    type=click.Choice(get_args(FindingKind)),
    show_default="all",
    help="Kind of findings; as often as needed.",
)
@click.option(
    "--passes", type=click.IntRange(1, 1000), show_default="2", help="Number of independent passes that must agree."
)
@options.OUTPUT
def audit(city: Path, osm: Path, out: Path, kinds: tuple[FindingKind, ...], passes: int | None) -> None:
    """Compare CITY, a map of many drives that `interloc merge` wrote, with OpenStreetMap.

    OUT holds the findings as GeoJSON and as tasks for MapRoulette. Each is a question to a person, with a picture
    of the ground. An audit into the same folder keeps the names of findings: uploaded again, none is new.

    \b
    Example:
      interloc audit city --osm map.osm.gz -o audit
    """
    from interloc.city.audit import audit
    from interloc.city.folder import read_city
    from interloc.city.maproulette import audit_record, known_findings, write_audit
    from interloc.city.models import AuditConfig
    from interloc.evaluation.coverage import map_bounds
    from interloc.osm.reader import read_osm

    drives = read_city(city)
    import numpy as np

    track = np.concatenate([np.zeros((0, 2)), *(each.data.track_lonlat for each in drives.drives.values())])
    if not len(track):
        raise MapError(f"{city} holds no drives, so there is nothing to compare with {osm}.")
    graph = read_osm(osm, map_bounds(track))
    usual = AuditConfig()
    config = AuditConfig(kinds=kinds or usual.kinds, min_passes=passes or usual.min_passes)
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
