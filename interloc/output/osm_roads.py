"""The ways of a road graph around a drive as GeoJSON lines: a base map that needs no tiles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.osm.graph import Bounds, RoadGraph
from interloc.osm.intersections import road_ways
from interloc.output.geojson import positions, write_collection

ROADS_FILE = "osm_roads.geojson"


def road_features(graph: RoadGraph, bounds: Bounds) -> list[dict[str, Any]]:
    """Return the ways that come into bounds as LineString features.

    Parameters
    ----------
    graph
    bounds
        West, south, east, north, degrees. The edges of a way that touch them are kept, whole.

    Returns
    -------
    list of dict
        Properties `osm_id`, `highway`, `name` (null without one) and `is_drivable` (a road under policy
        `drive+service`). A way that leaves the bounds and comes back is more than one feature.
    """
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    lines: Any = shapely.linestrings(graph.lonlat[graph.edges])
    near = np.flatnonzero(shapely.intersects(lines, shapely.box(*bounds)))
    if len(near) == 0:
        return []
    order = near[np.argsort(graph.edge_way[near], kind="stable")]
    ways, first = np.unique(graph.edge_way[order], return_index=True)
    is_drivable = road_ways(graph, "drive+service")
    features: list[dict[str, Any]] = []
    for way, edges in zip(ways.tolist(), np.split(lines[order], first[1:]), strict=True):
        properties = {
            "osm_id": int(graph.ways.id[way]),
            "highway": graph.ways.highway[way],
            "name": graph.ways.name[way] or None,
            "is_drivable": bool(is_drivable[way]),
        }
        joined: Any = shapely.line_merge(shapely.multilinestrings(edges))
        features += [_feature(shapely.get_coordinates(line), properties) for line in shapely.get_parts(joined)]
    return features


def _feature(lonlat: FloatArray, properties: dict[str, Any]) -> dict[str, Any]:
    line = {"type": "LineString", "coordinates": positions(lonlat, local=False)}
    return {"type": "Feature", "geometry": line, "properties": properties}


def write_roads(graph: RoadGraph, bounds: Bounds, folder: Path) -> None:
    """Write `osm_roads.geojson` into a result folder.

    Raises
    ------
    OutputError
        The file could not be written.
    """
    write_collection(folder / ROADS_FILE, road_features(graph, bounds), local=False)
