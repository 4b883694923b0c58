"""The ways of a road graph around a drive as GeoJSON lines: a base map that needs no tiles."""

from __future__ import annotations

from typing import Any

import numpy as np

from interloc.osm.graph import Bounds, RoadGraph
from interloc.osm.intersections import road_ways
from interloc.output.geojson import positions
from interloc.output.layers import LAYERS


def road_features(graph: RoadGraph, bounds: Bounds) -> list[dict[str, Any]]:
    """Return the ways that come into bounds as LineString features.

    Parameters
    ----------
    graph
        The map.
    bounds
        West, south, east, north, degrees. The edges of a way that touch them are kept, whole.

    Returns
    -------
    list of dict
        GeoJSON features of the layer `osm_roads`.
    """
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    lines: Any = shapely.linestrings(graph.lonlat[graph.edges])
    near = np.flatnonzero(shapely.intersects(lines, shapely.box(*bounds)))
    if len(near) == 0:
        return []
    order = near[np.argsort(graph.edge_way[near], kind="stable")]
    ways, first = np.unique(graph.edge_way[order], return_index=True)
    pieces: list[tuple[int, list[list[float]]]] = []
    for way, edges in zip(ways.tolist(), np.split(lines[order], first[1:]), strict=True):
        joined: Any = shapely.line_merge(shapely.multilinestrings(edges))
        parts = (shapely.get_coordinates(line) for line in shapely.get_parts(joined))
        pieces += [(way, positions(lonlat, local=False)) for lonlat in parts]
    rows = [way for way, _ in pieces]
    return LAYERS["osm_roads"].features(
        [line for _, line in pieces],
        osm_id=graph.ways.id[rows],
        highway=[graph.ways.highway[row] for row in rows],
        name=[graph.ways.name[row] or None for row in rows],
        is_drivable=road_ways(graph, "drive+service")[rows],
    )
