"""The roads of an OpenStreetMap extract as plain columns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray

Bounds = tuple[float, float, float, float]
"""West, south, east, north in degrees."""


@dataclass(frozen=True)
class Ways:
    """The W highways that the edges of a road graph are pieces of.

    Attributes
    ----------
    id : (W,) int64
        OSM way ids.
    highway : tuple of W str
        Value of the tag `highway`.
    name : tuple of W str
        Name, else the reference number, else "".
    is_area : (W,) bool
        True where the way outlines a square (area=yes), not a line to drive along.
    """

    id: IntArray
    highway: tuple[str, ...]
    name: tuple[str, ...]
    is_area: BoolArray

    def __len__(self) -> int:
        return len(self.id)


@dataclass(frozen=True)
class Buildings:
    """The B buildings of a map, for pictures only.

    Attributes
    ----------
    id : (B,) int64
        OSM ids; a relation of several outlines is several buildings.
    is_relation : (B,) bool
        Whether the id is that of a relation (a multipolygon), not of a way.
    outlines : tuple of B (n, 2) float64
        Closed rings of longitude and latitude, degrees.
    holes : tuple of B tuples of (n, 2) float64
        Courtyards: rings within the outline, as they.
    """

    id: IntArray
    is_relation: BoolArray
    outlines: tuple[FloatArray, ...]
    holes: tuple[tuple[FloatArray, ...], ...]

    def __len__(self) -> int:
        return len(self.id)


NO_BUILDINGS = Buildings(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.bool_), (), ())


@dataclass(frozen=True)
class RoadGraph:
    """Highways as an undirected graph; every OSM node along a way is a node of it.

    Attributes
    ----------
    node_id : (N,) int64
        OSM node ids, ascending.
    lonlat : (N, 2) float64
        Longitude, latitude, degrees.
    edges : (E, 2) int64
        Rows of the two nodes of each edge.
    edge_way : (E,) int64
        Row of the way that each edge is a piece of.
    ways : Ways
    source : str
        Where the map came from: a file name or a service.
    date : str or None
        State of the OSM data, ISO 8601: what the file declares, else the latest edit of a highway in it.
    bounds : Bounds or None
        What the map covers, where the file says so. Ways that leave it are present to their ends, but what they
        meet out there is not: a junction outside does not count as ground truth.
    clipped_ways : int
        Ways that refer to nodes which the file does not hold, and were cut into the pieces that exist.
    is_made_up : bool
        The simulator made the map up: its ids are not those of OpenStreetMap.
    buildings : Buildings
        Those of the surroundings, where they were asked for and the map has any.
    """

    node_id: IntArray
    lonlat: FloatArray
    edges: IntArray
    edge_way: IntArray
    ways: Ways
    source: str
    date: str | None = None
    bounds: Bounds | None = None
    clipped_ways: int = 0
    is_made_up: bool = False
    buildings: Buildings = NO_BUILDINGS

    def __repr__(self) -> str:
        west, south, east, north = self.extent
        return (
            f"<RoadGraph {self.source}: {len(self.ways):,} highways, {len(self.node_id):,} nodes, "
            f"lon {west:.4f} .. {east:.4f}, lat {south:.4f} .. {north:.4f}>"
        )

    @property
    def extent(self) -> Bounds:
        """West, south, east, north of the nodes, degrees."""
        west, south = self.lonlat.min(axis=0)
        east, north = self.lonlat.max(axis=0)
        return float(west), float(south), float(east), float(north)

    @cached_property
    def inside_bounds(self) -> BoolArray:
        """(N,) bool: nodes within the bounds; all of them where the file declares none."""
        return within(self.bounds, self.lonlat)

    def edges_of(self, way_mask: BoolArray) -> IntArray:
        """Return the edges, (M, 2) int64, of the ways under a (W,) mask."""
        return self.edges[way_mask[self.edge_way]]

    def degree(self, edges: IntArray | None = None) -> IntArray:
        """Return how many distinct neighbours each node has, (N,) int64, over some edges or all.

        Two ways between the same two nodes count once, a way from a node to itself does not count.
        """
        pairs = distinct_edges(self.edges if edges is None else edges)
        return np.bincount(pairs.ravel(), minlength=len(self.node_id)).astype(np.int64)


def distinct_edges(edges: IntArray) -> IntArray:
    """Return (M, 2) int64 edges without direction, repetition and loops, each with its smaller node first."""
    pairs = np.sort(edges, axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.unique(pairs, axis=0)


def within(bounds: Bounds | None, lonlat: FloatArray) -> BoolArray:
    """Return which (N, 2) longitudes, latitudes lie in the bounds, edges included; all where there are none."""
    if bounds is None:
        return np.ones(len(lonlat), dtype=np.bool_)
    west, south, east, north = bounds
    lon, lat = lonlat[:, 0], lonlat[:, 1]
    inside: BoolArray = (lon >= west) & (lon <= east) & (lat >= south) & (lat <= north)
    return inside
