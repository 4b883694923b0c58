"""`interloc compare`."""

from pathlib import Path
from typing import Any

import click

from interloc.cli import console, options
from interloc.wording import counted


@click.command(short_help="Put the reports of several results side by side.")
@click.argument("results", nargs=-1, required=True, type=options.PATH)
@options.JSON
def command(results: tuple[Path, ...]) -> None:
    """Show in which inputs and settings RESULTS differ, their figures, and which intersections only one of them found.

    RESULTS are two or more result folders of `interloc run` over one drive.

    \b
    Example:
      interloc compare out_default out_paper
    """
    from interloc.errors import ConfigError
    from interloc.evaluation.compare import compare_reports
    from interloc.output.geojson import read_json
    from interloc.output.read import read_run

    names = [console.shown(str(result)) for result in results]
    runs = [read_run(result) for result in results]
    for result in results:
        if not (result / "report.json").is_file():
            raise ConfigError(
                f"{result} was not scored against a map: `interloc evaluate {result} --osm FILE` does that"
            )
    reports = [read_json(result / "report.json") for result in results]
    comparison = compare_reports(names, reports, runs)
    if console.wants_json():
        console.say_json(comparison.model_dump())
        return
    for name, report in zip(names, reports, strict=True):
        click.echo(f"{name}: {report['map_line']}")
    click.echo()
    _print_table(["", *names], [[row.title, *map(_text, row.values)] for row in comparison.figures])
    _print_table(["input", *names], [[row.name, *map(_text, row.values)] for row in comparison.inputs])
    _print_table(["setting", *names], [[row.name, *map(_text, row.values)] for row in comparison.settings])
    if not comparison.settings:
        click.echo("the same settings\n")
    found, missed = comparison.found_by_all, comparison.missed_by_all
    click.echo(f"{counted(found, 'OSM node')} found by all, {counted(missed, 'OSM node')} missed by all")
    for name, only in zip(names, comparison.found_only_by, strict=True):
        click.echo(f"only {name}: {len(only)}" + (f" ({', '.join(map(str, only[:20]))})" if only else ""))
    for warning in comparison.warnings:
        click.echo(f"note: {warning}")


def _print_table(head: list[str], rows: list[list[str]]) -> None:
    """Print a table, where it has rows, and an empty line."""
    if not rows:
        return
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    for row in [head, *rows]:
        first, *rest = (
            text.ljust(w) if i == 0 else text.rjust(w) for i, (text, w) in enumerate(zip(row, widths, strict=True))
        )
        click.echo("  ".join([first, *rest]).rstrip())
    click.echo()


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else str(value)
