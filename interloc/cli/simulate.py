"""`interloc simulate`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.errors import require_lab

if TYPE_CHECKING:
    from interloc.lab.config import SimulationOptions
    from interloc.lab.town import Part


DRIVE = click.option(
    "-o",
    "--out",
    "drive",
    required=True,
    metavar="DRIVE",
    type=options.PATH,
    help="Folder of the drive to write; an older simulated drive there is replaced.",
)
EVERY_SCAN = click.option(
    "--every-scan",
    is_flag=True,
    help="Write all scans, ten per second (2.6 MB each), not only the keyframes that the method uses.",
)
scene_options = options.together(
    click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=0,
        show_default=True,
        help="Seed of everything random: houses, cars, noise. The same seed gives the same drive.",
    ),
    click.option("--ground-only", is_flag=True, help="Write only points on the ground: about half the size."),
    click.option("--max-scans", type=click.IntRange(min=1), help="Number of scans after which the drive ends."),
    click.option(
        "--sensor",
        type=click.Choice(options.SENSORS),
        default="hdl-64e",
        show_default=True,
        help="LiDAR to drive with: its lasers, shots and range as published.",
    ),
    click.option(
        "--columns",
        type=click.IntRange(8, 8192),
        show_default="those of the sensor at 10 Hz",
        help="Shots of each laser per turn.",
    ),
    options.QUIET,
)
"""Options that all simulations share."""


@click.group(short_help="Make a drive whose truth is known: town or KITTI twin.")
def command() -> None:
    """Write drives whose truth is known: a LiDAR drives through a made-up town, or along a track of KITTI over its map.

    \b
    The made-up town, with every shape of junction that matters; its map is DRIVE/map.osm:
      interloc simulate town -o DRIVE                      5 km, every shape
      interloc simulate town --part plain -o DRIVE         670 m, X, T and Y junctions only
    \b
    The town of the demo, with curved streets, market square and park:
      interloc simulate town --part quarter --ground-only --columns 720 -o DRIVE
    \b
    The twin of a KITTI sequence, as `interloc benchmark twins` measures it:
      interloc simulate twin 07 --kitti kitti -o DRIVE

    DRIVE is in SemanticKITTI format with oxts/: go on with `interloc run DRIVE -o OUT --osm MAP`.
    """
    require_lab()


@command.command()
@DRIVE
@click.option(
    "--part",
    type=click.Choice(["full", "plain", "quarter"]),
    default="full",
    show_default=True,
    help="full: every shape of junction that matters, 5 km. plain: its X, T and Y junctions only, 670 m. "
    "quarter: a town as one knows them, 15 junctions along 2.1 km of curved streets and round a market square.",
)
@EVERY_SCAN
@scene_options
def town(drive: Path, part: Part, every_scan: bool, **common: Any) -> None:
    """Drive through a made-up town whose map is its truth.

    The full one has oblique, staggered and compound junctions, a roundabout, a dual carriageway and a bridge.

    \b
    Example:
      interloc simulate town --part quarter -o drive && interloc run drive -o out --osm drive/map.osm
    """
    from interloc.lab.drive import simulate
    from interloc.lab.town import MAP_FILE, Town

    options = _options(every_scan=every_scan, **common)
    with console.progress("simulate", "scan") as bar:
        trip = Town(part, seed=options.seed).trip()
        scans = simulate(trip, drive, options, progress=bar)
    _go_on(scans, drive, drive / MAP_FILE)


@command.command()
@click.argument("sequence")
@click.option(
    "--kitti",
    required=True,
    type=options.PATH,
    help="Folder with oxts/, poses_suma/, calib/, times/, osm/ and osm_buildings/ of the sequences.",
)
@DRIVE
@EVERY_SCAN
@scene_options
def twin(sequence: str, kitti: Path, drive: Path, every_scan: bool, **common: Any) -> None:
    """Drive along the real track of KITTI odometry SEQUENCE (00, 02, ...) over its real map.

    \b
    Example:
      interloc simulate twin 07 --kitti kitti -o drive && interloc run drive -o out --osm kitti/osm/07.osm.gz
    """
    from interloc.lab.cases import twin_cases, twin_trip
    from interloc.lab.drive import simulate

    (case,) = twin_cases(kitti, [sequence])
    with console.progress("simulate", "scan") as bar:
        options = _options(every_scan=every_scan, **common)
        scans = simulate(twin_trip(kitti, sequence), drive, options, progress=bar)
    _go_on(scans, drive, case.osm)


def _options(
    *, every_scan: bool, seed: int, ground_only: bool, max_scans: int | None, sensor: str, columns: int | None
) -> SimulationOptions:
    """Return the values of `scene_options` as the simulator takes them."""
    from dataclasses import replace

    from interloc.lab.config import SENSORS, SimulationOptions

    lidar = SENSORS[sensor]
    return SimulationOptions(
        seed=seed,
        keyframes_only=not every_scan,
        ground_only=ground_only,
        max_scans=max_scans,
        sensor=lidar if columns is None else replace(lidar, columns=columns),
    )


def _go_on(scans: int, drive: Path, osm: Path) -> None:
    console.say_facts(
        [
            ("drive", f"{drive}: {scans} scans"),
            ("map", str(osm)),
            ("go on", shlex.join(["interloc", "run", str(drive), "-o", f"{drive}_result", "--osm", str(osm)])),
        ]
    )
