"""The paper's tables with our rows beside the published ones: pooled over drives, mean and spread over seeds."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

from interloc.arrays import FloatArray
from interloc.evaluation.compare import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE, SEQUENCES, Published
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.lab.measure import Row

MISSING = "–"  # noqa: RUF001 - a dash, not a minus
PUBLISHED = "published"
NO_NOISE = "0/0"
ALL = "all"
PRECISION_THRESHOLD_M, RECALL_THRESHOLD_M = 6.9, 13.3
"""Of the comparison with MMInsectDet (paper, section V-B)."""


def pooled(rows: Sequence[Row], column: str) -> FloatArray:
    """Return the values of all rows, one after the other, of a field of `Row` that holds several."""
    return np.array([each for row in rows for each in getattr(row, column)], dtype=np.float64)


def scores(rows: Sequence[Row], threshold_m: float = STANDARD_THRESHOLD_M) -> tuple[float, float, float]:
    """Return precision, recall and F1 at a threshold (paper, eq. 18); NaN where there is nothing to count."""
    true = int(np.count_nonzero(pooled(rows, "errors_m") < threshold_m))
    detections = sum(len(row.errors_m) + row.unmatched for row in rows)
    missed = sum(row.fn for row in rows)
    return _ratio(true, detections), _ratio(true, true + missed), _ratio(2 * true, true + detections + missed)


def figures(rows: Sequence[Row]) -> dict[str, float]:
    """Return the figures of some rows, pooled as if they were one drive, as `benchmark.json` names them.

    NaN where a figure is undefined. Those of the map are of the fused intersections, matched one-to-one.
    """
    errors_m, map_errors_m = pooled(rows, "errors_m"), pooled(rows, "map_errors_m")

    def total(name: str) -> float:
        return float(sum(getattr(row, name) for row in rows))

    precision, recall, f1 = scores(rows)
    return {
        "ace_m": _of(np.mean, errors_m),
        "ace_under_10_m": _of(np.mean, errors_m[errors_m < NEAR_PAIR_M]),
        "precision_at_5": precision,
        "recall_at_5": recall,
        "f1_at_5": f1,
        "precision_at_6_9": scores(rows, PRECISION_THRESHOLD_M)[0],
        "recall_at_13_3": scores(rows, RECALL_THRESHOLD_M)[1],
        "nodes_found": total("nodes_found"),
        "nodes_in_zone": total("nodes_in_zone"),
        "map_precision": _ratio(total("map_true"), total("map_true") + total("map_false")),
        "map_recall": _ratio(total("map_nodes") - total("map_missed"), total("map_nodes")),
        "map_median_m": _of(np.median, map_errors_m),
    }


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else np.nan


def _of(function: Callable[[FloatArray], object], values: FloatArray) -> float:
    return float(function(values)) if len(values) else np.nan  # type: ignore[arg-type]


def pools(rows: Sequence[Row]) -> Iterator[tuple[int, list[Row]]]:
    """Yield each seed with the row of every drive.

    Where only some drives have several seeds (without label errors, a recorded drive has but one), the drives with
    one seed take part in every pool.
    """
    by_drive: dict[str, dict[int, Row]] = {}
    for row in rows:
        by_drive.setdefault(row.cell.drive, {})[row.cell.seed] = row
    for seed in sorted({row.cell.seed for row in rows}):
        yield seed, [of_drive.get(seed) or of_drive[min(of_drive)] for of_drive in by_drive.values()]


class Table(NamedTuple):
    """A table as a person reads it: all cells are text."""

    title: str
    frame: pd.DataFrame
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the table in aligned columns."""
        lines = (line.rstrip() for line in self.frame.to_string().splitlines())
        return "\n".join([self.title, "", *lines, "", *self.notes])


@dataclass(frozen=True)
class Measured:
    """The rows of a benchmark, by what they are."""

    rows: tuple[Row, ...]
    drives: tuple[str, ...]
    presets: tuple[str, ...]
    noises: tuple[str, ...]
    """In the order of the tables."""

    def of(self, *, preset: str, noise: str, drive: str = ALL) -> list[Row]:
        """Return the rows of a preset at a level of label errors, of one drive or all."""
        wanted = (preset, noise)
        return [
            row for row in self.rows if (row.cell.preset, row.cell.noise) == wanted and drive in {ALL, row.cell.drive}
        ]

    @cached_property
    def estimates(self) -> pd.DataFrame:
        """Every figure by preset, level and drive (or "all", pooled): columns (figure, mean / std / count) over seeds.

        The sample standard deviation; NaN for one seed. The count is that of the seeds for which it is defined.
        """
        found = {
            (preset, noise, drive, seed): figures(pool)
            for preset, noise, drive in product(self.presets, self.noises, (*self.drives, ALL))
            for seed, pool in pools(self.of(preset=preset, noise=noise, drive=drive))
        }
        by_seed = pd.DataFrame.from_dict(found, orient="index")
        return by_seed.groupby(level=[0, 1, 2], sort=False).agg(["mean", "std", "count"])


def ours(preset: str) -> str:
    """Return the name of a preset in the tables: `paper` alone would look like what the paper reports."""
    return f"preset {preset}"


metres, one_decimal = "{:.2f}".format, "{:.1f}".format


def percent(value: float) -> str:
    """Write a share in percent in a table."""
    return f"{100.0 * value:.1f}"


