"""`interloc robustness`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from interloc.cli import console, options
from interloc.evaluation.published import LABEL_ERRORS
from interloc.wording import percent

if TYPE_CHECKING:
    from interloc.osm.policies import Policy


@click.command(cls=options.Command, short_help="Repeat the experiment on label errors.")
@options.evaluation_options
@click.option(
    "--levels",
    default=",".join(LABEL_ERRORS),
    show_default=True,
    help="Levels of label errors: r-FPR/r-FNR in percent.",
)
@click.option("--seed", default=0, show_default=True, help="Seed of the random label errors.")
def command(
    drive: Path,
    out: Path,
    policy: Policy,
    tolerance_m: float,
    levels: str,
    seed: int,
    workers: int | None,
    **given: Any,
) -> None:
    """Repeat the paper's experiment on errors of the road labels over DRIVE (Table IV, Fig. 8).

    Road points are dropped (r-FNR), and points of sidewalk, parking and other ground are labelled road (r-FPR).

    \b
    Example:
      interloc robustness sequences/07 -o out --osm map.osm.gz
    """
    from interloc.drives.label_errors import MislabelledDrive
    from interloc.evaluation.evaluate import Evaluation, evaluate
    from interloc.evaluation.label_errors import label_error_table, parse_level, write_label_errors
    from interloc.files import atomic_folder
    from interloc.pipeline import detect

    names = [name.strip() for name in levels.split(",")]
    shares = [parse_level(name) for name in names]
    source, config, graph = options.open_for_evaluation(drive, **given)
    evaluations: list[tuple[str, Evaluation]] = []
    with atomic_folder(out, marker="robustness.json") as folder:
        for name, (r_fpr, r_fnr) in zip(names, shares, strict=True):
            with console.progress(name, "keyframe") as bar:
                noisy = MislabelledDrive(source, r_fpr, r_fnr, seed)
                result = detect(noisy, config, workers=workers, progress=bar)
            if graph is None:
                graph = options.fetch_map(result)
            evaluation = evaluate(result, graph, policy=policy, tolerance_m=tolerance_m)
            evaluations.append((name, evaluation))
        write_label_errors(evaluations, folder)
    if console.wants_json():
        console.say_json({"levels": [asdict(row) for row in label_error_table(evaluations)]})
    if console.wants_json() or console.is_quiet():
        return
    click.echo("r-FPR/r-FNR   ACE [m]   Pre@5 [%]   Rec@5 [%]")
    for row in label_error_table(evaluations):
        ace = "-" if row.ace_m is None else f"{row.ace_m:.2f}"
        click.echo(f"{row.level:>11}   {ace:>7}   {percent(row.precision):>9}   {percent(row.recall):>9}")
    click.echo(f"report       {out / 'robustness.html'}")
