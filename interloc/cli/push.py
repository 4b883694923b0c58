"""`interloc push`: a drive to a server, and its result back."""

from __future__ import annotations

import os
import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.errors import InterLocError, NetworkError, OutputError, is_interruption
from interloc.files import refuse_foreign

if TYPE_CHECKING:
    from interloc.arrays import JsonObject
    from interloc.client.connection import Connection
    from interloc.client.jobs import JobAnswer
    from interloc.client.push import PreparedDrive, Pushed
    from interloc.client.upload import UploadProgress
    from interloc.config import DetectorConfig
    from interloc.drives.options import LabelFolder
    from interloc.evaluation.record import Report
    from interloc.results import RunRecord

_THREADS = 8


@click.command(cls=options.Command, short_help="Send a drive to a server, or fetch a result from it.")
@click.argument("drive", type=options.PATH, required=False)
@click.option("--fetch", metavar="JOB", help="Fetch the result of a job to -o instead; wait for it if it still runs.")
@click.option(
    "--server",
    envvar="INTERLOC_SERVER",
    default="http://127.0.0.1:8000",
    metavar="URL",
    help="Address of the service; also read from INTERLOC_SERVER.",
)
@options.TOKEN
@options.LABEL_FOLDERS
@options.READING
@options.NETWORK
@click.option("--name", help="Name of the drive on the server.  [default: that of its folder]")
@click.option("--all-scans", is_flag=True, help="Send every scan, not only the keyframes of the default preset.")
@click.option("--jobs", type=click.IntRange(1, 64), default=_THREADS, help="Number of files sent at once.")
@click.option("--run", is_flag=True, help="Have the server find the intersections, and score them if there is a map.")
@click.option("-o", "--out", type=options.PATH, help="Write the result to this folder; needs --run or --fetch.")
@options.METHOD
@options.TRUTH
@options.PLACING
@options.OUTPUT
def push(
    drive: Path | None,
    fetch: str | None,
    server: str,
    token: str | None,
    label_folders: tuple[LabelFolder, ...],
    name: str | None,
    all_scans: bool,
    jobs: int,
    run: bool,
    out: Path | None,
    config: DetectorConfig,
    truth: options.Truth,
    placing: options.Placing,
    model: Path | None,
    provider: str,
    **reading: Any,
) -> None:
    """Send DRIVE to a server, reduced to what the method needs. After an interruption only what is missing is sent.

    \b
    Examples:
      interloc push sequences/07 --server https://interloc.example.org
      interloc push sequences/07 --osm karlsruhe.osm.pbf --run -o out     from a drive to a result
      interloc push drive.mcap --overpass --near 49.01,8.43 --run         without GNSS
      interloc push --fetch 9b1e44f00c7a2d53 -o out                       a result, exactly as the server has it
    """
    if fetch is not None:
        return _fetch(fetch, drive, out, server, token)
    if drive is None:
        raise click.UsageError("Missing argument 'DRIVE', or --fetch JOB.")
    _check_usage(truth, placing, run=run, out=out)
    from interloc.client.connection import Connection
    from interloc.client.jobs import JobRequest, submit
    from interloc.client.jobs import placing as place_of
    from interloc.client.push import PushOptions, prepare
    from interloc.drives.options import ReadingOptions

    push_options = PushOptions(
        name=name,
        label_folders=label_folders,
        keyframes=None if all_scans else config.keyframes,
        maps=() if truth.osm is None else (truth.osm,),
        reading=ReadingOptions.of(**reading),
        model=model,
        provider=provider,
    )
    with Connection(server, token, connections=jobs) as connection:
        connection.check_server()
        prepared = prepare(drive, push_options)
        is_placed = placing.locate or (placing.near is not None and not prepared.is_georeferenced)
        place = place_of(placing.near, placing.radius_m) if is_placed else None
        if run and truth.is_given and not prepared.is_georeferenced and place is None:
            raise options.no_georeference(
                prepared.manifest.name,
                "place it by its roads (--locate, --near), or leave the map out. Nothing was sent.",
            )
        pushed = _send(connection, drive, prepared, threads=jobs)
        job: JobAnswer | None = None
        if run:
            labels = "predictions" if model is not None else label_folders[0] if label_folders else None
            there = None if truth.osm is None else truth.osm.name
            wanted = JobRequest(config, labels, there, truth.overpass, truth.policy, truth.tolerance_m, place)
            job = _finish(connection, submit(connection, pushed.drive_id, wanted), out)
    result = {} if job is None else {"job": job.id, "summary": job.summary}
    result |= result_summary(job, out) if job is not None and out is not None else {}
    console.say({**pushed.to_dict(), **result}, _facts(pushed, job, out))
    return None


