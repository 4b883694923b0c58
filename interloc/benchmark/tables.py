"""The paper's tables with our rows beside the published ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from interloc.benchmark.metrics import METRICS, Estimate, estimate, map_outcomes, pooled
from interloc.benchmark.row import Row
from interloc.evaluation.published import AVERAGE, COMPARISON, LABEL_ERRORS, PERFORMANCE, RANGENET, SEQUENCES, Published
from interloc.evaluation.reliability import (
    Interval,
    calibration_error,
    calibration_error_by_chance,
    share_within,
    squared_per_dimension,
    with_interval,
)

MISSING = "–"  # noqa: RUF001 - a dash, not a minus
PUBLISHED = "published"
NO_NOISE = "0/0"
ALL = "all"


@dataclass(frozen=True)
class Table:
    """A table as text."""

    title: str
    header: tuple[str, ...]
    groups: tuple[tuple[tuple[str, ...], ...], ...]
    """Rows that belong together; a line is drawn between groups."""
    labels: int = 1
    """The first columns are words, the others are figures."""
    notes: tuple[str, ...] = ()


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
    sensors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Drives by the sensor that they were simulated with, where several sensors are compared."""

    def of(self, *, preset: str, noise: str, drive: str = ALL) -> list[Row]:
        """Return the rows of a preset at a level of label errors, of one drive or all."""
        return [
            row
            for row in self.rows
            if row.cell.preset == preset and row.cell.noise == noise and drive in {ALL, row.cell.drive}
        ]

    def estimate(self, metric: str, *, preset: str, noise: str, drive: str = ALL) -> Estimate:
        """Return a figure of `METRICS`: pooled over the drives, mean and spread over the seeds."""
        return estimate(self.of(preset=preset, noise=noise, drive=drive), METRICS[metric])

    @cached_property
    def reliability(self) -> dict[tuple[str, str], dict[str, Interval]]:
        """How true uncertainty and confidence are, by preset and level: intersections of all drives and seeds."""
        found = {}
        for preset, noise in product(self.presets, self.noises):
            rows = self.of(preset=preset, noise=noise)
            squared = pooled(rows, "map_squared")
            confidence, right = map_outcomes(rows)
            found[preset, noise] = {
                "within_95": with_interval(share_within, squared),
                "nees": with_interval(squared_per_dimension, squared),
                "calibration_error": with_interval(calibration_error, confidence, right),
                "calibration_error_by_chance": calibration_error_by_chance(confidence),
            }
        return found

    @property
    def is_papers_set(self) -> bool:
        """True where the drives are the eight of the paper, so that "all" is its average."""
        return sorted(self.drives) == sorted(SEQUENCES)


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


def counted(found: Estimate, total: Estimate) -> str:
    """Write a count and its total: "25/26"; with several seeds the means."""
    if found.mean is None or total.mean is None:
        return MISSING
    if found.seeds == 1:
        return f"{found.mean:.0f}/{total.mean:.0f}"
    return f"{found.mean:.1f}/{total.mean:.1f}"


def _write(value: Estimate, write: Callable[[float], str]) -> str:
    if value.mean is None:
        return MISSING
    return write(value.mean) if value.spread is None else f"{write(value.mean)} ± {write(value.spread)}"


class TableFigure(NamedTuple):
    """A figure of the tables."""

    title: str
    metric: str
    """One of `METRICS`."""
    write: Callable[[float], str]
    """Writes its value."""
    published: str = ""
    """The same figure among those of the paper."""
    total: str = ""
    """Metric of the number that it is a count out of."""

    def cell(self, rows: Sequence[Row]) -> str:
        """Return the figure of some rows: pooled over the drives, mean and spread over the seeds."""
        found = estimate(rows, METRICS[self.metric])
        return counted(found, estimate(rows, METRICS[self.total])) if self.total else _write(found, self.write)

    def published_cell(self, published: Published | None) -> str:
        """Return the figure of the paper."""
        return _write(Estimate(getattr(published, self.published, None)), self.write)


_ACE = TableFigure("ACE [m]", "ace_m", metres, "ace_m")
_PRECISION = TableFigure("Pre@5 [%]", "precision_at_5", percent, "precision")
_RECALL = TableFigure("Rec@5 [%]", "recall_at_5", percent, "recall")
_NODES = TableFigure("nodes found / in zone", "nodes_found", one_decimal, total="nodes_in_zone")
_TIME = TableFigure("ms per keyframe", "ms_a_keyframe", one_decimal)
_OF_DRIVES = (
    _ACE,
    TableFigure("ACE, pairs < 10 m [m]", "ace_under_10_m", metres),
    _PRECISION,
    _RECALL,
    _NODES,
    TableFigure("map precision [%]", "map_precision", percent),
    TableFigure("map recall [%]", "map_recall", percent),
    TableFigure("map median error [m]", "map_median_m", metres),
    _TIME,
)
_OF_SENSORS = (_ACE, _PRECISION, _RECALL, _NODES, _TIME)
_OF_LEVELS = (_ACE, _PRECISION, _RECALL)
_OF_COMPARISON = (
    _ACE,
    TableFigure("Pre@6.9 [%]", "precision_at_6_9", percent, "precision"),
    TableFigure("Rec@13.3 [%]", "recall_at_13_3", percent, "recall"),
)

