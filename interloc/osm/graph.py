"""The roads of an OpenStreetMap extract as plain columns."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.osm.coverage import Content

Bounds = tuple[float, float, float, float]
"""West, south, east, north in degrees; west > east where the box crosses the 180th meridian, as in RFC 7946."""


KEPT_TAGS = ("access", "motor_vehicle", "service", "junction", "oneway", "bridge", "tunnel", "covered")
"""Tags of ways that say who may drive there, on which level, and how."""


@dataclass(frozen=True)
class Ways:
    """The W highways that the edges of a road graph are pieces of."""

    id: IntArray
    """(W,) int64: OSM way ids."""
    highway: tuple[str, ...]
    """W values of the tag `highway`."""
    name: tuple[str, ...]
    """W names, else reference numbers, else ""."""
    is_area: BoolArray
    """(W,) bool: true where the way outlines a square (area=yes), not a line to drive along."""
    layer: IntArray
    """(W,) int64: level above (+) or below (-) the ground: the tag `layer`, else 1 of a bridge and -1 of a tunnel."""
    tags: tuple[dict[str, str], ...]
    """W dictionaries: those of `KEPT_TAGS` that each way has."""

    def __len__(self) -> int:
        return len(self.id)

    def label(self, row: int) -> str:
        """Return what a way is: `highway=service "Gottlob-Schreber-Weg"`."""
        return f"highway={self.highway[row]}" + (f' "{self.name[row]}"' if self.name[row] else "")

    @cached_property
    def is_ring(self) -> BoolArray:
        """(W,) bool: parts of roundabouts."""
        return self._tagged(lambda tags: tags.get("junction") in {"roundabout", "circular"})

    @cached_property
    def direction(self) -> IntArray:
        """(W,) int64: 1 where everybody drives along the way, -1 where against it, 0 in both directions."""
        back = self._tagged(lambda tags: tags.get("oneway") in {"-1", "reverse"})
        along = self._tagged(lambda tags: tags.get("oneway") in {"yes", "true", "1"})
        meant = self.is_ring | np.array([highway == "motorway" for highway in self.highway], dtype=np.bool_)
        meant &= ~self._tagged(lambda tags: "oneway" in tags)
        return (along | meant).astype(np.int64) - back

    def _tagged(self, test: Callable[[dict[str, str]], bool]) -> BoolArray:
        return np.array([test(tags) for tags in self.tags], dtype=np.bool_)


@dataclass(frozen=True)
class Buildings:
    """The B buildings of a map that are ways, for pictures only."""

    id: IntArray
    """(B,) int64: ids of OSM ways."""
    outlines: tuple[FloatArray, ...]
    """B (n, 2) float64: closed rings of longitude and latitude, degrees."""

    def __len__(self) -> int:
        return len(self.id)


NO_BUILDINGS = Buildings(np.empty(0, dtype=np.int64), ())
NO_LOOSE_ENDS: IntArray = np.empty((0, 3), dtype=np.int64)


@dataclass(frozen=True)
class RoadGraph:
    """Highways as an undirected graph; every OSM node along a way is a node of it."""

    node_id: IntArray
    """(N,) int64: OSM node ids, ascending."""
    lonlat: FloatArray
    """(N, 2) float64: longitude, latitude, degrees."""
    edges: IntArray
    """(E, 2) int64: rows of the two nodes of each edge."""
    edge_way: IntArray
    """(E,) int64: row of the way that each edge is a piece of."""
    ways: Ways
    source: str
    """Where the map came from: a file name or a service."""
    date: str | None = None
    """State of the OSM data, ISO 8601: what the file declares, else the latest edit of a highway in it."""
    areas: tuple[Bounds, ...] = ()
    """Boxes that the map covers, where the file says so. Ways that leave them are present to their ends, but what they
    meet out there is not: a junction outside does not count as ground truth."""
    clipped_ways: int = 0
    """Ways that refer to nodes which the file does not hold, and were cut into the pieces that exist."""
    loose_ends: IntArray = field(default_factory=lambda: NO_LOOSE_ENDS)
    """(L, 3) int64: where such ways were cut: row of the last node, id of the next one, which has no place, row of the
    way."""
    is_made_up: bool = False
    """The simulator made the map up: its ids are not those of OpenStreetMap."""
    buildings: Buildings = NO_BUILDINGS
    """Those of the surroundings, where they were asked for and the map has any."""
    warnings: tuple[str, ...] = ()
    """What is odd about the map, so that figures drawn from it want care."""

    def __repr__(self) -> str:
        west, south, east, north = self.extent
        return (
            f"<RoadGraph {self.source}: {len(self.ways):,} highways, {len(self.node_id):,} nodes, "
            f"lon {west:.4f} .. {east:.4f}, lat {south:.4f} .. {north:.4f}>"
        )

    @property
    def extent(self) -> Bounds:
        """West, south, east, north of the nodes, degrees."""
        return bounds_of(self.lonlat)

    @property
    def bounds(self) -> Bounds | None:
        """The box around all that the map covers; None where the file does not say."""
        if len(self.areas) < 2:
            return self.areas[0] if self.areas else None
        return bounds_of(np.array(self.areas).reshape(-1, 2))

    def declares(self, lonlat: FloatArray) -> BoolArray:
        """Return which (N, 2) longitudes, latitudes lie in the areas of the map; all where the file declares none."""
        inside: BoolArray = np.any([within(area, lonlat) for area in self.areas or (None,)], axis=0)
        return inside

    @cached_property
    def content(self) -> Content:
        """What the highways say of the places that the map covers."""
        return Content(
            self.lonlat, self.edges, self.edge_way, self.loose_ends, self.degree(), is_made_up=self.is_made_up
        )

    def covers(self, lonlat: FloatArray) -> BoolArray:
        """Return which of (N, 2) degrees the map covers, so that what it lacks there does not exist.

        These lie within the areas that the file declares (anywhere, if it declares none), not far from a highway, and
        on this side of every line at which the file seems to end (`interloc.osm.coverage`).
        """
        inside = self.declares(lonlat)
        rows = np.flatnonzero(inside)
        if len(rows):
            inside[rows] = self.content.covers(lonlat[rows])
        return inside

    @cached_property
    def inside_bounds(self) -> BoolArray:
        """(N,) bool: nodes in the declared areas."""
        return self.declares(self.lonlat)

    def edges_of(self, way_mask: BoolArray) -> IntArray:
        """Return the edges, (M, 2) int64, of the ways under a (W,) mask."""
        return self.edges[way_mask[self.edge_way]]

    def degree(self, ways: BoolArray | None = None) -> IntArray:
        """Return how many distinct neighbours each node has, (N,) int64, along the ways under a (W,) mask or all.

        Two ways between the same two nodes count once, a way from a node to itself does not count. A neighbour beyond
        the edge of the map counts, too: the road to it leaves the node.
        """
        pairs = distinct_edges(self.edges if ways is None else self.edges_of(ways))
        beyond = self.loose_ends if ways is None else self.loose_ends[ways[self.loose_ends[:, 2]]]
        beyond = np.unique(beyond[:, :2], axis=0)
        ends = np.concatenate([pairs.ravel(), beyond[:, 0]])
        return np.bincount(ends, minlength=len(self.node_id)).astype(np.int64)


def layer_of(tags: Any) -> int:  # noqa: ANN401 - a dictionary, or osmium's list of tags
    """Return the level of a way above or below the ground by its tags."""
    try:
        return max(-99, min(int(tags.get("layer") or ""), 99))
    except ValueError:
        is_bridge = (tags.get("bridge") or "no") != "no"
        is_tunnel = (tags.get("tunnel") or "no") not in {"no", "building_passage"}
        return int(is_bridge) - int(is_tunnel)


def distinct_edges(edges: IntArray) -> IntArray:
    """Return (M, 2) int64 edges without direction, repetition and loops, each with its smaller node first."""
    pairs = np.sort(edges, axis=1)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.unique(pairs, axis=0)


def neighbours_of(edges: IntArray) -> dict[int, list[int]]:
    """Return of each node of (M, 2) edges those that one joins to it."""
    found: dict[int, list[int]] = {}
    for a, b in edges.tolist():
        found.setdefault(a, []).append(b)
        found.setdefault(b, []).append(a)
    return found


def within(bounds: Bounds | None, lonlat: FloatArray) -> BoolArray:
    """Return which (N, 2) longitudes, latitudes lie in the bounds, edges included; all where there are none."""
    if bounds is None:
        return np.ones(len(lonlat), dtype=np.bool_)
    west, south, east, north = bounds
    lon, lat = lonlat[:, 0], lonlat[:, 1]
    in_width = (lon >= west) & (lon <= east) if west <= east else (lon >= west) | (lon <= east)
    return in_width & (lat >= south) & (lat <= north)


def bounds_of(lonlat: FloatArray) -> Bounds:
    """Return the bounds of (N, 2) longitudes, latitudes: across the 180th meridian where that is shorter."""
    west, south = lonlat.min(axis=0).tolist()
    east, north = lonlat.max(axis=0).tolist()
    if east - west > 180.0:
        lon = lonlat[:, 0]
        west, east = float(lon[lon >= 0.0].min()), float(lon[lon < 0.0].max())
    return west, south, east, north
