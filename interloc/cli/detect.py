"""`interloc detect`."""

from pathlib import Path
from typing import Any

import click

from interloc.cli import console, options, summary


@click.command(cls=options.Command, short_help="Find the intersections along a drive.")
@options.DRIVE
@options.OUT
@options.config_options
@options.drive_options
@options.workers_option
@options.QUIET
@options.JSON
def command(
    drive: Path,
    out: Path,
    preset: str,
    settings: tuple[str, ...],
    workers: int | None,
    **drive_: Any,
) -> None:
    """Find the intersections along DRIVE and write them to a result folder.

    \b
    Example:
      interloc detect sequences/07 -o out --labels predictions --oxts 2011_09_30_drive_0027_sync
    """
    from interloc.errors import Beside
    from interloc.output.layout import result_folder
    from interloc.output.write import write_results
    from interloc.pipeline import detect

    config = options.configure(preset, settings)
    source = options.open_drive(drive, drive_)
    beside = Beside()
    with result_folder(out) as folder:
        with console.progress("detect", "keyframe") as bar:
            result = detect(source, config, workers=workers, progress=bar)
        write_results(result, folder, beside=beside)
    console.say(summary.run_summary(result, out), [*summary.run_facts(result, out), *summary.doubt_facts(result)])
    beside.check(out)