_COLUMNS: dict[str, tuple[str, Callable[[float], str]]] = {
    "ACE [m]": ("ace_m", metres),
    "< 10 m": ("ace_under_10_m", metres),
    "Pre@5 [%]": ("precision_at_5", percent),
    "Rec@5 [%]": ("recall_at_5", percent),
    "Pre@6.9": ("precision_at_6_9", percent),
    "Rec@13.3": ("recall_at_13_3", percent),
    "nodes": ("nodes_found", one_decimal),
    "in zone": ("nodes_in_zone", one_decimal),
    "map: precision [%]": ("map_precision", percent),
    "recall [%]": ("map_recall", percent),
    "median [m]": ("map_median_m", metres),
}
"""Title of a column -> which of the `figures`, and how it is written."""


def table_of(
    title: str,
    lines: Mapping[tuple[str, ...], Iterable[str]],
    columns: Iterable[str],
    notes: tuple[str, ...] = (),
    *,
    names: Sequence[str] | None = None,
) -> Table:
    """Return a table of the cells of each line, by the words before it; `names` stand over these words."""
    index = pd.MultiIndex.from_tuples(lines, names=names)
    return Table(
        title, pd.DataFrame([list(cells) for cells in lines.values()], index=index, columns=list(columns)), notes
    )


def _published(drive: str, noise: str) -> dict[str, dict[str, float]]:
    """Return what the paper reports of a drive, or of all (its tables II, III and IV), by whose figures these are."""

    def at_5(figures: Published) -> dict[str, float]:
        return {"ace_m": figures.ace_m, "precision_at_5": figures.precision, "recall_at_5": figures.recall}

    if drive != ALL:
        return {PUBLISHED: at_5(PERFORMANCE[drive])} if noise == NO_NOISE and drive in PERFORMANCE else {}
    if noise != NO_NOISE:
        return {PUBLISHED: at_5(LABEL_ERRORS[noise])} if noise in LABEL_ERRORS else {}
    compared = {
        name: {"ace_m": each.ace_m, "precision_at_6_9": each.precision, "recall_at_13_3": each.recall}
        for name, each in COMPARISON.items()
    }
    method, ours_there = compared
    return {
        PUBLISHED: at_5(AVERAGE) | compared[ours_there],
        f"{PUBLISHED}, hand labels": at_5(LABEL_ERRORS[noise]),
        f"{method}, {PUBLISHED}": compared[method],
    }


def results_table(measured: Measured) -> Table:
    """Return all figures by level of label errors and drive, pooled last, with those of the paper beside them."""

    def cells(values: Mapping[str, tuple[float, float]]) -> list[str]:
        written = []
        for name, write in _COLUMNS.values():
            mean, spread = values.get(name, (np.nan, np.nan))
            one = MISSING if np.isnan(mean) else write(mean)
            written.append(one if np.isnan(spread) else f"{one} ± {write(spread)}")
        return written

    lines: dict[tuple[str, ...], Iterable[str]] = {}
    for noise, drive in product(measured.noises, (*measured.drives, ALL)):
        for who, values in _published(drive, noise).items():
            lines[noise, drive, who] = cells({name: (value, np.nan) for name, value in values.items()})
        for preset in measured.presets:
            found = measured.estimates.loc[preset, noise, drive].unstack()  # noqa: PD010 - back to a row per figure
            lines[noise, drive, ours(preset)] = cells({name: (mean, std) for name, (mean, std, _) in found.iterrows()})
    notes = [
        "Label errors in percent, r-FPR/r-FNR, on top of the labels as they are. All: detections, misses, errors and",
        "nodes of all drives taken together, as the paper's average is.",
        "Published: SemanticKITTI with RangeNet++ labels, where label errors are added with hand labels; of all: its",
        f"sequences {', '.join(SEQUENCES)}.",
    ]
    seeds = len({row.cell.seed for row in measured.rows})
    if seeds > 1:
        notes.append(f"{seeds} seeds: mean ± standard deviation over the seeds.")
    return table_of(
        "Performance, comparison with MMInsectDet, and errors of the labels (tables II to IV of the paper)",
        lines,
        _COLUMNS,
        tuple(notes),
        names=["label errors", "drive", ""],
    )


def axes_table(measured: Measured) -> Table:
    """Return how far fused intersections are from where the axes of the roads meet, where somebody read that."""
    lines: dict[tuple[str, ...], Iterable[str]] = {}
    for drive, preset in product(measured.drives, measured.presets):
        errors = pooled(measured.of(preset=preset, noise=measured.noises[0], drive=drive), "map_axes_errors_m")
        cells = [metres(float(of(column))) for column in errors.T for of in (np.mean, np.median, np.max)]
        lines[drive, ours(preset)] = [str(len(errors)), *(cells or [MISSING] * 6)]
    return table_of(
        "Errors from where the axes of the roads meet",
        lines,
        ["places", *(f"from {what}: {which}" for what in ("nodes", "axes") for which in ("mean", "median", "worst"))],
        (
            "Metres, of the intersections of the map at nodes whose axes were read: from the node of OpenStreetMap,",
            "and from the point where the axes of the roads meet.",
        ),
    )


def tables(measured: Measured) -> list[Table]:
    """Return the tables of a benchmark: the results, and the errors from where the axes meet, where that is known."""
    has_axes = any(row.map_axes_errors_m for row in measured.rows)
    return [results_table(measured), *([axes_table(measured)] if has_axes else [])]
