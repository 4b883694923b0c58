"""`interloc reduce`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from interloc.cli import console, options


@click.command(cls=options.Command, short_help="Make a small copy of a drive that gives the same results.")
@options.DRIVE
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder of the reduced drive.")
@click.option(
    "--all-scans",
    is_flag=True,
    help="Keep every scan, not only the keyframes of the presets: needed for other settings of keyframes.",
)
@options.label_folders_option
@options.reading_options
@options.model_options
@options.QUIET
@options.JSON
def command(
    drive: Path,
    out: Path,
    all_scans: bool,
    label_folders: tuple[Any, ...],
    **reading: Any,
) -> None:
    """Write a copy of DRIVE that holds only what the method needs: the ground points of its keyframes.

    Every command reads it like the drive itself, with the same results.

    \b
    Example:
      interloc reduce sequences/07 -o small --oxts 2011_09_30_drive_0027_sync
      interloc run small -o out --osm map.osm.gz
    """
    from interloc.config import DEFAULT
    from interloc.drives.options import DriveOptions
    from interloc.reduction.reduce import reduce_drive

    with console.progress("reduce", "scan") as bar:
        manifest = reduce_drive(
            drive,
            out,
            DriveOptions.of(**reading),
            label_folders=label_folders or None,
            keyframes=None if all_scans else DEFAULT.keyframes,
            progress=bar,
        )
    assert manifest.source is not None
    labels: list[str] = [part.folder for part in manifest.labels]
    scans, kept = len(manifest.frames), len(manifest.kept_frames)
    before = manifest.source.scan_bytes + sum(part.label_bytes or 0 for part in manifest.labels)
    after = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    outcome = {"out": str(out), "drive": manifest.name, "scans": scans, "kept_scans": kept, "labels": labels}
    thinning = None if manifest.keyframes is None else manifest.keyframes.model_dump()
    by = "all kept" if manifest.keyframes is None else f"{kept:,} kept, the {manifest.keyframes}"
    facts = [
        ("drive", f"{manifest.name}: {scans:,} scans, {by}"),
        ("labels", " and ".join(labels)),
        ("size", f"{console.size(before)} before, {console.size(after)} now"),
        ("written to", str(out)),
    ]
    console.say({**outcome, "keyframes": thinning, "bytes_before": before, "bytes_after": after}, facts)
