"""`interloc check`, `adopt` and `trash`: what the operator of a service does with its data."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from interloc.cli.console import progress, say_json, set_quiet, size
from interloc.cli.service import DATA_DIR, open_service, read_settings
from interloc.errors import ConfigError

if TYPE_CHECKING:
    from app.upkeep.check import Discrepancy

_SHOWN = 10  # findings of one kind in one folder

QUIET = click.option("--quiet", "-q", is_flag=True, expose_value=False, callback=set_quiet, help="Show no progress.")


@click.command(short_help="Compare the database of the service with its files.")
@DATA_DIR
@click.option("--repair", is_flag=True, help="Also do what is safe: nothing of a drive or of a result is removed.")
@click.option("--quick", is_flag=True, help="Compare sizes and times only, without reading the files.")
@click.option("--json", "as_json", is_flag=True, help="Print all findings as one JSON object.")
@QUIET
def check(data_dir: Path | None, *, repair: bool, quick: bool, as_json: bool) -> int:
    """Compare all rows of the database with all files: presence, size, digest; results; what belongs to nobody.

    The server may go on meanwhile. Exit code 0: nothing was found; 1: something was.

    \b
    Examples:
      interloc check --quick
      interloc check --repair
    """
    settings = read_settings({"data_dir": data_dir})
    from app.context import Context
    from app.store.installation import InstallationError
    from app.upkeep.check import Discrepancy
    from app.upkeep.check import check as check_all

    try:
        with closing(Context.open_existing(settings)) as context, progress("checking", " folders") as bar:
            found = check_all(context, repair=repair, quick=quick, progress=bar)
    except InstallationError as error:
        found = [Discrepancy("installation", ".", str(error))]
    if as_json:
        say_json({"ok": not found, "findings": [asdict(each) for each in found]})
    else:
        _say_findings(found)
    return int(bool(found))


def _say_findings(found: list[Discrepancy]) -> None:
    if not found:
        click.echo("nothing found: rows and files agree")
        return
    shown: Counter[tuple[str, str]] = Counter()
    for each in found:
        group = each.kind, "/".join(each.place.split("/")[:3])
        shown[group] += 1
        if shown[group] <= _SHOWN:
            click.echo(f"{each.place}: {each.message}" + (f" -> {each.repair}" if each.repair else ""))
    for (kind, folder), count in shown.items():
        if count > _SHOWN:
            click.echo(f"{folder}: and {count - _SHOWN:,} more of the kind {kind} (--json lists all)")
    repaired = sum(each.repair is not None for each in found)
    click.echo(f"{len(found):,} found, {repaired:,} repaired" + ("" if repaired else "; --repair does what is safe"))


@click.command(short_help="Make rows for drives and jobs whose rows are lost.")
@DATA_DIR
@click.option("--dry-run", is_flag=True, help="Only list what would be done.")
@QUIET
def adopt(data_dir: Path | None, *, dry_run: bool) -> None:
    """Make rows in the database for folders of drives and jobs that have none, and bind database and data folder.

    For a database that was lost, and for what the service has moved to lost+found. Tokens are not in the folder: make
    new ones with `interloc token add`.

    \b
    Example:
      interloc adopt --dry-run
    """
    with open_service(data_dir, bound=False) as context, progress("adopting", " folders") as bar:
        from app.upkeep.adopt import adopt as adopt_all

        outcomes = adopt_all(context, dry_run=dry_run, progress=bar)
    for each in outcomes:
        click.echo(f"{each.place}: {each.text}")
    adopted = sum(each.is_adopted for each in outcomes)
    verb = "would be adopted" if dry_run else "adopted; database and data folder belong together now"
    click.echo(f"{adopted} of {len(outcomes)} {verb}")


@click.group(short_help="Deleted drives and jobs: list, restore, empty.")
def trash() -> None:
    """Manage deleted drives and jobs. A running server sees the change at once.

    \b
    Example:
      interloc trash restore 5f0c2b7d9a41e386
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
                    f"{each.id}  {each.kind[:-1]:<5}  {size(each.size_bytes):>9}  {each.deleted_at:%Y-%m-%d %H:%M} UTC "
                    f"{why}, gone {each.purged_at:%Y-%m-%d %H:%M} UTC  {each.name}"
                )
            shown += len(page.items)
            if (after := page.next) is None:
                break
    if not shown:
        click.echo("the trash is empty", err=True)


@trash.command()
@click.argument("item", metavar="ID")
@DATA_DIR
def restore(item: str, data_dir: Path | None) -> None:
    """Take the drive or the job ID out of the trash, a drive with its jobs and their results."""
    from app.http.problems import Problem
    from app.trash.deletion import restore as restore_item

    with open_service(data_dir) as context:
        try:
            restored = restore_item(context, "drives", item)
        except Problem:
            try:
                restored = restore_item(context, "jobs", item)
            except Problem as problem:
                text = f"{item}: it is not in the trash; `interloc trash list` shows what is"
                raise ConfigError(problem.detail if problem.status == 409 else text) from problem
    click.echo(f"{restored.kind[:-1]} {restored.id} ({restored.name}) is restored")


@trash.command()
@click.option("--older-than", type=click.FloatRange(min=0), metavar="H", help="Only what was deleted H hours ago.")
@DATA_DIR
def empty(older_than: float | None, data_dir: Path | None) -> None:
    """Delete what is in the trash for good."""
    from app.trash.deletion import empty_trash

    with open_service(data_dir) as context:
        purged = empty_trash(context, older_than_s=3600 * (older_than or 0.0))
    for each in purged:
        click.echo(f"{each.kind[:-1]} {each.id}: {size(each.size_bytes)}")
    click.echo(f"{len(purged)} deleted for good, {size(sum(each.size_bytes for each in purged))}")
