"""Roads as a route graph of Nav2 (`nav2_route`, `geojson_graph_file_loader.cpp`), for robots.

The loader goes straight from node to node, whatever the geometry of an edge: roads are cut where they bend. Edges lead
one way: each is there twice. Coordinates are read as 32-bit numbers: they are metres from a round place of the map,
which `origin` tells. What is unknown is left out, since null is refused.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import shapely

from interloc.output.geojson import encode
from interloc.roadmap.network import RoadEdge, RoadNetwork

FRAME = "map"
_BEND_M = 0.3  # a road may leave the straight line by
_ORIGIN_M = 100.0
_MIN_SEEN = 0.5


def nav2_graph(network: RoadNetwork) -> bytes:
    """Return the graph as GeoJSON: points are nodes, lines of two positions edges with `startid` and `endid`."""
    places = {node.id: node.xy for node in network.nodes}
    origin = np.floor(np.min(list(places.values()), axis=0) / _ORIGIN_M) * _ORIGIN_M if places else np.zeros(2)
    edges: list[dict[str, Any]] = []
    number = max(places, default=0)
    used = set[int]()
    for edge in network.edges:
        if edge.seen < _MIN_SEEN:
            continue
        bends = shapely.get_coordinates(shapely.simplify(shapely.LineString(edge.xy), _BEND_M))
        inner = [xy for xy in bends if min(np.linalg.norm(xy - places[end]) for end in (edge.start, edge.end)) > 0.01]
        stops = [edge.start, *range(number + 1, number + 1 + len(inner)), edge.end]
        number += len(inner)
        places |= dict(zip(stops[1:-1], inner, strict=True))
        used |= set(stops)
        for pair in (pair for one, other in pairwise(stops) for pair in ((one, other), (other, one))):
            line = [_position(places[stop] - origin) for stop in pair]
            edges.append(_feature("LineString", line, _edge_properties(edge, *pair)))
    for edge_number, feature in enumerate(edges, number + 1):
        feature["properties"]["id"] = edge_number
    kinds = {node.id: node.kind for node in network.nodes}
    nodes = [
        _feature(
            "Point",
            _position(places[stop] - origin),
            {"id": stop, "frame": FRAME, "metadata": {"kind": kinds.get(stop, "bend")}},
        )
        for stop in sorted(used)
    ]
    head = {"type": "FeatureCollection", "name": "roads", "origin": {"x_m": origin[0], "y_m": origin[1]}}
    if network.epsg is not None:
        head["origin"]["crs"] = f"EPSG:{network.epsg}"  # type: ignore[index]
    return encode({**head, "features": [*nodes, *edges]}).encode() + b"\n"


def _feature(kind: str, coordinates: Any, properties: dict[str, Any]) -> dict[str, Any]:  # noqa: ANN401 - of GeoJSON
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}


def _position(xy: Any) -> list[float]:  # noqa: ANN401 - two numbers
    return [round(float(value), 3) for value in xy]


def _edge_properties(edge: RoadEdge, start: int, end: int) -> dict[str, Any]:
    known = {"width_m": edge.width_m, "width_p10_m": edge.width_p10_m, "seen": edge.seen}
    metadata = {name: round(float(value), 2) for name, value in known.items() if np.isfinite(value)}
    return {"startid": start, "endid": end, "metadata": {"road": edge.id, "is_driven": edge.is_driven, **metadata}}
