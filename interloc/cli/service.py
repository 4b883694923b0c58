"""`interloc serve` and `admin`: the web service on this machine, who may use it, and its data."""

from __future__ import annotations

import os
import re
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.cli.console import size
from interloc.errors import ConfigError, InterLocError
from interloc.wording import counted, listed

if TYPE_CHECKING:
    from app.context import Context
    from app.settings import Settings

DATA_DIR = click.option(
    "--data-dir", type=click.Path(path_type=Path), help="Folder of drives and results.  [default: ./interloc-data]"
)


@click.command(short_help="Run the web service and its page.")
@click.option("--host", help="Address to listen on.  [default: 127.0.0.1]")
@click.option("--port", type=click.IntRange(0, 65535), help="Port to listen on; 0: any free one.  [default: 8000]")
@DATA_DIR
@click.option("--workers", type=click.IntRange(1, 256), help="Number of worker processes.  [default: one per core]")
@click.option(
    "--models", type=click.Path(path_type=Path), help="Folder of networks, one folder each, that label drives."
)
@click.option("--dask", metavar="ADDRESS", help="Dask scheduler that does the work instead, as tcp://host:8786.")
@click.option("--allow-anonymous", is_flag=True, default=None, help="Serve other machines without any token.")
@click.option("--root-path", metavar="PATH", help="Path under which a reverse proxy publishes the service.")
@click.option("--public-url", metavar="URL", help="Address under which people reach the service, for links.")
@click.option("--log-format", type=click.Choice(["json", "text"]), help="Format of the log on stderr.  [default: json]")
@click.option(
    "--log-level",
    type=click.Choice(["debug", "info", "warning", "error"]),
    help="Least severe messages to log.  [default: info]",
)
def serve(**given: Any) -> None:
    """Run the web service: upload drives, run jobs, see the results on a map.

    Every option is also a setting INTERLOC_<NAME> of the environment; docs/service.md lists them all.

    \b
    Examples:
      interloc serve                                        for this machine only
      interloc admin token add alice && interloc serve --host 0.0.0.0
    """
    settings = read_settings(given)
    from app.page.files import PageFiles
    from app.server import serve as run_server
    from interloc.results import versions

    def print_address(port: int) -> None:
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        address = f"http://{host}:{port}{settings.root_path}/"
        folder = Path(settings.data_dir).absolute()
        click.echo(f"InterLoc {versions()['interloc']} at {address} (data in {folder}); Ctrl-C stops it")
        if not PageFiles(settings).are_complete():
            click.echo(
                "The page is not installed, only the API: InterLoc was installed where npm was missing. Install npm, "
                "then run `make install` in the clone, or `pip install .` again."
            )
        for name, near in unknown_settings(os.environ):
            click.echo(f"{name} is not a setting and has no effect; {near}.")

    run_server(settings, print_address)


def unknown_settings(environment: Iterable[str]) -> list[tuple[str, str]]:
    """Return the variables that are no setting (any more), and which one is like it, or where all are listed.

    Those that Kubernetes sets for a service of this name are left out.
    """
    from app.settings import Settings

    known = [*(name.upper() for name in Settings.model_fields), "SERVER", "DEBUG"]
    found = []
    for name in sorted(environment):
        start, _, rest = name.upper().partition("_")
        if start == "INTERLOC" and rest not in known and not rest.startswith(("SERVICE_", "PORT_")):
            near = get_close_matches(rest, known[:-2], 1, 0.75)
            found.append((name, f"INTERLOC_{near[0]} is one" if near else "docs/service.md lists all"))
    return found


@click.group(short_help="Tokens of the web service: add, list, revoke.")
def token() -> None:
    """Manage who may use the web service. A running server applies the change within seconds.

    \b
    Examples:
      interloc admin token add alice
      interloc admin token add visitor --read-only --expires 30d
      interloc admin token add robot --max-bytes 200GB --max-jobs 5
    """


_UNITS = ("B", "kB", "MB", "GB", "TB")
_MAX_SIZE = 2**63  # bytes: no database counts as many


def _moment(text: str) -> float:
    """Return the seconds since 1970 of 30d, 12h or a date."""
    span = re.fullmatch(r"(\d{1,5})([dh])", text)
    if span is not None:
        return time.time() + int(span[1]) * {"d": 86400, "h": 3600}[span[2]]
    try:
        moment = datetime.fromisoformat(text)
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        raise click.BadParameter(f"{text!r}: expected 30d, 12h or a date such as 2030-12-31 (UTC).") from None


def _size(text: str) -> int:
    """Return a number of bytes; units are powers of 1024, as in the settings."""
    found = re.fullmatch(r"(\d{1,15}(?:\.\d{1,6})?) ?([kMGT]?B)?", text)
    size = int(float(found[1]) * 1024 ** _UNITS.index(found[2] or "B")) if found else _MAX_SIZE
    if size >= _MAX_SIZE:
        raise click.BadParameter(f"{text!r}: expected a number with kB, MB, GB or TB, for example 200GB.")
    return size


