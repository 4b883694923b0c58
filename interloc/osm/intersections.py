"""Which nodes of a road graph are ground truth intersections, by policy."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.errors import ConfigError
from interloc.geometry import middle_of, utm_zone
from interloc.osm.graph import RoadGraph, distinct_edges
from interloc.osm.policies import POLICIES, Policy

MIN_DEGREE = 3
"""Neighbours that make a node an intersection."""

_LINKED = ("motorway", "trunk", "primary", "secondary", "tertiary")
DRIVABLE = frozenset(
    {*_LINKED, *(f"{name}_link" for name in _LINKED), "unclassified", "residential", "living_street", "road"}
)
"""Values of `highway` that policy `drive` takes as roads."""

_NOT_THERE = frozenset(
    {
        *("proposed", "planned", "construction", "disused", "abandoned", "razed", "demolished", "removed", "no"),
        *("dismantled", "historic", "platform"),
    }
)
"""Values of `highway` of what cannot be gone along: not built, gone, or no way."""

DRIVABLE_OR_SERVICE = DRIVABLE | {"service"}
"""The same of policy `drive+service`."""


@dataclass(frozen=True)
class IntersectionNodes:
    """The N ground truth intersections of a map under a policy."""

    policy: Policy
    osm_id: IntArray
    """(N,) int64: node ids; of a consolidated intersection, the smallest of its nodes."""
    lonlat: FloatArray
    """(N, 2) float64: longitude, latitude, degrees."""
    degree: IntArray
    """(N,) int64: distinct neighbours; of a consolidated intersection, those outside it."""
    tolerance_m: float | None = None
    """Radius of the merging, metres; None under all policies but `consolidated`."""

    def __len__(self) -> int:
        return len(self.osm_id)

    def select(self, rows: BoolArray) -> IntersectionNodes:
        """Return those under a (N,) mask."""
        return replace(self, osm_id=self.osm_id[rows], lonlat=self.lonlat[rows], degree=self.degree[rows])


def road_ways(graph: RoadGraph, policy: Policy) -> BoolArray:
    """Return the ways, (W,) bool, that are roads under a policy."""
    if policy == "all":
        return np.array([highway not in _NOT_THERE for highway in graph.ways.highway], dtype=np.bool_)
    classes = DRIVABLE_OR_SERVICE if policy == "drive+service" else DRIVABLE
    drivable = np.array([highway in classes for highway in graph.ways.highway], dtype=np.bool_)
    road: BoolArray = drivable & ~graph.ways.is_area
    return road


def intersection_nodes(graph: RoadGraph, policy: Policy = "drive", tolerance_m: float = 15.0) -> IntersectionNodes:
    """Find the ground truth intersections: nodes with at least three distinct neighbours along roads.

    Only nodes within the declared areas of the map: beyond them the crossing roads may be missing. The tolerance is the
    radius of the merging under policy `consolidated`, metres. Paper, section V-A: "graph nodes with at least three
    connected edges".
    """
    if policy not in POLICIES:
        raise ConfigError(f"policy {policy!r} is unknown. Expected one of: {', '.join(POLICIES)}.")
    roads = road_ways(graph, policy)
    degree = graph.degree(roads)
    rows = np.flatnonzero((degree >= MIN_DEGREE) & graph.inside_bounds)
    if policy == "consolidated":
        if not tolerance_m > 0:
            raise ConfigError(f"tolerance_m is {tolerance_m}. Expected a positive number of metres.")
        return IntersectionNodes(policy, *consolidate(graph, roads, rows, tolerance_m), tolerance_m)
    return IntersectionNodes(policy, graph.node_id[rows], graph.lonlat[rows], degree[rows])


def consolidate(
    graph: RoadGraph, roads: BoolArray, rows: IntArray, tolerance_m: float
) -> tuple[IntArray, FloatArray, IntArray]:
    """Merge the nodes of one physical intersection: dual carriageways, staggered and compound junctions.

    `roads` are the ways, (W,), and `rows` the intersections, (N,), of the graph. Nodes up to twice the tolerance apart,
    metres, merge if a road joins them directly. Returns smallest node id, ascending, longitude and latitude, and degree
    of each merged intersection, (M,) rows: the roads that leave it, three or more. Where the lanes of one road part
    around an island and join again, two leave, and it is none.

    `osmnx.consolidate_intersections` over a network of the intersections alone: what is near and not joined by a road,
    such as a bridge over a crossing, stays apart.
    """
    import networkx as nx  # noqa: PLC0415 - with osmnx
    import osmnx  # noqa: PLC0415 - takes seconds to import
    from pyproj import Transformer  # noqa: PLC0415

    degree_of_node = graph.degree(roads)
    links = _links(distinct_edges(graph.edges_of(roads)), degree_of_node >= MIN_DEGREE)
    links = links[np.isin(links, rows).all(axis=1)]
    if len(links) == 0:
        return graph.node_id[rows], graph.lonlat[rows], degree_of_node[rows]  # osmnx fails on a graph without edges

    epsg = f"EPSG:{utm_zone(*middle_of(graph.lonlat[rows]))}"
    to_utm = Transformer.from_crs("EPSG:4326", epsg, always_xy=True)
    x, y = to_utm.transform(graph.lonlat[rows, 0], graph.lonlat[rows, 1])
    network = nx.MultiDiGraph(crs=epsg)
    network.add_nodes_from((row, {"x": px, "y": py}) for row, px, py in zip(rows.tolist(), x, y, strict=True))
    network.add_edges_from(links.tolist())
    # Every node here is an intersection; what looks like a dead end has roads that lead to no other intersection.
    merged = osmnx.consolidate_intersections(network, tolerance=tolerance_m, dead_ends=True, reconnect_edges=False)

    osm_id, xy, degree = [], [], []
    for _, data in merged.nodes(data=True):
        members = np.atleast_1d(data["osmid_original"]).astype(np.int64)
        inside = np.isin(links, members).all(axis=1).sum()
        osm_id.append(int(graph.node_id[members].min()))
        xy.append((data["x"], data["y"]))
        degree.append(int(degree_of_node[members].sum() - 2 * inside))
    order = np.argsort(osm_id)
    merged_xy = np.array(xy, dtype=np.float64)[order]
    lon, lat = to_utm.transform(merged_xy[:, 0], merged_xy[:, 1], direction="INVERSE")
    ids, merged_degree = np.array(osm_id, dtype=np.int64)[order], np.array(degree, dtype=np.int64)[order]
    is_met = merged_degree >= MIN_DEGREE
    return ids[is_met], np.stack([lon, lat], axis=-1)[is_met], merged_degree[is_met]


def _links(edges: IntArray, is_intersection: BoolArray) -> IntArray:
    """Return (L, 2) int64 pairs of distinct intersections that a road joins without another intersection between.

    The nodes between intersections have at most two neighbours, so what remains of the graph without the
    intersections falls into plain chains: a chain that touches two intersections joins them.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    node_count = len(is_intersection)
    ends = is_intersection[edges]
    direct = edges[ends.all(axis=1)]
    plain = edges[~ends.any(axis=1)]
    chains = coo_array((np.ones(len(plain)), (plain[:, 0], plain[:, 1])), shape=(node_count, node_count))
    _, chain = connected_components(chains, directed=False)

    mixed = edges[ends.sum(axis=1) == 1]
    first_is_end = is_intersection[mixed[:, 0]]
    end = np.where(first_is_end, mixed[:, 0], mixed[:, 1])
    chain_of_end = chain[np.where(first_is_end, mixed[:, 1], mixed[:, 0])]
    order = np.argsort(chain_of_end, kind="stable")
    end, chain_of_end = end[order], chain_of_end[order]
    joined = chain_of_end[:-1] == chain_of_end[1:]
    through = np.stack([end[:-1], end[1:]], axis=-1)[joined]
    links: IntArray = np.concatenate([direct, through])
    proper: IntArray = links[links[:, 0] != links[:, 1]]
    return proper
