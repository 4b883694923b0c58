"""`interloc fetch`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options, summary

if TYPE_CHECKING:
    from interloc.client.connection import Connection
    from interloc.client.jobs import JobAnswer


@click.command(short_help="Fetch a result from a server.")
@click.argument("job")
@options.OUT
@options.server_options
@options.QUIET
@options.JSON
def command(job: str, out: Path, server: str, token: str | None) -> None:
    """Fetch the result folder of JOB from a server, exactly as the server has it; wait for the job if it still runs.

    \b
    Example:
      interloc fetch 9b1e44f00c7a2d53 -o out --server https://interloc.example.org
    """
    from interloc.client.connection import Connection

    with Connection(server, token) as connection:
        done = wait_for(connection, job)
        bring(connection, done, out)
    console.say(result_summary(done, out), result_facts(done, out))


def wait_for(connection: Connection, job: str) -> JobAnswer:
    """Follow a job to its end, with its progress."""
    from interloc.client.jobs import follow

    shown = ""
    with console.progress("job", "keyframe") as bar:

        def show(change: JobAnswer) -> None:
            nonlocal shown
            if change.message and change.message != shown:
                shown = change.message
                console.note(f"{change.stage}: {shown}")
            if change.progress.total:
                bar(change.progress.done, change.progress.total)

        return follow(connection, job, show)


def bring(connection: Connection, job: JobAnswer, out: Path) -> None:
    """Write the result folder, with progress."""
    from interloc.client.jobs import fetch

    with console.progress("fetch", "B") as bar:
        fetch(connection, job.id, out, on_bytes=bar)


def result_facts(job: JobAnswer, out: Path) -> list[tuple[str, str]]:
    """Return names and values for a person."""
    run, report = _records(out)
    counts = job.summary or {}
    return [
        ("drive", f"{job.drive_name}: {run['scans']} scans, {run['keyframes']} keyframes"),
        summary.georeference_fact(run),
        *((name, str(counts[name])) for name in ("detections", "intersections") if name in counts),
        *(summary.report_facts(report, out)[:-1] if report else ()),
        ("written to", str(out)),
    ]


def result_summary(job: JobAnswer, out: Path) -> dict[str, Any]:
    """Return the outcome for a program."""
    _, report = _records(out)
    return {"out": str(out), "job": job.id, "drive": job.drive_id, "summary": job.summary, "report": report}


def _records(out: Path) -> tuple[dict[str, Any], dict[str, Any] | None]:
    import json

    run = json.loads((out / "run.json").read_bytes())
    report = out / "report.json"
    return run, json.loads(report.read_bytes()) if report.is_file() else None
