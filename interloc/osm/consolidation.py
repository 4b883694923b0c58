"""Merging the OSM nodes of one physical intersection: dual carriageways, staggered and compound junctions."""

from __future__ import annotations

import networkx as nx
import numpy as np
import osmnx
from pyproj import Transformer
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.osm.graph import MIN_DEGREE, RoadGraph, distinct_edges


def consolidate(
    graph: RoadGraph, edges: IntArray, rows: IntArray, tolerance_m: float
) -> tuple[IntArray, FloatArray, IntArray]:
    """Merge intersections that are close and connected with each other by `osmnx.consolidate_intersections`.

    Parameters
    ----------
    graph
        Roads of the map.
    edges : (E, 2) int64
        Those of its edges that are roads.
    rows : (N,) int64
        Its nodes that are intersections.
    tolerance_m
        Radius by which each node is widened; nodes up to twice as far apart merge if a road joins them directly.

    Returns
    -------
    osm_id : (M,) int64
        Smallest node id of each merged intersection, ascending.
    lonlat : (M, 2) float64
        Longitude, latitude, degrees.
    degree : (M,) int64
        Roads that leave the merged intersection.
    """
    degree_of_node = graph.degree(edges)
    links = _links(distinct_edges(edges), degree_of_node >= MIN_DEGREE)
    links = links[np.isin(links, rows).all(axis=1)]
    if len(links) == 0:
        return graph.node_id[rows], graph.lonlat[rows], degree_of_node[rows]  # osmnx rebuilds no graph without edges

    epsg = _utm_epsg(graph.lonlat[rows])
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
    ids = np.array(osm_id, dtype=np.int64)[order]
    return ids, np.stack([lon, lat], axis=-1), np.array(degree, dtype=np.int64)[order]


def _links(edges: IntArray, is_intersection: BoolArray) -> IntArray:
    """Return (L, 2) int64 pairs of intersections that a road joins without another one between; loops left out.

    The nodes between intersections have at most two neighbours, so what remains of the graph without the
    intersections falls into plain chains: a chain that touches two intersections joins them.
    """
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


def _utm_epsg(lonlat: FloatArray) -> str:
    lon, lat = np.median(lonlat, axis=0)
    zone = int((lon + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if lat >= 0 else 32700) + zone}"
