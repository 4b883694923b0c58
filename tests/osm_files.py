"""Maps of OpenStreetMap: written plainly, and as they are read."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.osm.graph import RoadGraph, Ways, layer_of


def osm_text(lonlat: FloatArray, ways: Iterable[Sequence[int]]) -> str:
    """Write nodes, whose ids are their rows from 1, and streets through nodes of these ids."""
    nodes = [f'<node id="{id_}" lat="{lat:.9f}" lon="{lon:.9f}"/>' for id_, (lon, lat) in enumerate(lonlat, 1)]
    streets = [
        f'<way id="{id_}">' + "".join(f'<nd ref="{ref}"/>' for ref in refs) + '<tag k="highway" v="residential"/></way>'
        for id_, refs in enumerate(ways, 1000)
    ]
    return "\n".join(['<?xml version="1.0"?>', '<osm version="0.6">', *nodes, *streets, "</osm>", ""])


def road_graph(
    lonlat: FloatArray, ways: Sequence[tuple[Any, ...]], first_id: int, source: str, areas: Sequence[int] = ()
) -> RoadGraph:
    """Make a map of nodes, whose ids count up from one, and ways: highway, rows of nodes, more tags; some are areas."""
    tags = [dict(*more) for _, _, *more in ways]
    pieces = [(a, b, way) for way, (_, nodes, *_) in enumerate(ways) for a, b in pairwise(nodes)]
    table = np.array(pieces, dtype=np.int64)
    return RoadGraph(
        node_id=np.arange(len(lonlat)) + first_id,
        lonlat=lonlat,
        edges=table[:, :2],
        edge_way=table[:, 2],
        ways=Ways(
            id=np.arange(len(ways)),
            highway=tuple(highway for highway, *_ in ways),
            name=tuple(each.pop("name", "") for each in tags),
            is_area=np.isin(np.arange(len(ways)), areas),
            layer=np.array([layer_of(each) for each in tags]),
            tags=tuple(tags),
        ),
        source=source,
    )
