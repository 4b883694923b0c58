"""`interloc convert`, `label` and `odometry`: what is written of a drive, or made for it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.drives.options import DriveOptions


@click.command(cls=options.Command, short_help="Write a drive in SemanticKITTI's layout, or a small copy of it.")
@options.DRIVE
@click.option("-o", "--out", required=True, type=options.PATH, help="Folder of the new drive.")
@click.option(
    "--reduce",
    "reduces",
    is_flag=True,
    help="Write only what the method needs, the ground points of keyframes: every command reads it like the drive. An "
    "older one at -o is replaced.",
)
@click.option(
    "--all-scans",
    is_flag=True,
    help="With --reduce: keep every scan, not only the keyframes of the presets, for other settings of keyframes.",
)
@options.LABEL_FOLDERS
@options.READING
@options.NETWORK
@options.OUTPUT
def convert(
    drive: Path, out: Path, reduces: bool, all_scans: bool, label_folders: tuple[Any, ...], **reading: Any
) -> None:
    """Write DRIVE (a ROS bag, PCD, LAS or LAZ files, KITTI-360, ...) as a SemanticKITTI sequence.

    Poses become those of the LiDAR, the georeference becomes a geo.csv, the remission is scaled to 0 to 1. Labels come
    along where there are any, or are made by a network (--model); other programs can make them afterwards.

    \b
    Examples:
      interloc convert drive.mcap -o drive
      interloc convert scans/ -o drive --poses poses.tum
      interloc convert sequences/07 -o small --reduce          for the same results with a fraction of the bytes
    """
    from interloc.drives.options import DriveOptions

    if reduces:
        return _reduce(drive, out, label_folders, DriveOptions.of(**reading), all_scans=all_scans)
    if all_scans or len(label_folders) > 1:
        raise click.UsageError("--all-scans, and --labels several times, need --reduce")
    from interloc.reduction.convert import convert_drive

    labels = {"labels": label_folders[0]} if label_folders else {}
    with console.progress("convert", "scan") as bar:
        done = convert_drive(drive, out, DriveOptions.of(**labels, **reading), progress=bar)
    numbers = ", numbered anew from 0" if done.is_renumbered else ""
    facts = [
        ("drive", f"{done.name}: {done.scans:,} scans{numbers}"),
        ("labels", done.labels or "none: make them with `interloc label`, or any semantic segmentation"),
        ("georeference", "geo.csv" if done.has_georeference else "none"),
        ("written to", str(out)),
    ]
    console.say({"out": str(out), **vars(done)}, facts)
    return None


def _reduce(drive: Path, out: Path, label_folders: tuple[Any, ...], reading: DriveOptions, *, all_scans: bool) -> None:
    from interloc.config import DEFAULT
    from interloc.reduction.reduce import reduce_drive

    with console.progress("reduce", "scan") as bar:
        manifest = reduce_drive(
            drive,
            out,
            reading,
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


@click.command(cls=options.Command, short_help="Label the scans of a drive by a network, or by geometry.")
@options.DRIVE
@click.option(
    "--by",
    type=click.Choice(["network", "geometry"]),
    show_default="network",
    help="What makes the labels: a network (--model), or geometry, brightness and the driven track alone.",
)
@click.option("-o", "--out", type=options.PATH, show_default="DRIVE", help="Folder in which predictions/ is made.")
@options.READING
@options.NETWORK
@options.OUTPUT
def label(drive: Path, by: str | None, model: Path | None, out: Path | None, **reading: Any) -> None:
    """Write what a network says of every scan of DRIVE to predictions/NNNNNN.label, in ids of SemanticKITTI.

    The network is one of the RangeNet++ family, in the folder that it is published in. Without one, --by geometry finds
    the road as ground that looks like the driven strip and is connected with it. `interloc run` and `push`
    take --model and --labels geometry too: they label the keyframes only, on the way, and write no labels.

    \b
    Examples:
      interloc label sequences/07 --model models/salsanext
      interloc label sequences/07 --by geometry
      interloc run sequences/07 -o out --labels predictions --osm map.osm.gz
    """
    from interloc.drives.options import DriveOptions, LabelFolder
    from interloc.reduction.convert import label_drive

    if (model is None) != (by == "geometry"):
        raise click.UsageError("Give the folder of a network (--model), or --by geometry; one of the two.")
    if out is None and console.shown(str(drive)) != str(drive):
        raise click.UsageError("Give the folder that predictions/ is made in (-o): the drive is in object storage.")
    labels: LabelFolder = "geometry" if by == "geometry" else "labels"
    began = time.perf_counter()
    with console.progress("label", "scan") as bar:
        folder, read = label_drive(drive, out, DriveOptions.of(labels=labels, model=model, **reading), progress=bar)
    seconds = time.perf_counter() - began
    assert read.scans is not None
    facts, road = read.scans.facts, read.labels.road_share
    outcome = {"out": str(folder), "scans": facts.scans, "network": facts.label_folder, "seconds": seconds}
    rows = [
        ("labels", f"{facts.scans:,} scans by {facts.label_folder}"),
        ("road", "unknown" if road is None else f"{100 * road:.0f} % of the points of the scans looked into"),
        ("time", f"{seconds:.1f} s, {1000 * seconds / max(1, facts.scans):.0f} ms per scan"),
        ("written to", str(folder)),
    ]
    console.say({**outcome, "road_share": road}, rows)


@click.command(cls=options.Command, short_help="Compute the poses of a drive from its points.")
@options.DRIVE
@click.option(
    "-o",
    "--out",
    default=Path("poses.txt"),
    type=options.PATH,
    help="File to write: poses of the LiDAR as lines of 12 numbers (KITTI), or in TUM's format where it ends in .tum.",
)
@options.ODOMETRY
@options.OUTPUT
def odometry(drive: Path, out: Path, **reading: Any) -> None:
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
