"""`interloc explain`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drives.options import DriveOptions
    from interloc.osm.policies import Policy


@click.command(cls=options.Command, short_help="Draw the steps of the method for one keyframe.")
@options.DRIVE
@click.option("--frame", required=True, type=int, help="Scan number; the nearest keyframe is taken.")
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder for the sheet and explain.json.")
@options.INPUT
@options.METHOD
@click.option("--osm", type=options.PATH, help="OSM file to draw on top.")
@options.POLICY
@options.OUTPUT
def command(
    drive: Path,
    frame: int,
    out: Path,
    reading: DriveOptions,
    config: DetectorConfig,
    osm: Path | None,
    policy: Policy,
) -> None:
    """Draw the steps of the method for one keyframe of DRIVE on one sheet, and write the numbers behind them.

    \b
    Example:
      interloc explain sequences/07 --frame 300 -o steps
    """
    from interloc.drives.open import open_drive
    from interloc.explain import explain

    paths = explain(open_drive(drive, reading), frame, config, out, graph=options.read_map(osm), policy=policy)
    if console.wants_json():
        console.say_json({"files": [str(path) for path in paths]})
    elif not console.is_quiet():
        for path in paths:
            click.echo(path)
