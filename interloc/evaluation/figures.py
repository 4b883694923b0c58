"""The figures of a report: the map, and the scores over the threshold."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from interloc import drawing
from interloc.arrays import BoolArray, FloatArray
from interloc.evaluation.evaluate import Evaluation
from interloc.evaluation.metrics import NEAR_PAIR_M, STANDARD_THRESHOLD_M
from interloc.geometry import enu_from_lonlat, middle_of, wrap_longitude
from interloc.osm.intersections import road_ways
from interloc.results import DriveResult
from interloc.wording import percent

_MAP_MARGIN_M = 70.0
_PLANE_DEG = 1.0  # how far from the drive its plane reaches


def map_figure(evaluation: Evaluation, result: DriveResult) -> Figure:
    """Draw roads, track, detections, nodes and fused intersections in metres, north up (paper, Fig. 6)."""
    assert result.trajectory_lonlat is not None
    lon, lat = middle_of(result.trajectory_lonlat)

    def plane(lonlat: FloatArray) -> FloatArray:
        return enu_from_lonlat(lat, lon, lonlat)

    track = plane(result.trajectory_lonlat)
    low, high = track.min(axis=0) - _MAP_MARGIN_M, track.max(axis=0) + _MAP_MARGIN_M
    width, height = high - low
    # The map is at most as large as a page; its longer side decides the scale.
    scale = min(9.0 / width, 9.5 / height)
    figure = drawing.new_figure(max(5.5, width * scale + 0.8), max(3.0, height * scale) + 1.5)
    axes = figure.add_subplot()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="east [m]", ylabel="north [m]")
    # Without the name of the drive: it may hold what fonts lack, or dollars, which are formulas to matplotlib.
    drawing.entitle(axes, "Detections and OpenStreetMap")
    axes.tick_params(labelsize=9, color=drawing.MUTED)
    axes.spines[:].set_color(drawing.FAINT)

    off = evaluation.graph.lonlat - (lon, lat)
    off[:, 0] = wrap_longitude(off[:, 0])
    _draw_roads(axes, evaluation, plane, np.abs(off).max(axis=1) < _PLANE_DEG)
    axes.plot(*track.T, color=drawing.INK, linewidth=1.1, alpha=0.8, zorder=3, label="track")
    _draw_detections(axes, evaluation, plane)
    _draw_nodes(axes, evaluation, plane)
    fused = {
        "markerfacecolor": drawing.YELLOW,
        "markeredgecolor": drawing.INK,
        "markeredgewidth": 0.7,
        "label": "fused intersection",
    }
    drawing.mark(axes, plane(result.intersections.degrees), "P", 10, zorder=4, **fused)
    drawing.scale_bar(axes, low, high)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    drawing.credit_roads(axes, is_made_up=evaluation.graph.is_made_up)
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
    place = plane(evaluation.detections.degrees)
    true = evaluation.matching.error_m < STANDARD_THRESHOLD_M
    bound = f"{STANDARD_THRESHOLD_M:g} m"
    for mask, sign, size, colour, label in (
        (true, "o", 3.2, drawing.BLUE, f"detection, node within {bound} (TP)"),
        (~true, "x", 4.5, drawing.VERMILION, f"detection, none within {bound} (FP)"),
    ):
        drawing.mark(axes, place[mask], sign, size, color=colour, alpha=0.8, zorder=7, markeredgewidth=1.1, label=label)


def _draw_nodes(axes: Axes, evaluation: Evaluation, plane: Any) -> None:  # noqa: ANN401
    table, found = evaluation.node_table, evaluation.map_level.node_found
    place = plane(evaluation.nodes.lonlat)
    for mask, sign, size, width, colour, label in (
        (~table.in_zone, "s", 3.5, 1.0, drawing.MUTED, "OSM node out of reach"),
        (table.in_zone & found, "s", 11, 2.0, drawing.GREEN, "OSM node, found"),
        (table.in_zone & ~found, "D", 10, 2.0, drawing.PURPLE, "OSM node, missed"),
    ):
        style = {"color": colour, "fillstyle": "none", "markeredgewidth": width, "label": label}
        drawing.mark(axes, place[mask], sign, size, zorder=6, **style)


def threshold_figure(evaluation: Evaluation) -> Figure:
    """Draw precision, recall and F1 over the confidence threshold D."""
    scores = evaluation.scores
    figure = drawing.new_figure(7.5, 3.9)
    axes = figure.add_subplot()
    shown = scores.threshold_m <= NEAR_PAIR_M
    for name, values, colour, style, marker in (
        ("precision", scores.precision, drawing.BLUE, "-", "o"),
        ("recall", scores.recall, drawing.VERMILION, "--", "^"),
        ("F1", scores.f1, drawing.INK, ":", "s"),
    ):
        label = f"{name}: {percent(scores.at(STANDARD_THRESHOLD_M, values))} at {STANDARD_THRESHOLD_M:g} m"
        drawn = scores.threshold_m[shown], 100.0 * values[shown]
        axes.plot(*drawn, label=label, color=colour, linestyle=style, marker=marker, markersize=4, linewidth=1.8)
    axes.axvline(STANDARD_THRESHOLD_M, color=drawing.MUTED, linestyle=(0, (4, 3)), linewidth=1)
    axes.set(xlim=(0.0, NEAR_PAIR_M + 0.2), ylim=(0.0, 102.0), xticks=range(0, 11, 2))
    axes.set(xlabel="confidence threshold D [m]", ylabel="[%]")
    drawing.quiet(axes)
    drawing.entitle(axes, "Scores over the distance that still counts as found")
    axes.legend(loc="best", edgecolor="none", framealpha=1.0, fontsize=10)
    return figure
