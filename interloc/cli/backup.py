"""`interloc backup` and `interloc restore`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from interloc.cli import console, options
from interloc.cli.service import DATA_DIR, open_service, read_settings
from interloc.errors import InterLocError

_SHOWN = 5


@click.command(short_help="Back up the web service while it runs.")
@click.argument("out", type=click.Path(path_type=Path))
@DATA_DIR
@click.option("--keep-daily", type=click.IntRange(0), help="Make a generation, and keep one of each of N days.")
@click.option("--keep-weekly", type=click.IntRange(0), help="The same of N weeks.")
@click.option("--keep-monthly", type=click.IntRange(0), help="The same of N months.")
@click.option("--to", metavar="ADDRESS", help="Then bring OUT to object storage: s3://bucket/prefix; only what is new.")
@options.QUIET
@options.JSON
def backup(
    out: Path,
    data_dir: Path | None,
    keep_daily: int | None,
    keep_weekly: int | None,
    keep_monthly: int | None,
    to: str | None,
) -> None:
    """Back up drives, jobs, results and tokens of the web service to the folder OUT, while its servers run.

    Every drive is in it as it was at one moment. OUT is a new folder, or the backup of before: then only what has
    changed is brought. A backup that was stopped goes on where it stopped. What is deleted in the service is gone from
    OUT with the next backup.

    With any --keep option OUT is a folder of generations, one backup for each call, which share what did not change;
    the newest of each of the last days, weeks and months that have one stays, the others are removed.

    \b
    Examples:
      interloc backup /mnt/backup/interloc --data-dir /srv/interloc
      interloc backup /mnt/backups --keep-daily 7 --keep-weekly 4 --keep-monthly 12 --to s3://bucket/backups
    """
    if ":/" in str(out):
        raise click.UsageError(f"{out}: a backup is written to a folder, and brought to object storage by --to.")
    everything, keep, dropped = out, (keep_daily, keep_weekly, keep_monthly), list[str]()
    with open_service(data_dir) as context, _resumable(), console.progress("backup", "B") as bar:
        from app.upkeep.backup import back_up
        from app.upkeep.generations import Retention, back_up_generation

        if any(count is not None for count in keep):
            retention = Retention(*(count or 0 for count in keep))
            out, report, dropped = back_up_generation(context, out, retention, bar)
        else:
            report = back_up(context, out, bar)
    record, copied = report.record, None
    if to is not None:
        from app.upkeep.elsewhere import bring

        with _resumable():
            copied = bring(everything, to)
    counts: dict[str, Any] = {
        "brought_files": report.brought_files,
        "brought_bytes": report.brought_bytes,
        "removed_files": report.removed_files,
        "longest_lock_s": round(report.longest_lock_s, 3),
        "faults": report.faults,
        "removed_generations": dropped,
        "copied_files": None if copied is None else copied[0],
        "copied_bytes": None if copied is None else copied[1],
    }
    assert record.ended_at is not None
    seconds = (record.ended_at - record.begun_at).total_seconds()
    brought = f"{report.brought_files:,} files, {console.size(report.brought_bytes)}"
    removed = [f"{report.removed_files:,} files that the service has no longer"] if report.removed_files else []
    rows = [
        ("backup", str(out)),
        ("drives", f"{record.drives:,}, with {record.jobs:,} jobs"),
        ("size", f"{record.files:,} files, {console.size(record.size_bytes)}"),
        ("brought", brought if report.brought_files else "nothing: all was there"),
        *[("removed", each) for each in (*removed, *(f"the generation {name}" for name in dropped))],
        *([] if copied is None else [("copied", f"{copied[0]:,} files, {console.size(copied[1])}, to {to}")]),
        ("time", f"{seconds:.1f} s; no drive was locked for longer than {report.longest_lock_s:.2f} s"),
    ]
    console.say({"out": str(out), **record.model_dump(mode="json"), **counts}, rows)
    if report.faults:
        raise InterLocError(
            f"all that there is was backed up, but the data folder itself is not whole: {_shown(report.faults)}. "
            "`interloc check` says what to do."
        )


@click.command(short_help="Restore a backup of the web service.")
@click.argument("backup")
@DATA_DIR
@click.option("--generation", help="Which of several generations, or how its name begins.  [default: the newest]")
@click.option("--incomplete", is_flag=True, help="Restore what there is of a backup that is not whole.")
@options.QUIET
@options.JSON
def restore(backup: str, data_dir: Path | None, generation: str | None, incomplete: bool) -> None:
    """Restore BACKUP into an empty data folder and an empty database: SQLite, or PostgreSQL by INTERLOC_DATABASE_URL.

    BACKUP is a folder, or s3://bucket/prefix that `interloc backup --to` has written: then it is fetched first, into
    TMPDIR. The database need not be of the kind that the backup was made of: this is also the way from one to the
    other. A restoration that was stopped goes on where it stopped; until it has ended, no server starts on the data
    folder.

    \b
    Example:
      interloc restore /mnt/backup/interloc --data-dir /srv/interloc
    """
    settings = read_settings({"data_dir": data_dir})
    from app.upkeep.generations import find_generation
    from app.upkeep.restore import restore as restore_backup

    with _resumable(), console.progress("restore", "B") as bar:
        if "://" in backup:
            from app.upkeep.elsewhere import fetch

            folder = fetch(backup, generation)
        else:
            folder = find_generation(Path(backup), generation)
        report = restore_backup(settings, folder, incomplete=incomplete, advance=bar)
    made_at = report.record.begun_at
    record: dict[str, Any] = {
        "backup": str(folder),
        "made_at": made_at.isoformat(),
        "data_dir": str(settings.data_dir),
        "drives": report.drives,
        "jobs": report.jobs,
        "files": report.files,
        "size_bytes": report.size_bytes,
        "findings": [asdict(finding) for finding in report.findings],
    }
    rows = [
        ("restored", f"the backup of {made_at:%Y-%m-%d %H:%M} UTC to {settings.data_dir}"),
        ("drives", f"{report.drives:,}, with {report.jobs:,} jobs"),
        ("size", f"{report.files:,} files, {console.size(report.size_bytes)}"),
        ("check", "rows and files agree" if not report.findings else f"{len(report.findings)} findings"),
    ]
    console.say(record, rows)
    if report.findings:
        found = _shown([f"{finding.place}: {finding.message.rstrip('.')}" for finding in report.findings])
        raise InterLocError(
            f"the backup was restored as it is, but that is not whole: {found}. `interloc check --repair` does what "
            "is safe."
        )


@contextmanager
def _resumable() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise InterLocError("interrupted; the same command goes on where it stopped") from None


def _shown(items: list[str]) -> str:
    return ", ".join(items[:_SHOWN]) + (f" and {len(items) - _SHOWN} more" if len(items) > _SHOWN else "")
