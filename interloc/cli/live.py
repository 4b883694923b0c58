"""`interloc live`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drives.folder import FolderDrive
    from interloc.live.session import Answer


@click.command(cls=options.Command, short_help="Play a drive as it was driven: intersections while driving.")
@options.DRIVE
@click.option("--print", "prints", is_flag=True, help="Detect right here, and print one JSON object per keyframe.")
@click.option(
    "--speed",
    type=click.FloatRange(min=0.0, min_open=True),
    show_default="1 with a server, else as fast as it goes",
    help="How fast it is played: 1 as it was driven, 2 twice as fast.",
)
@click.option(
    "--lookahead",
    type=click.IntRange(0, 500),
    help="Keyframes that an answer waits for; the same as --set keyframes.lookahead=N. 0 answers at once, and finds "
    "fewer intersections ahead of the vehicle.",
)
@options.config_options
@options.drive_options
@options.QUIET
def command(
    drive: Path,
    prints: bool,
    speed: float | None,
    lookahead: int | None,
    preset: str,
    settings: tuple[str, ...],
    quiet: bool,
    **drive_: Any,
) -> None:
    """Play DRIVE, a folder or a bag, scan by scan, and follow what is found.

    \b
    Examples:
      interloc live sequences/07 --print --lookahead 0
      interloc live city.mcap --print --speed 1 | jq -c '.events[]'
    """
    if not prints:
        raise click.UsageError("--print says where the answers go")
    console.set_up_log(quiet=quiet)
    if lookahead is not None:
        settings = (*settings, f"keyframes.lookahead={lookahead}")
    config = options.configure(preset, settings)
    _print_answers(options.open_drive(drive, drive_), config, speed)


def _print_answers(drive: FolderDrive, config: DetectorConfig, speed: float | None) -> None:
    from interloc.detection.warm import warm_up
    from interloc.live.documents import answer_document
    from interloc.live.play import play
    from interloc.live.session import LiveSession
    from interloc.live.worker import LiveWorker, end_document

    def say(document: dict[str, Any], _: Answer | None = None) -> None:
        click.echo(json.dumps(document, allow_nan=False))

    warm_up(config)
    session, scans = LiveSession(config), play(drive, config, speed=speed)
    if speed is None:
        for scan in scans:
            say(answer_document(session.push(scan), scan))
        for answer in session.finish():
            say(answer_document(answer))
        say(end_document(session))
        return
    worker = LiveWorker(session, say)
    for scan in scans:
        worker.put(scan)
    worker.finish()
    worker.join()
