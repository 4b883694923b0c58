"""How errors in the road labels change the result: the paper's experiment (section V-C, Table IV, Fig. 8).

A level of label errors is r-FPR / r-FNR in percent: the share of sidewalk, parking and other-ground points that are
labelled road, and the share of road points that are dropped.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from interloc.drawing import entitle, image, new_figure, quiet, series_style
from interloc.errors import ConfigError, OutputError
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.evaluation.published import LABEL_ERRORS
from interloc.evaluation.report import data_address, make_folder, report_record, template
from interloc.files import write_file
from interloc.output.geojson import rounded, write_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class LabelErrorRow:
    """Figures at one level of label errors, and what the paper reports for it; None for levels it does not have."""

    level: str
    """"5/20"."""
    r_fpr: float
    r_fnr: float
    """Shares, 0..1."""
    ace_m: float | None
    """Average over all matched pairs."""
    ace_under_10_m: float | None
    """Average over the pairs under 10 m."""
    precision: float | None
    recall: float | None
    f1: float | None
    """At D = 5 m."""
    nodes_found: int
    nodes_in_zone: int
    paper_ace_m: float | None
    paper_precision: float | None
    paper_recall: float | None


def parse_level(level: str) -> tuple[float, float]:
    """Return r-FPR and r-FNR as shares, 0..1, of a level in percent such as "5/20".

    Raises
    ------
    ConfigError
        It is not of this form, or a share is not between 0 and 100.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*/\s*(\d+(?:\.\d+)?)\s*", level)
    shares = tuple(float(part) / 100.0 for part in match.groups()) if match else ()
    if len(shares) != 2 or max(shares) > 1.0:
        raise ConfigError(f"level {level!r} is not valid. Expected r-FPR/r-FNR in percent, such as 5/20.")
    return shares[0], shares[1]


def label_error_table(levels: Sequence[tuple[str, Evaluation]]) -> list[LabelErrorRow]:
    """Return one row per level, in the given order, with the paper's figures beside those of this drive.

    Parameters
    ----------
    levels
        Level ("r-FPR/r-FNR" in percent) and the evaluation of the run with these label errors.

    Raises
    ------
    ConfigError
        A level is not valid.
    """
    rows = []
    for level, evaluation in levels:
        r_fpr, r_fnr = parse_level(level)
        name = f"{100.0 * r_fpr:g}/{100.0 * r_fnr:g}"
        published = LABEL_ERRORS.get(name)
        rows.append(
            LabelErrorRow(
                level=name,
                r_fpr=r_fpr,
                r_fnr=r_fnr,
                ace_m=evaluation.errors.ace_m,
                ace_under_10_m=evaluation.errors.ace_under_10_m,
                precision=evaluation.precision,
                recall=evaluation.recall,
                f1=evaluation.f1,
                nodes_found=evaluation.nodes_found,
                nodes_in_zone=evaluation.nodes_in_zone,
                paper_ace_m=published.ace_m if published else None,
                paper_precision=published.precision if published else None,
                paper_recall=published.recall if published else None,
            )
        )
    return rows


def label_error_figure(levels: Sequence[tuple[str, Evaluation]]) -> Figure:
    """Draw the center errors as boxes and F1 over the threshold, per level (paper, Fig. 8)."""
    from interloc.evaluation.figures import draw_boxes, scale_to_thresholds  # noqa: PLC0415 - matplotlib is slow to import

    figure = new_figure(10.5, 4.4)
    boxes, curves = figure.subplots(1, 2, width_ratios=(1, 1.25))
    names = [level for level, _ in levels]
    draw_boxes(boxes, [e.matching.error_m[e.matching.is_matched] for _, e in levels])
    boxes.set(xticks=range(1, len(names) + 1), xticklabels=names, xlim=(0.4, len(names) + 0.6))
    boxes.set_ylim(bottom=0.0)
    boxes.set(xlabel="label errors r-FPR / r-FNR [%]", ylabel="center error [m]")
    entitle(boxes, "Center error (5th, 25th, 50th, 75th, 95th percentile)", 10.5)
    quiet(boxes)

    for row, (name, evaluation) in enumerate(levels):
        scores = evaluation.scores
        shown = scores.threshold_m <= NEAR_PAIR_M
        curves.plot(scores.threshold_m[shown], 100.0 * scores.f1[shown], label=name, **series_style(row))
    scale_to_thresholds(curves)
    curves.set_ylabel("F1 [%]")
    entitle(curves, "F1 over the distance that still counts as found", 10.5)
    curves.legend(title="r-FPR / r-FNR [%]", loc="lower right", frameon=False, fontsize=9, title_fontsize=9)
    return figure


def write_label_errors(levels: Sequence[tuple[str, Evaluation]], out_dir: Path) -> None:
    """Write robustness.json, robustness.html and figures/robustness.png|svg into a folder.

    Raises
    ------
    ConfigError
        There is no level, or one is not valid.
    OutputError
        The folder is missing, or a file could not be written.
    """
    if not levels:
        raise ConfigError("no level of label errors is given. Expected at least one, such as 5/20.")
    if not out_dir.is_dir():
        raise OutputError(f"{out_dir}: no such folder.")
    rows = label_error_table(levels)
    figure = label_error_figure(levels)
    make_folder(out_dir / "figures")
    svg = image(figure, "svg")
    write_file(out_dir / "figures" / "robustness.png", image(figure, "png"))
    write_file(out_dir / "figures" / "robustness.svg", svg)
    first = levels[0][1]
    picture = data_address(svg, "image/svg+xml")
    page = template("robustness.html").render(
        rows=rows, picture=picture, record=report_record(first), standard=f"{STANDARD_THRESHOLD_M:g}\N{NO-BREAK SPACE}m"
    )
    write_file(out_dir / "robustness.html", page)
    record = {
        "drive": first.drive,
        "policy": first.nodes.policy,
        "threshold_m": STANDARD_THRESHOLD_M,
        "levels": [_record(row, evaluation) for row, (_, evaluation) in zip(rows, levels, strict=True)],
    }
    write_record(out_dir / "robustness.json", record)


def _record(row: LabelErrorRow, evaluation: Evaluation) -> dict[str, object]:
    """Return a row with what the figure shows of it, so that the figure can be drawn anew."""
    from interloc.evaluation.figures import PERCENTILES  # noqa: PLC0415 - matplotlib is slow to import

    errors = evaluation.matching.error_m[evaluation.matching.is_matched]
    boxes = np.percentile(errors, PERCENTILES) if len(errors) else [np.nan] * len(PERCENTILES)
    figures = {key: rounded(value, 6) if isinstance(value, float) else value for key, value in asdict(row).items()}
    return figures | {
        "error_percentiles_m": {f"{p:g}": rounded(v, 4) for p, v in zip(PERCENTILES, boxes, strict=True)},
        "f1_by_threshold": report_record(evaluation)["f1"],
    }
