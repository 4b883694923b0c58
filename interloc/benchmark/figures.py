"""The figures of a benchmark: maps as the paper's Fig. 6, box plots and F1 curves as its Fig. 8."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.benchmark.metrics import estimate, f1, map_outcomes, pooled
from interloc.benchmark.row import MapPicture, Point, Row
from interloc.benchmark.tables import Measured, ours
from interloc.drawing import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    MUTED,
    PURPLE,
    VERMILION,
    credit_roads,
    entitle,
    new_figure,
    quiet,
    scale_bar,
    series_colour,
    series_style,
)
from interloc.evaluation.figures import PERCENTILES, scale_to_thresholds
from interloc.evaluation.reliability import bins_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

F1_THRESHOLDS_M = tuple(0.5 * i for i in range(1, 21))

_TITLE_PT = 11.0


def map_figure(picture: MapPicture) -> Figure:
    """Draw detections, nodes, roads and track of a drive in metres, north up (paper, Fig. 6)."""
    from matplotlib.collections import LineCollection  # noqa: PLC0415 - slow to import

    track = np.array(picture.track, dtype=np.float64).reshape(-1, 2)
    low, high = track.min(axis=0) - 45.0, track.max(axis=0) + 45.0
    width, height = high - low
    scale = min(6.0 / width, 6.0 / height)
    figure = new_figure(max(5.2, width * scale), max(2.2, height * scale) + 0.9)
    axes = figure.add_subplot()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
    axes.spines[:].set_color(FAINT)
    roads = [((a, b), (c, d)) for a, b, c, d in picture.roads]
    # Dashes of pieces of a few metres would merge: the roads are joined to long lines first.
    axes.add_collection(
        LineCollection(_joined(roads), colors=INK, linewidths=0.7, linestyles=(0, (4, 3)), alpha=0.75, zorder=2)
    )
    axes.plot([], [], color=INK, linewidth=0.7, linestyle=(0, (4, 3)), label="OSM road")
    axes.plot(*track.T, color=BLUE, linewidth=1.6, alpha=0.9, zorder=3, label="track")
    for points, style in (
        (picture.true, {"marker": "o", "markersize": 2.6, "color": GREEN, "zorder": 4, "label": "true"}),
        (picture.false, {"marker": "o", "markersize": 2.6, "color": VERMILION, "zorder": 5, "label": "false"}),
        (
            picture.beyond,
            {"marker": "x", "markersize": 4.0, "color": MUTED, "zorder": 6, "label": "OSM node out of reach"},
        ),
        (
            picture.found,
            {"marker": "x", "markersize": 7, "color": INK, "zorder": 7, "markeredgewidth": 1.5, "label": "OSM node"},
        ),
    ):
        _scatter(axes, points, style)
    missed = {"markersize": 7, "markeredgewidth": 1.5, "color": INK, "marker": "x", "zorder": 7}
    _scatter(axes, picture.missed, missed)
    ring = {"markersize": 14, "markeredgewidth": 1.6, "color": PURPLE, "fillstyle": "none", "marker": "o", "zorder": 8}
    _scatter(axes, picture.missed, ring | {"label": "missed"})
    scale_bar(axes, low, high)
    credit_roads(axes, is_made_up=picture.is_made_up)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def _scatter(axes: Axes, points: Sequence[Point], style: dict[str, Any]) -> None:
    xy = np.array(points, dtype=np.float64).reshape(-1, 2)
    axes.plot(*xy.T, linestyle="none", **style)


def _joined(pieces: list[tuple[Point, Point]]) -> list[list[Point]]:
    """Join pieces that meet end to end at a place where no third one does."""
    at: dict[Point, list[int]] = {}
    for number, piece in enumerate(pieces):
        for end in piece:
            at.setdefault(end, []).append(number)
    used = [False] * len(pieces)
    lines = []
    for number, (start, end) in enumerate(pieces):
        if used[number]:
            continue
        used[number] = True
        line = [start, end]
        for _ in range(2):  # forward, then the other way
            while len(there := at[line[-1]]) == 2 and not all(used[other] for other in there):
                other = next(other for other in there if not used[other])
                used[other] = True
                a, b = pieces[other]
                line.append(b if a == line[-1] else a)
            line.reverse()
        lines.append(line)
    return lines


def drive_boxes_figure(measured: Measured) -> Figure:
    """Draw the center errors of each drive, presets side by side, without label errors."""
    noise = measured.noises[0]
    names = [*measured.drives, *(["all"] if len(measured.drives) > 1 else [])]
    samples = {
        preset: [pooled(measured.of(preset=preset, noise=noise, drive=name), "errors_m") for name in names]
        for preset in measured.presets
    }
    figure = new_figure(max(5.7, 1.0 + 0.95 * len(names)), 4.2)
    axes = figure.add_subplot()
    _draw_boxes(axes, samples)
    axes.set(xticks=range(len(names)), xticklabels=names, xlim=(-0.6, len(names) - 0.4), ylabel="center error [m]")
    if max(map(len, names)) > 9:
        axes.tick_params(axis="x", labelrotation=30)
    entitle(axes, "Center error per drive (5th, 25th, 50th, 75th, 95th percentile)", _TITLE_PT)
    return figure


def curves_figure(measured: Measured) -> Figure:
    """Draw F1 over the threshold of each preset, without label errors."""
    figure = new_figure(5.7, 4.2)
    axes = figure.add_subplot()
    noise = measured.noises[0]
    _draw_curves(axes, {preset: measured.of(preset=preset, noise=noise) for preset in measured.presets})
    entitle(axes, "F1 over the distance that still counts as found, all drives", _TITLE_PT)
    return figure


def noise_figure(measured: Measured) -> Figure:
    """Draw center errors and F1 curves of each level of label errors, one row of figures per preset (paper, Fig. 8)."""
    count = len(measured.presets)
    figure = new_figure(10.5, 4.1 * count)
    grid = figure.subplots(count, 2, width_ratios=(1, 1.25), squeeze=False)
    top = 0.0
    for (boxes, curves), preset in zip(grid, measured.presets, strict=True):
        levels = {noise: measured.of(preset=preset, noise=noise) for noise in measured.noises}
        _draw_boxes(boxes, {preset: [pooled(rows, "errors_m") for rows in levels.values()]})
        boxes.set(xticks=range(len(levels)), xticklabels=list(levels), xlim=(-0.6, len(levels) - 0.4))
        boxes.set(xlabel="label errors r-FPR / r-FNR [%]", ylabel="center error [m]")
        top = max(top, boxes.get_ylim()[1])
        entitle(boxes, f"\n{ours(preset)}: center error", _TITLE_PT)
        _draw_curves(curves, levels)
        entitle(curves, f"\n{ours(preset)}: F1 over the threshold", _TITLE_PT)
    for boxes in grid[:, 0]:
        boxes.set_ylim(0.0, top)  # one scale for all presets
    return figure


def reliability_figure(measured: Measured) -> Figure:
    """Draw whether confidence and uncertainty are true, without label errors: both should follow the diagonal.

    Left: share of right intersections over their confidence, a mark for each bin, larger for more intersections.
    Right: share of the intersections whose node lies in the ellipse of each probability.
    """
    figure = new_figure(9.5, 4.4)
    left, right = figure.subplots(1, 2)
    noise = measured.noises[0]
    levels = np.linspace(0.0, 1.0, 101)
    for axes in (left, right):
        axes.plot([0, 100], [0, 100], color=MUTED, linestyle=(0, (4, 3)), linewidth=1)
        axes.set(xlim=(0.0, 102.0), ylim=(0.0, 102.0), aspect="equal")
        quiet(axes)
    for number, preset in enumerate(measured.presets):
        rows = measured.of(preset=preset, noise=noise)
        style = series_style(number)
        bins = bins_of(*map_outcomes(rows))
        confidence, share = [100.0 * each.confidence for each in bins], [100.0 * each.right for each in bins]
        left.plot(confidence, share, **style, label=preset)
        left.scatter(
            confidence,
            share,
            s=[12.0 + 1.5 * b.count for b in bins],
            c=style["color"],
            marker=style["marker"],
            alpha=0.8,
        )
        if len(squared := np.sort(pooled(rows, "map_squared"))):
            within = np.searchsorted(squared, -2.0 * np.log1p(-levels[:-1]), side="right") / len(squared)
            right.plot(100.0 * levels[:-1], 100.0 * within, **style, markevery=20, label=preset)
    left.set(xlabel="confidence [%]", ylabel="right [%]")
    right.set(xlabel="probability of the ellipse [%]", ylabel="nodes in the ellipse [%]")
    entitle(left, "Confidence", _TITLE_PT)
    entitle(right, "Uncertainty of the position", _TITLE_PT)
    if len(measured.presets) > 1:
        left.legend(loc="upper left", frameon=False, fontsize=9)
    return figure


def _draw_boxes(axes: Axes, samples: dict[str, list[FloatArray]]) -> None:
    """Draw groups of boxes: the n-th of each series stand side by side at x = n."""
    width = 0.8 / len(samples)
    for series, (name, values) in enumerate(samples.items()):
        colour = series_colour(series)
        for position, errors in enumerate(values):
            if len(errors) == 0:
                continue
            low, first, middle, third, high = np.percentile(errors, PERCENTILES)
            stats = {"whislo": low, "q1": first, "med": middle, "q3": third, "whishi": high, "fliers": []}
            line = {"color": colour, "linewidth": 1.2}
            axes.bxp(
                [stats],
                positions=[position - 0.4 + width * (series + 0.5)],
                widths=0.75 * width,
                showfliers=False,
                patch_artist=True,
                manage_ticks=False,
                boxprops={"facecolor": f"{colour}30", "edgecolor": colour, "linewidth": 1.2},
                medianprops={"color": INK, "linewidth": 1.8},
                whiskerprops=line,
                capprops=line,
            )
        if len(samples) > 1:
            axes.plot([], [], color=colour, linewidth=6, alpha=0.5, label=name)
    axes.set_ylim(bottom=0.0)
    if len(samples) > 1:
        axes.legend(frameon=False, fontsize=9)
    quiet(axes)


def _draw_curves(axes: Axes, series: dict[str, list[Row]]) -> None:
    for number, (name, rows) in enumerate(series.items()):
        values = [estimate(rows, partial(f1, threshold_m=d)).mean for d in F1_THRESHOLDS_M]
        axes.plot(
            F1_THRESHOLDS_M,
            [np.nan if value is None else 100.0 * value for value in values],
            label=name,
            **series_style(number),
        )
    scale_to_thresholds(axes)
    axes.set_ylabel("F1 [%]")
    axes.legend(loc="lower right", frameon=False, fontsize=9)