Cells = Callable[[str], Iterable[str]]
"""Returns the figures of a preset."""


def _group(measured: Measured, name: str, cells: Cells, published: Iterable[str] = ()) -> tuple[tuple[str, ...], ...]:
    """Return the rows of a group: the published figures where there are any, then those of each preset."""
    lines = [(PUBLISHED, *line)] if (line := tuple(published)) else []
    lines += [(ours(preset), *cells(preset)) for preset in measured.presets]
    return tuple(("" if number else name, *line) for number, line in enumerate(lines))


def performance_table(measured: Measured, noise: str) -> Table:
    """Return the performance per drive (paper, Table "Performance on SemanticKITTI sequences") at a level of errors."""
    is_pooled = len(measured.drives) > 1 and not measured.sensors
    columns = [*measured.drives, *([ALL] if is_pooled else [])]
    published = [_published(measured, column) for column in columns] if noise == NO_NOISE else []
    published = published if any(published) else []

    def group(figure: TableFigure) -> tuple[tuple[str, ...], ...]:
        return _group(
            measured,
            figure.title,
            lambda preset: [figure.cell(measured.of(preset=preset, noise=noise, drive=each)) for each in columns],
            map(figure.published_cell, published if figure.published else []),
        )

    notes = ["All: detections, misses, errors and nodes of all drives taken together, as the paper's average is."]
    if noise == NO_NOISE and any(drive in PERFORMANCE for drive in measured.drives):
        notes.append("Published: SemanticKITTI with RangeNet++ labels.")
    return Table(
        title=f"II. Performance per drive{_level(noise)}",
        header=("", "", *columns),
        groups=tuple(map(group, _OF_DRIVES)),
        labels=2,
        notes=(*notes[len(columns) == len(measured.drives) :], *_seed_note(measured)),
    )


def sensor_table(measured: Measured, noise: str) -> Table:
    """Return the performance per sensor, over all drives with it, at a level of label errors."""

    def group(sensor: str) -> tuple[tuple[str, ...], ...]:
        def cells(preset: str) -> list[str]:
            drives = measured.sensors[sensor]
            rows = [row for row in measured.of(preset=preset, noise=noise) if row.cell.drive in drives]
            return [figure.cell(rows) for figure in _OF_SENSORS]

        return _group(measured, sensor, cells)

    return Table(
        title=f"Performance per sensor{_level(noise)}",
        header=("", "", *(figure.title for figure in _OF_SENSORS)),
        groups=tuple(map(group, measured.sensors)),
        labels=2,
        notes=(
            "Detections, misses, errors and nodes of all tracks taken together.",
            "Causal: no keyframe after the current one is accumulated.",
            *_seed_note(measured),
        ),
    )


def comparison_table(measured: Measured) -> Table:
    """Return the comparison with MMInsectDet (paper, Table "Performance comparison with MMInsectDet")."""
    published = [
        (name, *(figure.published_cell(value) for figure in _OF_COMPARISON)) for name, value in COMPARISON.items()
    ]
    lines = []
    for preset in measured.presets:
        rows = measured.of(preset=preset, noise=measured.noises[0])
        lines.append((f"InterLoc, {ours(preset)}", *(figure.cell(rows) for figure in _OF_COMPARISON)))
    return Table(
        title="III. Comparison with MMInsectDet",
        header=("", *(figure.title for figure in _OF_COMPARISON)),
        groups=(tuple(published), tuple(lines)),
        notes=_other_set_note(measured),
    )


def noise_table(measured: Measured) -> Table:
    """Return the performance at each level of label errors (paper, Table "... different segmentation error levels")."""
    is_predicted = measured.labels == "predictions"

    def group(noise: str) -> tuple[tuple[str, ...], ...]:
        published = RANGENET if noise == NO_NOISE and is_predicted else LABEL_ERRORS.get(noise)
        return _group(
            measured,
            noise,
            lambda preset: [figure.cell(measured.of(preset=preset, noise=noise)) for figure in _OF_LEVELS],
            (figure.published_cell(published) for figure in _OF_LEVELS if published is not None),
        )

    source = "RangeNet++ labels" if is_predicted else "hand labels"
    return Table(
        title="IV. Errors of the labels",
        header=("r-FPR/r-FNR", "", *(figure.title for figure in _OF_LEVELS)),
        groups=tuple(map(group, measured.noises)),
        labels=2,
        notes=(
            f"Label errors in percent, on top of the labels as they are; 0/0 published: {source}.",
            *_other_set_note(measured),
        ),
    )


