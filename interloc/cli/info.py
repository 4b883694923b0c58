"""`interloc info`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import console, options

if TYPE_CHECKING:
    from interloc.config import DetectorConfig
    from interloc.drives.inspect import DriveReport
    from interloc.drives.options import DriveOptions
    from interloc.drives.scans.recording import ReducedReport, Topic

_MARK = {"error": "ERROR", "warning": "warning", "note": "note"}


@click.command(cls=options.Command, short_help="What is in a drive, and what is wrong with it.")
@click.argument("drive", type=options.PATH, required=False)
@options.INPUT
@options.METHOD
@click.option("--settings", "shows_settings", is_flag=True, help="List the settings of the method instead.")
@click.option("--thorough", is_flag=True, help="Read every scan and label, not only some.")
@options.JSON
def info(
    drive: Path | None, thorough: bool, shows_settings: bool, reading: DriveOptions, config: DetectorConfig
) -> None:
    """Report what is in DRIVE and what is wrong with it; the exit code is 1 if it cannot be used.

    \b
    Example:
      interloc info sequences/07
      interloc info --settings --preset paper
    """
    if shows_settings:
        return _say_settings(config)
    if drive is None:
        raise click.UsageError("Missing argument 'DRIVE'.")
    from interloc.drives.inspect import inspect_drive

    report = inspect_drive(drive, reading, thorough=thorough)
    if console.wants_json():
        console.say_json(report.to_dict())
    else:
        console.say_facts(_facts(report))
        for problem in report.problems:
            place = f"{problem.path}: " if problem.path else ""
            click.echo(console.shown(f"{_MARK[problem.severity]}: {place}{problem.message}"))
        click.echo("This drive can be used." if report.ok else "This drive cannot be used as it is.")
    if not report.ok:
        raise click.exceptions.Exit(1)
    return None


def _say_settings(config: DetectorConfig) -> None:
    """Print every setting, its value and what it means; as JSON, the values."""
    if console.wants_json():
        click.echo(config.model_dump_json(indent=2))
        return
    for section, of_section in type(config).model_fields.items():
        part = getattr(config, section)
        described = getattr(type(part), "model_fields", None)
        rows = (
            [(section, part, of_section)]
            if described is None
            else [(f"{section}.{name}", getattr(part, name), field) for name, field in described.items()]
        )
        for name, value, field in rows:
            shown = value.model_dump_json() if hasattr(value, "model_dump_json") else json.dumps(value)
            click.echo(f"{name} = {shown}")
            click.echo(click.wrap_text(field.description or "", 100, "    ", "    "))


def _facts(report: DriveReport) -> list[tuple[str, str]]:
    rows = [("drive", report.path), ("layout", report.layout or "unknown")]
    if report.scans:
        frames = f"{report.first_frame} to {report.last_frame}"
        points = "" if report.points_per_scan is None else f", about {report.points_per_scan:,} points each"
        rows.append(("scans", f"{report.scans} (frames {frames}){points}"))
    if report.reduced is not None:
        rows.append(("reduced", _kept(report.reduced, report.scan_bytes + report.label_bytes)))
    rows += [(f"topic {topic.name}", _topic(topic)) for topic in report.topics]
    if report.poses:
        rows.append(
            ("poses", f"{report.poses}, {report.pose_frame or 'unknown'} frame: {report.pose_frame_reason or '?'}")
        )
    if report.length_m is not None:
        distance = f"{report.length_m:.0f} m"
        if report.spacing_m is not None:
            distance += f", {report.spacing_m:.1f} m between scans"
        if report.duration_s:
            distance += f", {report.duration_s:.0f} s"
        rows.append(("distance", distance))
    if report.road_share is not None:
        rows.append(
            ("labels", f"{report.label_folder}, scheme {report.label_scheme}, {100 * report.road_share:.0f} % road")
        )
    if report.flatness_m is not None:
        rows.append(("flatness", f"road seen from two scans agrees within {report.flatness_m:.2f} m in height"))
    if report.georeference or report.georeference_reason:
        rows.append(("georeference", report.georeference or f"none: {report.georeference_reason}"))
    return rows


def _topic(topic: Topic) -> str:
    """Return what a topic of a bag holds, and what it is read as."""
    role = "" if topic.role is None else f": read as the {topic.role}"
    return f"{topic.messages:,} messages of {topic.type}{role}"


def _kept(reduced: ReducedReport, before: int) -> str:
    if reduced.distance_m is None:
        text = "all scans kept"
    else:
        text = (
            f"{reduced.kept_scans} scans kept, the keyframes of {reduced.distance_m:g} m, {reduced.angle_deg:g} degrees"
        )
    if reduced.ground_bytes is None:
        return text
    text += f"; {console.size(reduced.ground_bytes)} of ground points"
    return f"{text} from {console.size(before)}" if before else text
