"""`interloc serve` and `interloc admin token`: the web service on this machine, and who may use it."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.errors import ConfigError
from interloc.wording import counted

if TYPE_CHECKING:
    from app.context import Context
    from app.settings import Settings
    from app.store.database import Database

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
    from interloc.pipeline import versions

    def print_address(port: int) -> None:
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        address = f"http://{host}:{port}{settings.root_path}/"
        folder = Path(settings.data_dir).absolute()
        click.echo(f"InterLoc {versions()['interloc']} at {address} (data in {folder}); Ctrl-C stops it")
        if not PageFiles(settings).are_complete():
            click.echo(
                "The page is not installed, only the API: InterLoc was installed where npm was missing. Install npm, "
                "then run `make install` in the clone, or `pip install .` again.",
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
            near = get_close_matches(rest, known, 1, 0.75)
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
    if found is None:
        raise click.BadParameter(f"{text!r}: expected a number with kB, MB, GB or TB, for example 200GB.")
    return int(float(found[1]) * 1024 ** _UNITS.index(found[2] or "B"))


def _size_text(count: int) -> str:
    """Return the text that `_size` reads."""
    power = max(power for power in range(len(_UNITS)) if power == 0 or count >= 1024**power)
    return f"{count / 1024**power:,.4g} {_UNITS[power]}"


@token.command()
@click.argument("name")
@click.option("--read-only", is_flag=True, help="It may look at everything, and change nothing.")
@click.option(
    "--expires", type=_moment, metavar="WHEN", help="When it ends: 30d, 12h or a date (UTC).  [default: never]"
)
@click.option("--max-bytes", type=_size, metavar="SIZE", help="What it may keep on disk, for example 200GB.")
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
    from app.states import Scope
    from app.store.tokens import add_token

    with _database(data_dir) as database:
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
            parts.append(_size_text(each.max_bytes))
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
    from app.store.tokens import revoke_token

    with open_service(data_dir) as context:
        revoke_token(context.database, name)
    click.echo(f"the token of {name} is revoked")


@contextmanager
def _database(data_dir: Path | None) -> Iterator[Database]:
    settings = read_settings({"data_dir": data_dir})
    from app.context import open_database

    with closing(open_database(settings)) as database:
        yield database


@contextmanager
def open_service(data_dir: Path | None) -> Iterator[Context]:
    """Open the service that has a data folder, as its operator."""
    settings = read_settings({"data_dir": data_dir})
    from app.context import Context

    with closing(Context.open_existing(settings)) as context:
        yield context


def read_settings(given: dict[str, Any]) -> Settings:
    """Read the settings from the environment and from the options that were given, which take precedence."""
    from pydantic import ValidationError

    from app.settings import Settings

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        name = "_".join(str(part) for part in first["loc"])
        raise ConfigError(f"INTERLOC_{name.upper()} or --{name.replace('_', '-')}: {first['msg']}") from error
