"""`interloc token`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli import service

if TYPE_CHECKING:
    from app.store.database import Database


@click.group(short_help="Tokens of the web service: add, list, revoke.")
def command() -> None:
    """Say who may use the web service. A server that runs takes the change within seconds.

    \b
    Example:
      interloc token add alice
    """


@command.command()
@click.argument("name")
@service.DATA_DIR
def add(name: str, data_dir: Path | None) -> None:
    """Make a token for NAME and print it: it is kept as a hash only, and cannot be shown again."""
    from app.store.tokens import add_token

    with _database(data_dir) as database:
        token = add_token(database, name)
    click.echo(token)
    click.echo("Clients send it as `Authorization: Bearer TOKEN`; it is not shown again.", err=True)


@command.command("list")
@service.DATA_DIR
def list_(data_dir: Path | None) -> None:
    """List who has a token, and since when."""
    from app.store.tokens import list_tokens

    with _database(data_dir) as database:
        tokens = list_tokens(database)
    for token in tokens:
        click.echo(f"{token.name:<24} since {datetime.fromtimestamp(token.created_at, UTC):%Y-%m-%d %H:%M} UTC")
    if not tokens:
        click.echo("no tokens", err=True)


@command.command()
@click.argument("name")
@service.DATA_DIR
def revoke(name: str, data_dir: Path | None) -> None:
    """Refuse the token of NAME from now on."""
    from app.store.tokens import revoke_token

    with _database(data_dir) as database:
        revoke_token(database, name)
    click.echo(f"the token of {name} is revoked")


@contextmanager
def _database(data_dir: Path | None) -> Iterator[Database]:
    settings = service.read_settings({"data_dir": data_dir})
    from app.context import open_database

    database = open_database(settings)
    try:
        yield database
    finally:
        database.close()