def _check_usage(truth: options.Truth, placing: options.Placing, *, run: bool, out: Path | None) -> None:
    """Raise a usage error for options that would have no effect or lack something, an OutputError for another OUT."""
    locate = placing.locate or placing.near is not None
    if not run and (locate or out is not None or truth.overpass):
        raise click.UsageError("-o, --overpass, --locate and --near need --run")
    if truth.is_given:
        truth.check()
    elif locate:
        raise click.UsageError("--locate and --near place the drive on a map: give it by --osm FILE or --overpass")
    if placing.locate and truth.overpass and placing.near is None:
        raise click.UsageError(options.UNKNOWN_PLACE)
    if out is not None:  # before anything is sent
        from interloc.output.layout import RUN_FILE

        refuse_foreign(out, out, RUN_FILE)


def _send(connection: Connection, drive: Path, prepared: PreparedDrive, *, threads: int) -> Pushed:
    """Push the drive with a progress bar; report what an interruption leaves on the server."""
    from interloc.client.push import push as push_files

    last: list[UploadProgress] = []
    with console.progress("push", "file") as bar:

        def show(progress: UploadProgress) -> None:
            last[:] = [progress]
            rate = console.size(int(progress.bytes_sent / max(time.monotonic() - progress.began_s, 1e-3)))
            bar(progress.done, progress.total, f"{console.size(progress.bytes_sent)}, {rate}/s")

        def show_stage(stage: str) -> None:
            bar.close()
            if os.isatty(2):
                console.note(stage)

        try:
            return push_files(connection, drive, prepared, threads=threads, on_stage=show_stage, on_progress=show)
        except BaseException as error:
            if not is_interruption(error):
                raise
            done = f"{last[0].done:,} of {last[0].total:,} files are on the server; " if last else ""
            raise InterLocError(f"interrupted; {done}the same command sends the rest") from error


def _finish(connection: Connection, job: JobAnswer, out: Path | None) -> JobAnswer:
    try:
        job = wait_for(connection, job.id)
        if out is not None:
            bring(connection, job, out)
    except BaseException as error:
        line = _fetch_line(job, connection.server)
        if isinstance(error, NetworkError | OutputError):
            raise InterLocError(f"{error} The result of the job: {line}") from error
        if not is_interruption(error):
            raise
        raise InterLocError(f"interrupted; the job goes on: {line}") from error
    return job


def _fetch_line(job: JobAnswer, server: str) -> str:
    return shlex.join(["interloc", "push", "--fetch", job.id, "-o", "OUT", "--server", server])


def _facts(pushed: Pushed, job: JobAnswer | None, out: Path | None) -> list[tuple[str, str]]:
    size = console.size(pushed.bytes_there)
    if pushed.source_bytes:
        share = 100 * pushed.bytes_there / pushed.source_bytes
        size += f" instead of {console.size(pushed.source_bytes)} ({share:.{0 if share >= 10 else 1}f} %)"
    sent = "nothing: the server has all of it already"
    if pushed.files_sent:
        rate = console.size(int(pushed.bytes_sent / max(pushed.seconds, 1e-3)))
        sent = f"{pushed.files_sent:,} files, {console.size(pushed.bytes_sent)}, {pushed.seconds:.1f} s ({rate}/s)"
    rows = [
        ("drive", f"{pushed.name}: {pushed.scans:,} scans, {pushed.scans_sent:,} of them on the server"),
        ("size", f"{size}, {pushed.files:,} files"),
        ("sent", sent),
        ("drive id", pushed.drive_id),
    ]
    if job is None:
        return [*rows, ("next", f"the same command with --run -o OUT (nothing is sent twice), or {pushed.server}")]
    rows.append(("job", job.id))
    if out is None:
        rows.append(("next", _fetch_line(job, pushed.server)))
    else:
        rows += result_facts(job, out)[1:]
    return [*rows, ("page", f"{pushed.server}/#panel=result&job={job.id}")]


def _fetch(job: str, drive: Path | None, out: Path | None, server: str, token: str | None) -> None:
    if drive is not None or out is None:
        raise click.UsageError("--fetch JOB needs -o OUT, and takes no DRIVE")
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
    from interloc.client.jobs import fetch as fetch_files

    with console.progress("fetch", "B") as bar:
        fetch_files(connection, job.id, out, on_bytes=bar)


def result_facts(job: JobAnswer, out: Path) -> list[tuple[str, str]]:
    """Return names and values for a person."""
    run, report = _records(out)
    counts = job.summary or {}
    return [
        ("drive", f"{job.drive_name}: {run['scans']} scans, {run['keyframes']} keyframes"),
        console.georeference_fact(run),
        *((name, str(counts[name])) for name in ("detections", "intersections") if name in counts),
        *(console.report_facts(report, out)[:-1] if report else ()),
        *(("missing", each) for each in counts.get("missing", ())),
        ("written to", str(out)),
    ]


def result_summary(job: JobAnswer, out: Path) -> JsonObject:
    """Return the outcome for a program."""
    _, report = _records(out)
    return {"out": str(out), "job": job.id, "drive": job.drive_id, "summary": job.summary, "report": report}


def _records(out: Path) -> tuple[RunRecord, Report | None]:
    from interloc.evaluation.record import REPORT_FILE, read_report
    from interloc.output.geojson import read_as
    from interloc.results import RunRecord

    return read_as(RunRecord, out / "run.json"), read_report(out) if (out / REPORT_FILE).is_file() else None
