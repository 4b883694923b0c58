"""The paper's tables with our rows beside the published ones: pooled over drives, mean and spread over seeds."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd

from interloc.arrays import FloatArray
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.evaluation.published import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE, RANGENET, SEQUENCES, Published
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
        "ms_a_keyframe": 1e3 * _ratio(total("compute_s"), total("keyframes")),
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
    labels: str = "labels"
    """"labels" (by hand, or exact) or "predictions" (of a network)."""

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

    @property
    def is_papers_set(self) -> bool:
        """True where the drives are the eight of the paper, so that "all" is its average."""
        return sorted(self.drives) == sorted(SEQUENCES)

    @property
    def note_on_seeds(self) -> tuple[str, ...]:
        """What to say of spreads."""
        seeds = len({row.cell.seed for row in self.rows})
        return (f"{seeds} seeds: mean ± standard deviation over the seeds.",) if seeds > 1 else ()

    @property
    def note_on_published(self) -> tuple[str, ...]:
        """What to say where the published figures are of other drives."""
        if self.is_papers_set:
            return ()
        names = ", ".join(self.drives) if len(self.drives) <= 12 else f"{len(self.drives)} drives"
        return (f"Published: all eight sequences of SemanticKITTI; this run: {names}.",)


def ours(preset: str) -> str:
    """Return the name of a preset in the tables: `paper` alone would look like what the paper reports."""
    return f"preset {preset}"


def metres(value: float) -> str:
    """Write metres in a table."""
    return f"{value:.2f}"


def percent(value: float) -> str:
    """Write a share in percent in a table."""
    return f"{100.0 * value:.1f}"


def one_decimal(value: float) -> str:
    """Write a number with one decimal."""
    return f"{value:.1f}"


class Figure(NamedTuple):
    """A figure of the tables."""

    title: str
    name: str
    """One of `figures`."""
    write: Callable[[float], str]
    published: str = ""
    """The same figure among those of the paper."""
    total: str = ""
    """Name of the number that it is a count out of: "25/26"."""

    def cell(self, measured: Measured, preset: str, noise: str, drive: str = ALL) -> str:
        """Return the figure as text: mean and, with several seeds, spread."""
        mean, spread, seeds = measured.estimates.loc[(preset, noise, drive), self.name]
        if np.isnan(mean):
            return MISSING
        if self.total:
            total = measured.estimates.loc[(preset, noise, drive), (self.total, "mean")]
            return f"{mean:.0f}/{total:.0f}" if seeds == 1 else f"{mean:.1f}/{total:.1f}"
        return self.write(mean) if np.isnan(spread) else f"{self.write(mean)} ± {self.write(spread)}"

    def published_cell(self, published: Published | None) -> str:
        """Return the figure of the paper."""
        value = getattr(published, self.published, None)
        return MISSING if value is None else self.write(value)


_ACE = Figure("ACE [m]", "ace_m", metres, "ace_m")
_PRECISION = Figure("Pre@5 [%]", "precision_at_5", percent, "precision")
_RECALL = Figure("Rec@5 [%]", "recall_at_5", percent, "recall")
_OF_DRIVES = (
    _ACE,
    Figure("ACE, pairs < 10 m [m]", "ace_under_10_m", metres),
    _PRECISION,
    _RECALL,
    Figure("nodes found / in zone", "nodes_found", one_decimal, total="nodes_in_zone"),
    Figure("map precision [%]", "map_precision", percent),
    Figure("map recall [%]", "map_recall", percent),
    Figure("map median error [m]", "map_median_m", metres),
    Figure("ms per keyframe", "ms_a_keyframe", one_decimal),
)
_OF_LEVELS = (_ACE, _PRECISION, _RECALL)
_OF_COMPARISON = (
    _ACE,
    Figure("Pre@6.9 [%]", "precision_at_6_9", percent, "precision"),
    Figure("Rec@13.3 [%]", "recall_at_13_3", percent, "recall"),
)


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


def performance_table(measured: Measured, noise: str) -> Table:
    """Return the performance per drive (paper, Table "Performance on SemanticKITTI sequences") at a level of errors."""
    columns = [*measured.drives, *([ALL] if len(measured.drives) > 1 else [])]
    average = AVERAGE if measured.is_papers_set else None
    known = [average if each == ALL else PERFORMANCE.get(each) for each in columns] if noise == NO_NOISE else []
    lines: dict[tuple[str, ...], Iterable[str]] = {}
    for figure in _OF_DRIVES:
        if figure.published and any(known):
            lines[figure.title, PUBLISHED] = [figure.published_cell(each) for each in known]
        for preset in measured.presets:
            lines[figure.title, ours(preset)] = [figure.cell(measured, preset, noise, each) for each in columns]
    notes = []
    if ALL in columns:
        notes.append(
            "All: detections, misses, errors and nodes of all drives taken together, as the paper's average is."
        )
    if any(known):
        notes.append("Published: SemanticKITTI with RangeNet++ labels.")
    level = "" if noise == NO_NOISE else f", label errors {noise} %"
    return table_of(f"II. Performance per drive{level}", lines, columns, (*notes, *measured.note_on_seeds))


def comparison_table(measured: Measured) -> Table:
    """Return the comparison with MMInsectDet (paper, Table "Performance comparison with MMInsectDet")."""
    lines: dict[tuple[str, ...], Iterable[str]] = {
        (name,): [figure.published_cell(value) for figure in _OF_COMPARISON] for name, value in COMPARISON.items()
    }
    for preset in measured.presets:
        cells = [figure.cell(measured, preset, measured.noises[0]) for figure in _OF_COMPARISON]
        lines[f"InterLoc, {ours(preset)}",] = cells
    columns = [figure.title for figure in _OF_COMPARISON]
    return table_of("III. Comparison with MMInsectDet", lines, columns, measured.note_on_published)


def noise_table(measured: Measured) -> Table:
    """Return the performance at each level of label errors (paper, Table "... different segmentation error levels")."""
    is_predicted = measured.labels == "predictions"
    lines: dict[tuple[str, ...], Iterable[str]] = {}
    for noise in measured.noises:
        published = RANGENET if noise == NO_NOISE and is_predicted else LABEL_ERRORS.get(noise)
        if published is not None:
            lines[noise, PUBLISHED] = [figure.published_cell(published) for figure in _OF_LEVELS]
        for preset in measured.presets:
            lines[noise, ours(preset)] = [figure.cell(measured, preset, noise) for figure in _OF_LEVELS]
    source = "RangeNet++ labels" if is_predicted else "hand labels"
    note = f"Label errors in percent, on top of the labels as they are; 0/0 published: {source}."
    return table_of(
        "IV. Errors of the labels",
        lines,
        [figure.title for figure in _OF_LEVELS],
        (note, *measured.note_on_published),
        names=["r-FPR/r-FNR", ""],
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
    """Return the tables of a benchmark: performance, comparison, label errors, and errors from known axes."""
    shown = [performance_table(measured, measured.noises[0]), comparison_table(measured), noise_table(measured)]
    return [*shown, axes_table(measured)] if any(row.map_axes_errors_m for row in measured.rows) else shown