@token.command()
@click.argument("name")
@click.option("--read-only", is_flag=True, help="It may look at everything, and change nothing.")
@click.option(
    "--expires", type=_moment, metavar="WHEN", help="When it ends: 30d, 12h or a date (UTC).  [default: never]"
)
@click.option("--max-bytes", type=_size, metavar="SIZE", help="What it may keep, trash too, for example 200GB.")
@click.option("--max-jobs", type=click.IntRange(1), help="How many jobs of each kind may wait or run.")
@DATA_DIR
def add(
    name: str,
    read_only: bool,
    expires: float | None,
    max_bytes: int | None,
    max_jobs: int | None,
    data_dir: Path | None,
) -> None:
    """Make a token for NAME and print it: only its hash is kept, so it cannot be shown again."""
    settings = read_settings({"data_dir": data_dir})
    from app.context import open_database
    from app.states import Scope
    from app.store.tokens import add_token

    with _in_words(), closing(open_database(settings)) as database:
        text = add_token(
            database,
            name,
            scope=Scope.READ if read_only else Scope.WRITE,
            expires_at=expires,
            max_bytes=max_bytes,
            max_jobs=max_jobs,
        )
    click.echo(text)
    click.echo("Clients send it as `Authorization: Bearer TOKEN`; it is not shown again.", err=True)


@token.command("list")
@DATA_DIR
def list_(data_dir: Path | None) -> None:
    """List who has a token, what it allows, and when it was last used."""
    from app.store.tokens import list_tokens

    with open_service(data_dir) as context:
        tokens = list_tokens(context.database)
    for each in tokens:
        used = "no use noted yet" if each.last_used_at is None else f"used {_shown(each.last_used_at)}"
        parts = [f"{each.scope:<5} since {_shown(each.created_at)} UTC", used]
        if each.expires_at is not None:
            is_past = each.expires_at <= time.time()
            parts.append(f"{'expired' if is_past else 'expires'} {_shown(each.expires_at)}")
        if each.max_bytes is not None:
            power = max(power for power in range(len(_UNITS)) if power == 0 or each.max_bytes >= 1024**power)
            parts.append(f"{each.max_bytes / 1024**power:.7g} {_UNITS[power]}")
        if each.max_jobs is not None:
            parts.append(counted(each.max_jobs, "job"))
        click.echo(f"{each.name:<24} {', '.join(parts)}")
    if not tokens:
        click.echo("no tokens", err=True)


def _shown(moment: float) -> str:
    return f"{datetime.fromtimestamp(moment, UTC):%Y-%m-%d %H:%M}"


@token.command()
@click.argument("name")
@DATA_DIR
def revoke(name: str, data_dir: Path | None) -> None:
    """Refuse the token of NAME from now on."""
    from app.store.tokens import list_tokens, revoke_token

    with open_service(data_dir) as context:
        revoke_token(context.database, name)
        is_last = not list_tokens(context.database)
    click.echo(f"the token of {name} is revoked")
    if is_last:
        click.echo("no token is left: started anew on 127.0.0.1, the service is open, by a proxy too", err=True)


@contextmanager
def open_service(data_dir: Path | None) -> Iterator[Context]:
    """Open the service that has a data folder, as its operator."""
    settings = read_settings({"data_dir": data_dir})
    from app.context import Context

    with _in_words(), closing(Context.open_existing(settings)) as context:
        yield context


@contextmanager
def _in_words() -> Iterator[None]:
    """Say what a database objects to, without the statement and its values."""
    from sqlalchemy.exc import DBAPIError

    try:
        yield
    except DBAPIError as error:
        raise InterLocError(f"the database could not be read or written: {error.orig}.") from error


def read_settings(given: Mapping[str, Any]) -> Settings:
    """Read the settings from the environment and from the options that were given, which take precedence."""
    from pydantic import ValidationError

    from app.settings import Settings

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        name = "_".join(str(part) for part in first["loc"])
        option = f" or --{name.replace('_', '-')}" if name in given else ""
        where = f"INTERLOC_{name.upper()}{option}: " if name else ""
        raise ConfigError(f"{where}{first['msg']}") from error


_SHOWN = 10  # findings of one kind in one folder
_ALL = 1_000_000  # drives that may be in the trash


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
            f"{listed(record.missing, _SHOWN)}. `interloc admin check` names all."
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
            "the backup was restored as it is; files were missing in the service already: "
            f"{listed(record.missing, _SHOWN)}."
        )


@click.group(short_help="Deleted drives: list, restore, empty.")
def trash() -> None:
    """Manage deleted drives. A running server sees the change at once.

    \b
    Example:
      interloc admin trash restore 5f0c2b7d9a41e386
    """


@trash.command("list")
@DATA_DIR
def list_deleted(data_dir: Path | None) -> None:
    """List what can be restored, and until when."""
    from app.trash.deletion import list_trash

    with open_service(data_dir) as context:
        items = list_trash(context, None, _ALL).items
    for each in items:
        why = f"deleted by {each.deleted_by}" if each.deleted_by else "expired"
        click.echo(
            f"{each.id}  {size(each.size_bytes):>9}  {each.deleted_at:%Y-%m-%d %H:%M} UTC "
            f"{why}, gone {each.purged_at:%Y-%m-%d %H:%M} UTC  {each.name}"
        )
    if not items:
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
@DATA_DIR
def empty(data_dir: Path | None) -> None:
    """Delete what is in the trash for good."""
    from app.trash.deletion import empty_trash

    with open_service(data_dir) as context:
        purged = empty_trash(context)
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
