"""`interloc evaluate`."""

from __future__ import annotations

from pathlib import Path

import click

from interloc.cli import console, options, summary


@click.command(cls=options.Command, short_help="Score a result against OpenStreetMap.")
@click.argument("out", type=options.PATH)
@options.TRUTH
@options.OUTPUT
def command(out: Path, truth: options.Truth) -> None:
    """Score OUT, the result folder of `interloc run`, against OpenStreetMap.

    \b
    Example:
      interloc evaluate out --osm map.osm.gz
    """
    from interloc.errors import Beside
    from interloc.evaluation.evaluate import evaluate
    from interloc.evaluation.report import write_report
    from interloc.files import write_file
    from interloc.output.layout import RUN_NAMES, result_folder
    from interloc.output.read import read_results

    truth.check()
    result = read_results(out)
    graph = options.read_map(truth.osm, result.keyframes.lonlat)
    if graph is None:
        graph = options.fetch_map(result)
    evaluation = evaluate(result, graph, **truth.scoring())
    beside = Beside()
    with result_folder(out) as folder:  # the whole new report, or the folder as it was
        for name in filter(lambda name: (out / name).is_file(), RUN_NAMES):
            write_file(folder / name, (out / name).read_bytes())
        report = write_report(evaluation, folder, beside=beside)
    console.say(report, summary.report_facts(report, out))
    beside.check(out)
