"""`interloc admin`: what the operator of a service does with its data; tokens are in `interloc.cli.service`."""

from collections import Counter
from dataclasses import asdict
from pathlib import Path

import click

from interloc.cli import console, options
from interloc.cli.console import size
from interloc.cli.service import DATA_DIR, open_service, read_settings, token
from interloc.errors import ConfigError, InterLocError

_SHOWN = 10  # findings of one kind in one folder


@click.command(short_help="Compare the database of the service with its files.")
@DATA_DIR
@options.JSON
def check(data_dir: Path | None) -> int:
    """Say what is missing on either side: rows of the database without their files, files and folders without rows.

    Names and sizes are compared, and nothing is changed. The server may go on meanwhile. Exit code 0: nothing was
    found; 1: something was.

    \b
    Example:
      interloc admin check --data-dir /srv/interloc
    """
    with open_service(data_dir) as context:
        from app.upkeep.check import check as check_all

        found = check_all(context)
    rows = [] if found else [("check", "rows and files agree")]
    shown: Counter[tuple[str, str]] = Counter()
    for each in found:
        group = each.kind, "/".join(each.place.split("/")[:3])
        shown[group] += 1
        if shown[group] <= _SHOWN:
            rows.append((each.kind, f"{each.place}: {each.message}"))
    for (kind, folder), count in shown.items():
        if count > _SHOWN:
            rows.append((kind, f"{folder}: and {count - _SHOWN:,} more (--json lists all)"))
    console.say({"ok": not found, "findings": [asdict(each) for each in found]}, rows)
    return int(bool(found))


@click.command(short_help="Back up the web service while it runs.")
@click.argument("out", type=click.Path(path_type=Path))
@DATA_DIR
@options.OUTPUT
def backup(out: Path, data_dir: Path | None) -> None:
    """Back up drives, jobs, results and tokens of the web service to the new folder OUT, while its servers run.

    On the disk of the data folder a backup is made of hard links: it takes no space, and other programs (rsync, restic)
    bring it elsewhere, and keep older ones. On another disk it is a copy.

    \b
    Example:
      interloc admin backup /srv/backup --data-dir /srv/interloc && restic backup /srv/backup && rm -r /srv/backup
    """
    with open_service(data_dir) as context, console.progress("backup", " files") as bar:
        from app.upkeep.backup import back_up

        record = back_up(context, out, bar)
    assert record.ended_at is not None
    rows = [
        ("backup", str(out)),
        ("drives", f"{record.drives:,}, with {record.jobs:,} jobs"),
        ("size", f"{record.files:,} files, {size(record.size_bytes)}"),
        ("time", f"{(record.ended_at - record.begun_at).total_seconds():.1f} s"),
    ]
    console.say({"out": str(out), **record.model_dump(mode="json")}, rows)
    if record.missing:
        raise InterLocError(
            f"all that there is was backed up, but files are missing in the service itself: "
            f"{_some(record.missing)}. `interloc admin check` names all."
        )


@click.command(short_help="Restore a backup of the web service.")
@click.argument("backup", type=click.Path(path_type=Path))
@DATA_DIR
@options.OUTPUT
def restore(backup: Path, data_dir: Path | None) -> None:
    """Restore BACKUP into a new data folder and a new database: SQLite, or PostgreSQL by INTERLOC_DATABASE_URL.

    The database need not be of the kind that the backup was made of: this is also the way from one to the other.

    \b
    Example:
      interloc admin restore /mnt/backup/interloc --data-dir /srv/interloc
    """
    settings = read_settings({"data_dir": data_dir})
    from app.upkeep.backup import restore as restore_backup

    with console.progress("restore", " files") as bar:
        record = restore_backup(settings, backup, bar)
    rows = [
        ("restored", f"the backup of {record.begun_at:%Y-%m-%d %H:%M} UTC to {settings.data_dir}"),
        ("drives", f"{record.drives:,}, with {record.jobs:,} jobs"),
        ("size", f"{record.files:,} files, {size(record.size_bytes)}"),
    ]
    console.say({"backup": str(backup), "data_dir": str(settings.data_dir), **record.model_dump(mode="json")}, rows)
    if record.missing:
        raise InterLocError(
            f"the backup was restored as it is; files were missing in the service already: {_some(record.missing)}."
        )


def _some(names: list[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN:,} more" if len(names) > _SHOWN else "")


@click.group(short_help="Deleted drives: list, restore, empty.")
def trash() -> None:
    """Manage deleted drives. A running server sees the change at once.

    \b
    Example:
      interloc admin trash restore 5f0c2b7d9a41e386
    """


@trash.command("list")
@DATA_DIR
def list_(data_dir: Path | None) -> None:
    """List what can be restored, and until when."""
    from app.trash.deletion import list_trash

    with open_service(data_dir) as context:
        after, shown = None, 0
        while True:
            page = list_trash(context, after, 1000)
            for each in page.items:
                why = f"deleted by {each.deleted_by}" if each.deleted_by else "expired"
                click.echo(
                    f"{each.id}  {size(each.size_bytes):>9}  {each.deleted_at:%Y-%m-%d %H:%M} UTC "
                    f"{why}, gone {each.purged_at:%Y-%m-%d %H:%M} UTC  {each.name}"
                )
            shown += len(page.items)
            if (after := page.next) is None:
                break
    if not shown:
        click.echo("the trash is empty", err=True)


@trash.command("restore")
@click.argument("item", metavar="ID")
@DATA_DIR
def restore_item(item: str, data_dir: Path | None) -> None:
    """Take the drive ID out of the trash, with its jobs and their results."""
    from app.http.problems import Problem
    from app.trash import deletion

    with open_service(data_dir) as context:
        try:
            restored = deletion.restore(context, item)
        except Problem as problem:
            text = f"{item}: it is not in the trash; `interloc admin trash list` shows what is"
            raise ConfigError(text) from problem
    click.echo(f"drive {restored.id} ({restored.name}) is restored")


@trash.command()
@click.option("--older-than", type=click.FloatRange(min=0), metavar="H", help="Only what was deleted H hours ago.")
@DATA_DIR
def empty(older_than: float | None, data_dir: Path | None) -> None:
    """Delete what is in the trash for good."""
    from app.trash.deletion import empty_trash

    with open_service(data_dir) as context:
        purged = empty_trash(context, older_than_s=3600 * (older_than or 0.0))
    for each in purged:
        click.echo(f"{each.kind} {each.id}: {size(each.size_bytes)}")
    click.echo(f"{len(purged)} deleted for good, {size(sum(each.size_bytes for each in purged))}")


@click.group(short_help="Operate a service: tokens, check, trash, backups.")
def admin() -> None:
    """Operate a service: who may use it, whether rows and files agree, what was deleted, backups.

    \b
    Examples:
      interloc admin token add alice
      interloc admin backup /srv/backup --data-dir /srv/interloc
    """


for _command in (token, check, trash, backup, restore):
    admin.add_command(_command)
