"""Slips of drawing that hide a junction in OpenStreetMap: nodes at one place, and ways that cross without a node."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.osm.graph import RoadGraph, distinct_edges
from interloc.osm.intersections import MIN_DEGREE

ONE_PLACE_M = 0.5
"""Nodes so near each other were meant to be one; editors place them to a few centimetres."""


@dataclass(frozen=True)
class Unjoined:
    """A place where roads meet on one level, and the map does not join them."""

    kind: Literal["not_joined", "no_node"]
    xy: FloatArray
    """(2,) float64: in the plane of the nodes."""
    node: int | None
    """Row of a node that lies there, where one does."""
    text: str
    """What was drawn, for a person who looks at it."""


def unjoined(graph: RoadGraph, xy: FloatArray, ways: BoolArray, near: BoolArray) -> list[Unjoined]:
    """Find where the (W,) ways of a map seem to meet and share no node, by the (N, 2) places of its nodes in a plane.

    Only edges with a node that is `near`, (N,), are looked at. Nodes of different levels are no slip, and neither are
    those of a road drawn twice: joined, they were no junction, or a smaller one than what is joined already.
    """
    import shapely  # noqa: PLC0415 - an eighth of a second of start-up time

    rows = np.flatnonzero(ways[graph.edge_way] & near[graph.edges].any(axis=1))
    edges, way = graph.edges[rows], graph.edge_way[rows]
    layer = (np.zeros(len(graph.ways), np.int64) if graph.ways.layer is None else graph.ways.layer)[way]
    lines: Any = shapely.linestrings(xy[edges])
    tree = shapely.STRtree(lines)
    found, used = _at_one_place(graph, xy, edges, layer)

    degree = graph.degree(ways)
    ends = np.array([row for row in np.unique(edges) if degree[row] == 1 and row not in used], dtype=np.int64)
    for end, line in zip(*tree.query(shapely.points(xy[ends]), "dwithin", distance=ONE_PLACE_M), strict=True):
        (own,) = np.flatnonzero((edges == ends[end]).any(axis=1))[:1]
        if layer[own] == layer[line] and not np.isin(edges[line], edges[own]).any() and way[own] != way[line]:
            text = f"node {graph.node_id[ends[end]]} lies on {graph.ways.label(way[line])} and is not joined to it"
            found.append(Unjoined("not_joined", xy[ends[end]], int(ends[end]), text))

    ends_of: Any = shapely.multipoints(xy[ends])
    one, other = tree.query(lines, "crosses")
    is_bare = np.array([not {"bridge", "tunnel"} & each.keys() for each in graph.ways.tags or ({},) * len(graph.ways)])
    apart = (edges[one][:, :, None] != edges[other][:, None]).all(axis=(1, 2))
    for a, b in np.stack([one, other], axis=1)[(one < other) & apart & (layer[one] == layer[other])].tolist():
        if is_bare[way[a]] and is_bare[way[b]]:
            place: Any = shapely.intersection(lines[a], lines[b])
            if shapely.dwithin(place, ends_of, ONE_PLACE_M):
                continue
            text = (
                f"{graph.ways.label(way[a])} and {graph.ways.label(way[b])} cross on one level without a node in common"
            )
            found.append(Unjoined("no_node", np.array([place.x, place.y]), None, text))
    return found


def _at_one_place(
    graph: RoadGraph, xy: FloatArray, edges: IntArray, layer: IntArray
) -> tuple[list[Unjoined], frozenset[int]]:
    """Find nodes at one place that would be a junction together; return these places, and all nodes at one place."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415
    from scipy.spatial import cKDTree  # noqa: PLC0415

    levels: dict[int, set[int]] = {}
    for (a, b), level in zip(edges.tolist(), layer.tolist(), strict=True):
        levels.setdefault(a, set()).add(level)
        levels.setdefault(b, set()).add(level)
    edges, nodes = distinct_edges(edges), np.unique(edges)
    near = nodes[cKDTree(xy[nodes]).query_pairs(ONE_PLACE_M, output_type="ndarray")].reshape(-1, 2)
    joined = {tuple(pair) for pair in edges.tolist()}
    pairs = [pair for pair in near.tolist() if tuple(pair) not in joined and levels[pair[0]] & levels[pair[1]]]
    if not pairs:
        return [], frozenset()
    one, other = np.searchsorted(nodes, np.array(pairs)).T
    size = (len(nodes), len(nodes))
    _, place = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=size), directed=False)
    own = np.bincount(np.searchsorted(nodes, edges).ravel(), minlength=len(nodes))
    between = distinct_edges(place[np.searchsorted(nodes, edges)].astype(np.int64))
    together = np.bincount(between.ravel(), minlength=int(place.max()) + 1)
    found = []
    for each in np.unique(place[np.concatenate([one, other])]).tolist():
        members = np.flatnonzero(place == each)
        if together[each] >= MIN_DEGREE and together[each] > own[members].max():
            ids = " and ".join(str(node) for node in graph.node_id[nodes[members]].tolist())
            text = f"nodes {ids} lie at the same place and are not joined"
            found.append(Unjoined("not_joined", xy[nodes[members]].mean(axis=0), int(nodes[members[0]]), text))
    return found, frozenset(np.array(pairs).ravel().tolist())
