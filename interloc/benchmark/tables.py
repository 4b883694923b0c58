"""The paper's tables with our rows beside the published ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

from interloc.benchmark.metrics import METRICS, Estimate, estimate, map_outcomes, map_squared
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
ALL = "all"


@dataclass(frozen=True)
class Table:
    """A table as text.

    Attributes
    ----------
    title : str
    header : tuple of str
    groups : tuple of tuple of tuple of str
        Rows that belong together; a line is drawn between groups.
    labels : int
        The first columns are words, the others are figures.
    notes : tuple of str
    """

    title: str
    header: tuple[str, ...]
    groups: tuple[tuple[tuple[str, ...], ...], ...]
    labels: int = 1
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Measured:
    """The rows of a benchmark, by what they are.

    Attributes
    ----------
    rows : tuple of Row
    drives, presets, noises : tuple of str
        In the order of the tables.
    labels : str
        "labels" (by hand, or exact) or "predictions" (of a network).
    sensors : dict of str to tuple of str
        Drives by the sensor that they were simulated with, where several sensors are compared.
    """

    rows: tuple[Row, ...]
    drives: tuple[str, ...]
    presets: tuple[str, ...]
    noises: tuple[str, ...]
    labels: str = "labels"
    sensors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

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
            squared = map_squared(rows)
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


def performance_table(measured: Measured, noise: str) -> Table:
    """Return the performance per drive (paper, Table "Performance on SemanticKITTI sequences") at a level of errors."""
    is_pooled = len(measured.drives) > 1 and not measured.sensors
    columns = [*measured.drives, *([ALL] if is_pooled else [])]
    groups = []
    for title, metric, write, published in (
        ("ACE [m]", "ace_m", metres, "ace_m"),
        ("ACE, pairs < 10 m [m]", "ace_under_10_m", metres, ""),
        ("Pre@5 [%]", "precision_at_5", percent, "precision"),
        ("Rec@5 [%]", "recall_at_5", percent, "recall"),
        ("nodes found / in zone", "nodes_found", None, ""),
        ("map precision [%]", "map_precision", percent, ""),
        ("map recall [%]", "map_recall", percent, ""),
        ("map median error [m]", "map_median_m", metres, ""),
        ("ms per keyframe", "ms_a_keyframe", one_decimal, ""),
    ):
        group = []
        if published and noise == "0/0":
            values = [getattr(_published(measured, column), published, None) for column in columns]
            if any(value is not None for value in values):
                group.append(("", PUBLISHED, *(_write(Estimate(value), write) for value in values)))
        for preset in measured.presets:
            cells = []
            for column in columns:
                value = measured.estimate(metric, preset=preset, noise=noise, drive=column)
                if metric == "nodes_found":
                    total = measured.estimate("nodes_in_zone", preset=preset, noise=noise, drive=column)
                    cells.append(counted(value, total))
                else:
                    cells.append(_write(value, write))
            group.append(("", ours(preset), *cells))
        group[0] = (title, *group[0][1:])
        groups.append(tuple(group))
    level = "" if noise == "0/0" else f", label errors {noise} %"
    notes = ["All: detections, misses, errors and nodes of all drives taken together, as the paper's average is."]
    if noise == "0/0" and any(drive in PERFORMANCE for drive in measured.drives):
        notes.append("Published: SemanticKITTI with RangeNet++ labels.")
    return Table(
        title=f"II. Performance per drive{level}",
        header=("", "", *columns),
        groups=tuple(groups),
        labels=2,
        notes=(*notes[len(columns) == len(measured.drives) :], *_seed_note(measured)),
    )


def sensor_table(measured: Measured, noise: str) -> Table:
    """Return the performance per sensor, over all drives with it, at a level of label errors."""
    groups = []
    for sensor, drives in measured.sensors.items():
        lines: list[tuple[str, ...]] = []
        for preset in measured.presets:
            rows = [row for row in measured.of(preset=preset, noise=noise) if row.cell.drive in drives]
            found, total = (estimate(rows, METRICS[name]) for name in ("nodes_found", "nodes_in_zone"))
            cells = (
                _write(estimate(rows, METRICS[metric]), write)
                for metric, write in (
                    ("ace_m", metres),
                    ("precision_at_5", percent),
                    ("recall_at_5", percent),
                    ("ms_a_keyframe", one_decimal),
                )
            )
            ace, pre, rec, ms = cells
            lines.append((sensor if not lines else "", ours(preset), ace, pre, rec, counted(found, total), ms))
        groups.append(tuple(lines))
    return Table(
        title=f"Performance per sensor{'' if noise == '0/0' else f', label errors {noise} %'}",
        header=("", "", "ACE [m]", "Pre@5 [%]", "Rec@5 [%]", "nodes found / in zone", "ms per keyframe"),
        groups=tuple(groups),
        labels=2,
        notes=(
            "Detections, misses, errors and nodes of all tracks taken together.",
            "Causal: no keyframe after the current one is accumulated.",
            *_seed_note(measured),
        ),
    )


def comparison_table(measured: Measured) -> Table:
    """Return the comparison with MMInsectDet (paper, Table "Performance comparison with MMInsectDet")."""
    published = tuple(
        (name, metres(value.ace_m), percent(value.precision), percent(value.recall))
        for name, value in COMPARISON.items()
    )
    noise = measured.noises[0]
    lines = []
    for preset in measured.presets:
        values = (
            _write(measured.estimate(metric, preset=preset, noise=noise), write)
            for metric, write in (("ace_m", metres), ("precision_at_6_9", percent), ("recall_at_13_3", percent))
        )
        lines.append((f"InterLoc, {ours(preset)}", *values))
    return Table(
        title="III. Comparison with MMInsectDet",
        header=("", "ACE [m]", "Pre@6.9 [%]", "Rec@13.3 [%]"),
        groups=(published, tuple(lines)),
        notes=_other_set_note(measured),
    )


def noise_table(measured: Measured) -> Table:
    """Return the performance at each level of label errors (paper, Table "... different segmentation error levels")."""
    groups = []
    for noise in measured.noises:
        published = RANGENET if noise == "0/0" and measured.labels == "predictions" else LABEL_ERRORS.get(noise)
        lines: list[tuple[str, ...]] = []
        if published is not None:
            lines.append((PUBLISHED, metres(published.ace_m), percent(published.precision), percent(published.recall)))
        for preset in measured.presets:
            values = (
                _write(measured.estimate(metric, preset=preset, noise=noise), write)
                for metric, write in (("ace_m", metres), ("precision_at_5", percent), ("recall_at_5", percent))
            )
            lines.append((ours(preset), *values))
        groups.append(tuple((noise if number == 0 else "", *line) for number, line in enumerate(lines)))
    source = "RangeNet++ labels" if measured.labels == "predictions" else "hand labels"
    notes = (
        f"Label errors in percent, on top of the labels as they are; 0/0 published: {source}.",
        *_other_set_note(measured),
    )
    return Table(
        title="IV. Errors of the labels",
        header=("r-FPR/r-FNR", "", "ACE [m]", "Pre@5 [%]", "Rec@5 [%]"),
        groups=tuple(groups),
        labels=2,
        notes=notes,
    )


def reliability_table(measured: Measured) -> Table:
    """Return whether the uncertainty of the intersections and their confidence are true, per level of label errors."""
    groups = []
    for noise in measured.noises:
        lines: list[tuple[str, ...]] = []
        for preset in measured.presets:
            found = measured.reliability[preset, noise]
            lines.append(
                (
                    noise if not lines else "",
                    ours(preset),
                    str(found["within_95"].count),
                    _with_bounds(found["within_95"], percent),
                    _with_bounds(found["nees"], metres),
                    str(found["calibration_error"].count),
                    _with_bounds(found["calibration_error"], percent),
                    _with_bounds(found["calibration_error_by_chance"], percent),
                )
            )
        groups.append(tuple(lines))
    return Table(
        title="Uncertainty and confidence",
        header=("r-FPR/r-FNR", "", "with a node", "within 95 % [%]", "NEES", "in the zone", "ECE [%]", "by chance [%]"),
        groups=tuple(groups),
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
    """Return the tables of a benchmark: performance, comparison and label errors, or sensors; and reliability."""
    if measured.sensors:
        shown = [*(sensor_table(measured, noise) for noise in measured.noises), performance_table(measured, "0/0")]
    else:
        noise = measured.noises[0]
        shown = [performance_table(measured, noise), comparison_table(measured), noise_table(measured)]
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


def _write(value: Estimate, write: Callable[[float], str] | None) -> str:
    if value.mean is None or write is None:
        return MISSING
    return write(value.mean) if value.spread is None else f"{write(value.mean)} ± {write(value.spread)}"


def _with_bounds(found: Interval, write: Callable[[float], str]) -> str:
    if found.value is None or found.low is None or found.high is None:
        return MISSING
    return f"{write(found.value)} ({write(found.low)} to {write(found.high)})"


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