def axes_table(measured: Measured) -> Table:
    """Return how far fused intersections are from where the axes of the roads meet, where somebody read that."""

    def group(drive: str) -> tuple[tuple[str, ...], ...]:
        def cells(preset: str) -> list[str]:
            errors = pooled(measured.of(preset=preset, noise=measured.noises[0], drive=drive), "map_axes_errors_m")
            if not len(errors):
                return ["0", *[MISSING] * 6]
            figures = [function(column) for column in errors.T for function in (np.mean, np.median, np.max)]
            return [str(len(errors)), *(metres(float(figure)) for figure in figures)]

        return _group(measured, drive, cells)

    return Table(
        title="Errors from where the axes of the roads meet",
        header=(
            "",
            "",
            "places",
            *(f"from {what}: {x}" for what in ("nodes", "axes") for x in ("mean", "median", "worst")),
        ),
        groups=tuple(map(group, measured.drives)),
        labels=2,
        notes=(
            "Metres, of the intersections of the map at nodes whose axes were read: from the node of OpenStreetMap,",
            "and from the point where the axes of the roads meet.",
        ),
    )


def reliability_table(measured: Measured) -> Table:
    """Return whether the uncertainty of the intersections and their confidence are true, per level of label errors."""

    def group(noise: str) -> tuple[tuple[str, ...], ...]:
        def cells(preset: str) -> list[str]:
            found = measured.reliability[preset, noise]
            return [
                str(found["within_95"].count),
                _with_bounds(found["within_95"], percent),
                _with_bounds(found["nees"], metres),
                str(found["calibration_error"].count),
                _with_bounds(found["calibration_error"], percent),
                _with_bounds(found["calibration_error_by_chance"], percent),
            ]

        return _group(measured, noise, cells)

    return Table(
        title="Uncertainty and confidence",
        header=("r-FPR/r-FNR", "", "with a node", "within 95 % [%]", "NEES", "in the zone", "ECE [%]", "by chance [%]"),
        groups=tuple(map(group, measured.noises)),
        labels=2,
        notes=(
            "Intersections of the map, each counted once per drive and seed; in brackets: bootstrap interval of 95 %.",
            "Within 95 %: share whose node lies in the ellipse of 95 % of the covariance.",
            "NEES: squared error in units of the covariance per degree of freedom; 1 where errors are as stated.",
            "ECE: expected calibration error of the confidence, ten bins of equal width.",
            "By chance: ECE of so many places where the confidence is exactly true; mean, and 95 % of all draws.",
        ),
    )


def tables(measured: Measured) -> list[Table]:
    """Return the tables of a benchmark: performance, comparison and label errors, or sensors; axes; and reliability."""
    if measured.sensors:
        shown = [*(sensor_table(measured, noise) for noise in measured.noises), performance_table(measured, NO_NOISE)]
    else:
        noise = measured.noises[0]
        shown = [performance_table(measured, noise), comparison_table(measured), noise_table(measured)]
    if any(row.map_axes_errors_m for row in measured.rows):
        shown.append(axes_table(measured))
    return [*shown, reliability_table(measured)]


def text(table: Table) -> str:
    """Return a table in aligned columns."""
    lines = [table.header, *(row for group in table.groups for row in group)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(table.header))]
    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))

    def aligned(line: tuple[str, ...]) -> str:
        cells = [
            cell.ljust(width) if i < table.labels else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        return "  ".join(cells).rstrip()

    body = [table.title, rule, aligned(table.header), rule]
    for number, group in enumerate(table.groups):
        if number and len(table.groups[number - 1]) + len(group) > 2:
            body.append("")
        body += [aligned(line) for line in group]
    return "\n".join([*body, rule, *table.notes])


def _with_bounds(found: Interval, write: Callable[[float], str]) -> str:
    if found.value is None or found.low is None or found.high is None:
        return MISSING
    return f"{write(found.value)} ({write(found.low)} to {write(found.high)})"


def _level(noise: str) -> str:
    return "" if noise == NO_NOISE else f", label errors {noise} %"


def _published(measured: Measured, column: str) -> Published | None:
    if column == ALL:
        return AVERAGE if measured.is_papers_set else None
    return PERFORMANCE.get(column)


def _seed_note(measured: Measured) -> tuple[str, ...]:
    seeds = len({row.cell.seed for row in measured.rows})
    return (f"{seeds} seeds: mean ± standard deviation over the seeds.",) if seeds > 1 else ()


def _other_set_note(measured: Measured) -> tuple[str, ...]:
    if measured.is_papers_set:
        return ()
    names = ", ".join(measured.drives) if len(measured.drives) <= 12 else f"{len(measured.drives)} drives"
    return (f"Published: all eight sequences of SemanticKITTI; this run: {names}.",)
