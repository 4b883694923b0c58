"""The figures of a report: the map, the center errors, the scores over the threshold."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from interloc.arrays import BoolArray, FloatArray
from interloc.drawing import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    MUTED,
    PAPER,
    PURPLE,
    VERMILION,
    YELLOW,
    credit_roads,
    entitle,
    mark,
    new_figure,
    quiet,
    scale_bar,
    series_style,
)
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.geometry import enu_from_lonlat, middle_of
from interloc.osm.intersections import road_ways
from interloc.results import DriveResult
from interloc.wording import metres, percent

_PERCENTILES = (5.0, 25.0, 50.0, 75.0, 95.0)  # of the paper's box plots: whiskers, box, median

_MAP_MARGIN_M = 70.0
_PLANE_DEG = 1.0  # how far from the drive its plane reaches


def map_figure(evaluation: Evaluation, result: DriveResult) -> Figure:
    """Draw roads, track, detections, nodes and fused intersections in metres, north up (paper, Fig. 6)."""
    assert evaluation.detections.lonlat is not None
    assert result.trajectory_lonlat is not None
    assert result.intersections.lonlat is not None
    lon, lat = middle_of(result.trajectory_lonlat)

    def plane(lonlat: FloatArray) -> FloatArray:
        return enu_from_lonlat(lat, lon, lonlat)

    track = plane(result.trajectory_lonlat)
    low, high = track.min(axis=0) - _MAP_MARGIN_M, track.max(axis=0) + _MAP_MARGIN_M
    width, height = high - low
    # The map is at most as large as a page; its longer side decides the scale.
    scale = min(9.0 / width, 9.5 / height)
    figure = new_figure(max(5.5, width * scale + 0.8), max(3.0, height * scale) + 1.5)
    axes = figure.add_subplot()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="east [m]", ylabel="north [m]")
    # Without the name of the drive: it may hold what fonts lack, or dollars, which are formulas to matplotlib.
    entitle(axes, "Detections and OpenStreetMap")
    axes.tick_params(labelsize=9, color=MUTED)
    axes.spines[:].set_color(FAINT)

    _draw_roads(axes, evaluation, plane, np.abs(evaluation.graph.lonlat - (lon, lat)).max(axis=1) < _PLANE_DEG)
    axes.plot(*track.T, color=INK, linewidth=1.1, alpha=0.8, zorder=3, label="track")
    _draw_detections(axes, evaluation, plane)
    _draw_nodes(axes, evaluation, plane)
    fused = {"markerfacecolor": YELLOW, "markeredgecolor": INK, "markeredgewidth": 0.7, "label": "fused intersection"}
    mark(axes, plane(result.intersections.lonlat), "P", 10, zorder=4, **fused)
    scale_bar(axes, low, high)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    credit_roads(axes, is_made_up=evaluation.graph.is_made_up)
    return figure


def _draw_roads(axes: Axes, evaluation: Evaluation, plane: Any, near: BoolArray) -> None:  # noqa: ANN401
    graph = evaluation.graph
    roads = road_ways(graph, evaluation.nodes.policy)
    place = np.full((len(graph.lonlat), 2), np.nan)
    place[near] = plane(graph.lonlat[near])
    for mask, colour, line_width in ((~roads, "#e6e8eb", 0.9), (roads, "#bfc5cc", 3.2)):
        lines = place[graph.edges_of(mask)]
        axes.add_collection(
            LineCollection(list(lines), colors=colour, linewidths=line_width, capstyle="round", zorder=1)
        )
    axes.plot([], [], color="#bfc5cc", linewidth=3.2, label=f"road (policy {evaluation.nodes.policy})")
    axes.plot([], [], color="#e6e8eb", linewidth=0.9, label="other highway")


def _draw_detections(axes: Axes, evaluation: Evaluation, plane: Any) -> None:  # noqa: ANN401
    place = plane(evaluation.detections.lonlat)
    true = evaluation.matching.error_m < STANDARD_THRESHOLD_M
    bound = f"{STANDARD_THRESHOLD_M:g} m"
    for mask, sign, size, colour, label in (
        (true, "o", 3.2, BLUE, f"detection, node within {bound} (TP)"),
        (~true, "x", 4.5, VERMILION, f"detection, none within {bound} (FP)"),
    ):
        mark(axes, place[mask], sign, size, color=colour, alpha=0.8, zorder=7, markeredgewidth=1.1, label=label)


def _draw_nodes(axes: Axes, evaluation: Evaluation, plane: Any) -> None:  # noqa: ANN401
    table = evaluation.node_table
    place = plane(evaluation.nodes.lonlat)
    for mask, sign, size, width, colour, label in (
        (~table.in_zone, "s", 3.5, 1.0, MUTED, "OSM node out of reach"),
        (table.in_zone & table.found, "s", 11, 2.0, GREEN, "OSM node, found"),
        (table.in_zone & ~table.found, "D", 10, 2.0, PURPLE, "OSM node, missed"),
    ):
        style = {"color": colour, "fillstyle": "none", "markeredgewidth": width, "label": label}
        mark(axes, place[mask], sign, size, zorder=6, **style)


def error_figure(evaluation: Evaluation) -> Figure:
    """Draw the distribution of the center errors: histogram, and box of the paper's percentiles."""
    errors = evaluation.matching.error_m[evaluation.matching.is_matched]
    figure = new_figure(7.5, 4.2)
    histogram, box = figure.subplots(2, 1, sharex=True, height_ratios=(5, 1))
    shown = errors[errors < NEAR_PAIR_M]
    bins = np.arange(0.0, NEAR_PAIR_M + 0.25, 0.25)
    true = shown < STANDARD_THRESHOLD_M
    for mask, colour in ((true, BLUE), (~true, VERMILION)):
        histogram.stairs(np.histogram(shown[mask], bins)[0], bins, fill=True, color=colour)
    histogram.axvline(STANDARD_THRESHOLD_M, color=MUTED, linestyle=(0, (4, 3)), linewidth=1)
    text = {"fontsize": 9, "color": MUTED, "va": "top", "transform": histogram.get_xaxis_transform()}
    histogram.text(STANDARD_THRESHOLD_M - 0.1, 0.99, "TP", ha="right", **text)
    histogram.text(STANDARD_THRESHOLD_M + 0.1, 0.99, "FP", ha="left", **text)
    summary = f"{len(errors):,} matched pairs\naverage (ACE) {metres(evaluation.errors.ace_m)}"
    summary += f"\nmedian {metres(evaluation.errors.median_m)}"
    if len(errors) > len(shown):
        summary += f"\n{len(errors) - len(shown):,} beyond {NEAR_PAIR_M:g} m not shown"
    histogram.text(
        0.99,
        0.86,
        summary,
        ha="right",
        va="top",
        fontsize=9,
        color=INK,
        transform=histogram.transAxes,
        linespacing=1.5,
        bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 3.0},
    )
    histogram.set_ylabel("detections")
    entitle(histogram, "Center error: detection to nearest OSM node")
    quiet(histogram)
    if len(errors):
        low, first, middle, third, high = np.percentile(errors, _PERCENTILES)
        box.bxp(
            [{"whislo": low, "q1": first, "med": middle, "q3": third, "whishi": high, "fliers": []}],
            positions=[1],
            widths=0.55,
            orientation="horizontal",
            showfliers=False,
            patch_artist=True,
            boxprops={"facecolor": "#cfe3f1", "edgecolor": BLUE, "linewidth": 1.2},
            medianprops={"color": VERMILION, "linewidth": 2.0},
            whiskerprops={"color": BLUE, "linewidth": 1.2},
            capprops={"color": BLUE, "linewidth": 1.2},
        )
    box.set(
        yticks=[], xlim=(0.0, NEAR_PAIR_M), xlabel="center error [m]      box: 5th, 25th, 50th, 75th, 95th percentile"
    )
    quiet(box, grid="x")
    box.spines["left"].set_visible(False)
    return figure


