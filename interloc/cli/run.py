"""`interloc run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options, summary

if TYPE_CHECKING:
    from interloc.osm.policies import Policy


@click.command(short_help="Detect, map and evaluate in one go.")
@options.evaluation_options
def command(
    drive: Path,
    out: Path,
    policy: Policy,
    tolerance_m: float,
    workers: int | None,
    quiet: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Detect, map and evaluate DRIVE in one go; the report is OUT/report.html.

    \b
    Example:
      interloc run sequences/07 -o out --osm karlsruhe.osm.pbf --oxts 2011_09_30_drive_0027_sync
    """
    from interloc.evaluation.evaluate import evaluate
    from interloc.evaluation.report import report_record, write_report
    from interloc.output.layout import result_folder
    from interloc.output.write import write_results
    from interloc.pipeline import detect

    source, config, graph = options.open_for_evaluation(drive, quiet=quiet, **given)
    with result_folder(out) as folder:
        with console.progress("detect", "keyframe", quiet=quiet) as bar:
            result = detect(source, config, workers=workers, progress=bar)
        write_results(result, folder)
        if graph is None:
            graph = options.fetch_map(result, quiet=quiet)
        evaluation = evaluate(result, graph, policy=policy, tolerance_m=tolerance_m)
        write_report(evaluation, result, folder)
    report = report_record(evaluation)
    if as_json:
        console.say_json({"run": summary.run_summary(result, out), "report": report})
    elif not quiet:
        console.say_facts(summary.run_facts(result, out)[:-1] + summary.report_facts(report, out))
