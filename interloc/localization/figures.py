"""A picture of where a drive was found, with the places that come next."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from interloc.arrays import FloatArray
from interloc.drawing import BLUE, FAINT, INK, MUTED, SKY, VERMILION, credit_roads, entitle, new_figure
from interloc.geometry import enu_from_lonlat
from interloc.localization.locate import Location
from interloc.osm.graph import RoadGraph
from interloc.osm.intersections import road_ways

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NEAR_MARGIN_M = 100.0
_MARGIN_M = 300.0
_RUNNERS_UP = 4


def location_figure(location: Location, graph: RoadGraph, drive: str) -> Figure:
    """Draw the roads of the map, the drive at its best place, and faintly the next ones: near, and all of them."""
    figure = new_figure(14.0, 7.2)
    near, everywhere = figure.subplots(1, 2)
    west, south, east, north = graph.extent
    lat, lon = (south + north) / 2, (west + east) / 2
    edges = graph.edges_of(road_ways(graph, "drive+service"))
    roads = enu_from_lonlat(lat, lon, graph.lonlat)[edges]
    tracks = [enu_from_lonlat(lat, lon, place.track_lonlat) for place in location.places[: 1 + _RUNNERS_UP]]
    for axes, shown, margin_m in ((near, tracks[:1], _NEAR_MARGIN_M), (everywhere, tracks, _MARGIN_M)):
        _draw(axes, location, roads, tracks)
        credit_roads(axes, is_made_up=graph.is_made_up)
        visible = np.concatenate(shown) if shown else roads.reshape(-1, 2)
        low, high = visible.min(axis=0) - margin_m, visible.max(axis=0) + margin_m
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="east [m]", ylabel="north [m]")
    entitle(near, f"{drive}: {location.decision.outcome.replace('_', ' ')}")
    entitle(everywhere, "the best place and the next ones")
    if tracks:
        everywhere.legend(loc="best", fontsize=8, frameon=False)
    return figure


def _draw(axes: Axes, location: Location, roads: FloatArray, tracks: list[FloatArray]) -> None:
    from matplotlib.collections import LineCollection  # noqa: PLC0415 - slow to import

    axes.add_collection(LineCollection(list(roads), colors=MUTED, linewidths=0.5, zorder=1))
    for number, (track, place) in enumerate(zip(tracks, location.places, strict=False)):
        found = number == 0 and location.decision.found
        axes.plot(
            *track.T,
            color=BLUE if found else SKY,
            linewidth=2.2 if number == 0 else 1.4,
            alpha=1.0 if number == 0 else 0.7,
            linestyle="-" if number == 0 else "--",
            zorder=4 - number / 10,
            label=f"{number + 1}: score {place.score:.2f}, {100 * place.evidence.road:.0f} % on roads",
        )
        axes.plot(*track[0], marker="o", color=VERMILION if found else INK, markersize=5, zorder=5)
    axes.grid(visible=True, color=FAINT, linewidth=0.5)