def comparison_figure(names: Sequence[str], reports: Sequence[Mapping[str, Any]]) -> Figure:
    """Draw precision, recall and F1 of several runs over the confidence threshold D, from their `report.json`."""
    figure = new_figure(11.0, 4.2 + 0.22 * ((len(names) + 1) // 2))
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    for axes, measure in zip(panels, ("precision", "recall", "f1"), strict=True):
        for run, (name, report) in enumerate(zip(names, reports, strict=True)):
            points = [(float(d), value) for d, value in report[measure].items() if float(d) <= NEAR_PAIR_M]
            thresholds = [d for d, _ in points]
            values = [np.nan if value is None else 100.0 * value for _, value in points]
            axes.plot(thresholds, values, label=name, **series_style(run))
        entitle(axes, "F1" if measure == "f1" else measure)
        _scale_to_thresholds(axes)
    panels[0].set_ylabel("[%]")
    legend = figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9
    )
    for text in legend.get_texts():
        text.set_parse_math(False)  # names may hold dollars, which are formulas to matplotlib
    return figure


def threshold_figure(evaluation: Evaluation) -> Figure:
    """Draw precision, recall and F1 over the confidence threshold D."""
    scores = evaluation.scores
    figure = new_figure(7.5, 3.9)
    axes = figure.add_subplot()
    shown = scores.threshold_m <= NEAR_PAIR_M
    for name, values, colour, style, marker in (
        ("precision", scores.precision, BLUE, "-", "o"),
        ("recall", scores.recall, VERMILION, "--", "^"),
        ("F1", scores.f1, INK, ":", "s"),
    ):
        label = f"{name}: {percent(scores.at(STANDARD_THRESHOLD_M, values))} at {STANDARD_THRESHOLD_M:g} m"
        line: dict[str, Any] = {
            "color": colour,
            "linestyle": style,
            "marker": marker,
            "markersize": 4,
            "linewidth": 1.8,
        }
        axes.plot(scores.threshold_m[shown], 100.0 * values[shown], label=label, **line)
    _scale_to_thresholds(axes)
    axes.set_ylabel("[%]")
    entitle(axes, "Scores over the distance that still counts as found")
    axes.legend(loc="lower right", frameon=False, fontsize=10)
    return figure


def _scale_to_thresholds(axes: Axes) -> None:
    """Prepare axes for percentages over the confidence threshold D; the usual threshold is marked."""
    axes.axvline(STANDARD_THRESHOLD_M, color=MUTED, linestyle=(0, (4, 3)), linewidth=1)
    axes.set(xlim=(0.0, NEAR_PAIR_M + 0.2), ylim=(0.0, 102.0), xticks=range(0, 11, 2))
    axes.set_xlabel("confidence threshold D [m]")
    quiet(axes)
