"""Roads and buildings of a map around a drive as GeoJSON: a base map that needs no tiles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import enu_from_lonlat, middle_of
from interloc.osm.graph import Bounds, RoadGraph, within
from interloc.osm.intersections import road_ways
from interloc.output.geojson import positions
from interloc.output.layers import BUILDINGS, LAYERS

SEEN = ("seen_m", "mapped", "offset_m", "width_m", "is_driven")
"""What an evaluation tells of the ways that the drive saw."""

NEAR_M = 80.0
"""Buildings further from the track are not drawn: a LiDAR at street level sees the first row."""


def road_features(
    graph: RoadGraph, bounds: Bounds, seen: Mapping[int, Mapping[str, Any]] | None = None
) -> list[dict[str, Any]]:
    """Return the ways that come into bounds (degrees) as features of the layer `osm_roads`.

    The edges of a way that touch the bounds are kept, whole. `seen` tells by row what a drive saw of ways, as `SEEN`.
    """
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    lines: Any = shapely.linestrings(graph.lonlat[graph.edges])
    if bounds[0] <= bounds[2]:
        near = np.flatnonzero(shapely.intersects(lines, shapely.box(*bounds)))
    else:  # across the 180th meridian, where the plane of degrees ends
        near = np.flatnonzero(within(bounds, graph.lonlat)[graph.edges].any(axis=1))
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
        **{name: [seen.get(row, {}).get(name) if seen else None for row in rows] for name in SEEN},
    )


def building_features(graph: RoadGraph, lonlat: FloatArray) -> list[dict[str, Any]]:
    """Return the buildings near (N, 2) longitudes and latitudes as Polygon features of the layer `osm_buildings`."""
    buildings = graph.buildings
    if len(buildings) == 0 or len(lonlat) == 0:
        return []
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    lon, lat = middle_of(lonlat)
    corners = enu_from_lonlat(lat, lon, np.concatenate(buildings.outlines))
    distance, _ = cKDTree(enu_from_lonlat(lat, lon, lonlat)).query(corners, distance_upper_bound=NEAR_M)
    first = np.cumsum([0, *(len(ring) for ring in buildings.outlines[:-1])])
    near = np.flatnonzero(np.minimum.reduceat(distance, first) < NEAR_M)
    polygons = [
        [
            positions(_turned(buildings.outlines[row], counter_clockwise=True), local=False),
            *(positions(_turned(hole, counter_clockwise=False), local=False) for hole in buildings.holes[row]),
        ]
        for row in near
    ]
    elements = ["relation" if buildings.is_relation[row] else "way" for row in near]
    return LAYERS[BUILDINGS].features(polygons, osm_id=buildings.id[near], osm_type=elements)


def _turned(ring: FloatArray, *, counter_clockwise: bool) -> FloatArray:
    """Return a closed ring in a direction: outlines and holes have opposite ones (RFC 7946, 3.1.6)."""
    (x, y), (to_x, to_y) = (ring[:-1] - ring[0]).T, (ring[1:] - ring[0]).T
    return ring if (float(np.sum(x * to_y - to_x * y)) > 0) == counter_clockwise else ring[::-1]
