"""Which OSM nodes are ground truth intersections: four named policies.

The denominator of recall moves by a factor of four with this choice (DESIGN: KITTI 00), so every figure names it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.errors import ConfigError
from interloc.osm.graph import MIN_DEGREE, RoadGraph

Policy = Literal["drive", "drive+service", "all", "consolidated"]
POLICIES: tuple[Policy, ...] = get_args(Policy)

POLICY_TITLES: dict[Policy, str] = {
    "drive": "Drivable public roads",
    "drive+service": "Drivable roads and service roads",
    "all": "Ways of any kind",
    "consolidated": "Drivable public roads, nodes merged",
}
"""What a policy is called in a list to choose from."""

POLICY_MEANINGS: dict[Policy, str] = {
    "drive": "nodes where at least three drivable public roads meet (motorway to residential, no service roads)",
    "drive+service": "nodes where at least three drivable roads meet, service roads included",
    "all": "nodes where at least three ways of any kind meet, footpaths and cycleways included",
    "consolidated": "nodes where at least three drivable public roads meet, those of one compound junction merged",
}
"""Which OSM nodes a policy counts, in words: for reports, the command line, the API and the page."""

POLICY_HELP = "Which OSM nodes count as intersections. " + " ".join(
    f"{policy}: {meaning}." for policy, meaning in POLICY_MEANINGS.items()
)

_LINKED = ("motorway", "trunk", "primary", "secondary", "tertiary")
DRIVABLE = frozenset(
    {*_LINKED, *(f"{name}_link" for name in _LINKED), "unclassified", "residential", "living_street", "road"}
)
"""Values of `highway` that policy `drive` takes as roads."""


@dataclass(frozen=True)
class IntersectionNodes:
    """The N ground truth intersections of a map under a policy.

    Attributes
    ----------
    policy : Policy
    osm_id : (N,) int64
        Node ids; of a consolidated intersection, the smallest of its nodes.
    lonlat : (N, 2) float64
        Longitude, latitude, degrees.
    degree : (N,) int64
        Distinct neighbours; of a consolidated intersection, those outside it.
    tolerance_m : float or None
        Reach of the merging, for policy `consolidated` only.
    """

    policy: Policy
    osm_id: IntArray
    lonlat: FloatArray
    degree: IntArray
    tolerance_m: float | None = None

    def __len__(self) -> int:
        return len(self.osm_id)


def road_ways(graph: RoadGraph, policy: Policy) -> BoolArray:
    """Return the ways, (W,) bool, that are roads under a policy."""
    if policy == "all":
        return np.ones(len(graph.ways), dtype=np.bool_)
    classes = DRIVABLE | {"service"} if policy == "drive+service" else DRIVABLE
    drivable = np.array([highway in classes for highway in graph.ways.highway], dtype=np.bool_)
    road: BoolArray = drivable & ~graph.ways.is_area
    return road


def intersection_nodes(graph: RoadGraph, policy: Policy = "drive", tolerance_m: float = 15.0) -> IntersectionNodes:
    """Find the ground truth intersections: nodes with at least three distinct neighbours along roads.

    Parameters
    ----------
    graph
        Roads of the map.
    policy
        `drive`: drivable public roads. `drive+service`: service roads too. `all`: every highway, footpaths and
        squares included. `consolidated`: `drive`, with the nodes of one physical intersection merged into one.
    tolerance_m
        For `consolidated`: each node is widened by this radius, and what overlaps is merged.

    Returns
    -------
    IntersectionNodes
        Only nodes within the bounds of the map: beyond them the crossing roads may be missing.

    Raises
    ------
    ConfigError
        There is no such policy, or the tolerance is not positive.

    Notes
    -----
    Paper, section V-A: "graph nodes with at least three connected edges".
    """
    if policy not in POLICIES:
        raise ConfigError(f"policy {policy!r} is unknown. Expected one of: {', '.join(POLICIES)}.")
    degree = graph.degree(graph.edges_of(road_ways(graph, policy)))
    rows = np.flatnonzero((degree >= MIN_DEGREE) & graph.inside_bounds)
    if policy == "consolidated":
        if not tolerance_m > 0:
            raise ConfigError(f"tolerance_m is {tolerance_m}. Expected a positive number of metres.")
        from interloc.osm.consolidation import consolidate  # noqa: PLC0415 - osmnx takes seconds to import

        osm_id, lonlat, merged_degree = consolidate(graph, graph.edges_of(road_ways(graph, policy)), rows, tolerance_m)
        return IntersectionNodes(policy, osm_id, lonlat, merged_degree, tolerance_m)
    return IntersectionNodes(policy, graph.node_id[rows], graph.lonlat[rows], degree[rows])
