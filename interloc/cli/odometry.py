"""`interloc odometry`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from interloc.cli import console, options


@click.command(cls=options.Command, short_help="Compute the poses of a drive from its points.")
@options.DRIVE
@click.option(
    "-o",
    "--out",
    default=Path("poses.txt"),
    show_default=True,
    type=options.PATH,
    help="File to write: poses of the LiDAR as lines of 12 numbers (KITTI), or in TUM's format where it ends in .tum.",
)
@options.odometry_options
@options.QUIET
@options.JSON
def command(drive: Path, out: Path, **reading: Any) -> None:
    """Write the poses of the LiDAR at every scan of DRIVE, from its points alone: no labels and no poses are needed.

    The scans must overlap: at most some metres from one to the next. Where the motion cannot be followed, the command
    says at which scan, and writes nothing. All commands that read drives take --poses odometry, which does the same.

    \b
    Examples:
      interloc odometry drive.mcap -o poses.txt
      interloc run scans/ -o out --poses odometry --osm map.osm.gz
    """
    from interloc.drives.options import DriveOptions
    from interloc.reduction.convert import write_poses

    began = time.perf_counter()
    with console.progress("odometry", "scan") as bar:
        done = write_poses(drive, out, DriveOptions.of(**reading), progress=bar)
    seconds = time.perf_counter() - began
    facts = [
        ("drive", f"{done.name}: {done.scans:,} scans, {done.length_m:,.0f} m"),
        ("poses", done.how),
        ("time", f"{seconds:.1f} s, {1000 * seconds / done.scans:.0f} ms per scan"),
        ("written to", str(out)),
    ]
    console.say({"out": str(out), **vars(done), "seconds": seconds}, facts)
