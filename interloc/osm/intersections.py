"""Which nodes of a road graph are ground truth intersections, by policy."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.errors import ConfigError
from interloc.geometry import enu_from_lonlat, linked_groups, lonlat_from_enu, middle_of, tree_of
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
    members: tuple[tuple[int, ...], ...] = ()
    """Node ids of each under policy `consolidated`, ascending: one, where nothing was merged; else empty."""

    def __len__(self) -> int:
        return len(self.osm_id)

    def select(self, rows: BoolArray) -> "IntersectionNodes":
        """Return those under a (N,) mask."""
        members = tuple(each for each, is_kept in zip(self.members, rows.tolist(), strict=False) if is_kept)
        return replace(
            self, osm_id=self.osm_id[rows], lonlat=self.lonlat[rows], degree=self.degree[rows], members=members
        )

    def members_of(self, row: int) -> tuple[int, ...]:
        """Return the ids of the nodes that are one place in a row."""
        return self.members[row] if self.members else (int(self.osm_id[row]),)


def road_ways(graph: RoadGraph, policy: Policy) -> BoolArray:
    """Return the ways, (W,) bool, that are roads under a policy."""
    if policy == "all":
        return np.array([highway not in _NOT_THERE for highway in graph.ways.highway], dtype=np.bool_)
    classes = DRIVABLE_OR_SERVICE if policy == "drive+service" else DRIVABLE
    drivable = np.array([highway in classes for highway in graph.ways.highway], dtype=np.bool_)
    return drivable & ~graph.ways.is_area


def intersection_nodes(graph: RoadGraph, policy: Policy = "drive", tolerance_m: float = 15.0) -> IntersectionNodes:
    """Find the ground truth intersections: nodes with at least three distinct neighbours along roads.

    Only nodes within the declared areas of the map: beyond them the crossing roads may be missing. Under policy
    `consolidated` roads up to twice the tolerance long, metres, join the nodes of one place. Paper, section V-A: "graph
    nodes with at least three connected edges".
    """
    if policy not in POLICIES:
        raise ConfigError(f"policy {policy!r} is unknown. Expected one of: {', '.join(POLICIES)}.")
    roads = road_ways(graph, policy)
    degree = graph.degree(roads)
    rows = np.flatnonzero((degree >= MIN_DEGREE) & graph.inside_bounds)
    if policy == "consolidated":
        if not tolerance_m > 0:
            raise ConfigError(f"tolerance_m is {tolerance_m}. Expected a positive number of metres.")
        return _consolidate(graph, roads, rows, tolerance_m)
    return IntersectionNodes(policy, graph.node_id[rows], graph.lonlat[rows], degree[rows])


# what is one place ----------------------------------------------------------------------------------------------------

_LONG = 2.0  # islands before a roundabout may be so many times as long as others
_ALONG, _ACROSS = 0.8, 0.7  # cosines: of opposite carriageways, and of a road across them


class _Link(NamedTuple):
    """A road from one intersection to the next, rows of the graph."""

    nodes: tuple[int, ...]
    length_m: float
    direction: int
    """1 where everybody drives from the first node to the last one, -1 back; 0: in both directions."""
    is_ring: bool
    is_level: bool
    """Whether it lies on one level with a road at either end besides it."""

    @property
    def ends(self) -> tuple[int, int]:
        return self.nodes[0], self.nodes[-1]


class _Network:
    """The roads around intersections, for what tells whether two of them are one place."""

    def __init__(self, graph: RoadGraph, roads: BoolArray, rows: IntArray, reach_m: float) -> None:
        self.ways, self.reach_m = graph.ways, reach_m
        self.origin = middle_of(graph.lonlat[rows])
        self.xy = enu_from_lonlat(self.origin[1], self.origin[0], graph.lonlat)
        self.degree = graph.degree(roads)
        self._layer = graph.ways.layer
        self._next: dict[int, dict[int, tuple[int, int]]] = {}  # node -> next -> way, and 1 along it, -1 against it
        pieces = np.flatnonzero(roads[graph.edge_way] & (graph.edges[:, 0] != graph.edges[:, 1]))
        for (a, b), way in zip(graph.edges[pieces].tolist(), graph.edge_way[pieces].tolist(), strict=True):
            self._next.setdefault(a, {}).setdefault(b, (way, 1))
            self._next.setdefault(b, {}).setdefault(a, (way, -1))
        known = frozenset(rows.tolist())
        found = (self._walk(row, each, known) for row in rows.tolist() for each in self._next.get(row, ()))
        self.links = [link for link in found if link is not None and (link.is_ring or link.is_level)]

    def _walk(self, start: int, onward: int, known: frozenset[int]) -> _Link | None:
        """Follow a road from an intersection to the next one; None: too long, or the same from its other end."""
        nodes, ways, length = [start], list[int](), 0.0
        while True:
            ways.append(self._next[nodes[-1]][onward][0])
            length += float(np.hypot(*(self.xy[onward] - self.xy[nodes[-1]])))
            nodes.append(onward)
            is_ring = all(self.ways.is_ring[way] for way in ways)
            if length > _LONG * self.reach_m and not is_ring:
                return None
            if onward == start or self.degree[onward] >= MIN_DEGREE:
                break
            others = [each for each in self._next[onward] if each != nodes[-2]]
            if len(others) != 1:
                return None
            (onward,) = others
        if onward not in known or (start, nodes[1]) > (onward, nodes[-2]):
            return None
        senses = {self._sense(a, b) for a, b in pairwise(nodes)}
        levels = {int(self._layer[way]) for way in ways}
        is_level = all(levels <= self._levels(a, b) for a, b in (nodes[:2], nodes[:-3:-1])) and len(levels) == 1
        return _Link(tuple(nodes), length, senses.pop() if len(senses) == 1 else 0, is_ring, is_level)

    def _sense(self, a: int, b: int) -> int:
        """Return 1 where everybody drives from a node to the next one, -1 where back, 0 where in both directions."""
        way, sense = self._next[a][b]
        return int(self.ways.direction[way]) * sense

    def _levels(self, node: int, besides: int) -> set[int]:
        """Return the levels of the roads at a node but for that to a neighbour."""
        return {int(self._layer[way]) for to, (way, _) in self._next[node].items() if to != besides}

    def _ahead(self, a: int, b: int) -> FloatArray:
        step: FloatArray = self.xy[b] - self.xy[a]
        return step / max(float(np.hypot(*step)), 1e-9)

    def is_across(self, link: _Link) -> bool:
        """Tell whether a link leads from one carriageway of a road to the other one."""
        over, name, highway = self._ahead(*link.ends), self.ways.name, self.ways.highway
        level = self._layer[self._next[link.nodes[0]][link.nodes[1]][0]]

        def carriageways(node: int, before: int) -> list[tuple[FloatArray, int]]:
            beside = ((to, way, self._sense(node, to)) for to, (way, _) in self._next[node].items() if to != before)
            return [
                (self._ahead(node, to) * sense, way) for to, way, sense in beside if sense and self._layer[way] == level
            ]

        return link.length_m <= self.reach_m and any(
            float(one @ other) < -_ALONG
            and abs(float(one @ over)) < _ACROSS
            and highway[a] == highway[b]
            and (name[a] == name[b] or not (name[a] and name[b]))
            for one, a in carriageways(link.nodes[0], link.nodes[1])
            for other, b in carriageways(link.nodes[-1], link.nodes[-2])
        )

    def is_split(self, node: int) -> bool:
        """Tell whether the directions of a road part here, before an island: nothing meets it."""
        roads = [(self._sense(node, to), self._ahead(node, to)) for to in self._next[node]]
        parting = [ahead for sense, ahead in roads if sense]
        return sorted(sense for sense, _ in roads) == [-1, 0, 1] and float(parting[0] @ parting[1]) > 0.0

    def middle(self, nodes: list[int], links: list[_Link], radius_m: float) -> FloatArray:
        """Return longitude and latitude of the middle of a place, (2,): of its ring, else of its nodes."""
        from shapely import MultiLineString, MultiPoint  # noqa: PLC0415 - the server does without

        ring = [self.xy[list(link.nodes)] for link in links if link.is_ring]
        spots = self.xy[[node for node in nodes if not self.is_split(node)] or nodes]
        shape = MultiLineString(ring) if ring else MultiPoint(spots).buffer(radius_m)
        lonlat = lonlat_from_enu(self.origin[1], self.origin[0], np.array(shape.centroid.coords[0]))
        return np.round(lonlat, 7)  # as files have it


def _consolidate(graph: RoadGraph, roads: BoolArray, rows: IntArray, tolerance_m: float) -> IntersectionNodes:
    """Make one of the nodes, (N,) rows, of one place along the (W,) ways that are roads.

    One place is the ring of a roundabout, as its tag says, whatever its size; what a short road joins across both
    carriageways of one road; and what one-way roads around an island join: two opposite ones before which a road parts,
    or one that closes a triangle. Neighbours that a street joins are two places, however near, and so is what lies on
    different levels. The middle is that of the ring, else of the nodes but for those where a road parts. What only two
    roads leave is none.
    """
    single = IntersectionNodes("consolidated", graph.node_id[rows], graph.lonlat[rows], rows, tolerance_m)
    if len(rows) == 0:
        return single
    network = _Network(graph, roads, rows, 2.0 * tolerance_m)
    pairs = [link.ends for link in network.links if link.is_ring or network.is_across(link)]
    while more := list(_islands(network, place := _joined(rows, pairs))):
        pairs += more

    nodes_of: dict[int, list[int]] = {}
    inside: dict[int, list[_Link]] = {}
    for row, first in place.items():
        nodes_of.setdefault(first, []).append(row)
    for link in network.links:
        if place[link.ends[0]] == place[link.ends[1]]:
            inside.setdefault(place[link.ends[0]], []).append(link)
    lonlat = [
        graph.lonlat[first] if len(nodes) == 1 else network.middle(nodes, inside[first], tolerance_m)
        for first, nodes in nodes_of.items()
    ]
    leaving = [network.degree[nodes].sum() - 2 * len(inside.get(first, ())) for first, nodes in nodes_of.items()]
    members = [tuple(graph.node_id[nodes].tolist()) for nodes in nodes_of.values()]
    places = replace(
        single,
        osm_id=graph.node_id[list(nodes_of)],
        lonlat=np.array(lonlat),
        degree=np.array(leaving, dtype=np.int64),
        members=tuple(members),
    )
    return places.select(places.degree >= MIN_DEGREE)


def _joined(rows: IntArray, pairs: list[tuple[int, int]]) -> dict[int, int]:
    """Return the smallest row of those that pairs join to each, of all (N,) rows, ascending."""
    ends = np.searchsorted(rows, np.array(pairs, dtype=np.int64).reshape(-1, 2))
    groups = linked_groups(ends[:, 0], ends[:, 1], len(rows))
    _, first, group = np.unique(groups, return_index=True, return_inverse=True)
    return dict(zip(rows.tolist(), rows[first[group]].tolist(), strict=True))


def _islands(network: _Network, place: dict[int, int]) -> Iterator[tuple[int, int]]:
    """Yield pairs of intersections of two places between which there is an island."""
    between: dict[tuple[int, int], list[_Link]] = {}  # two places -> the links from the first to the second
    for link in network.links:
        one, other = (place[end] for end in link.ends)
        if one != other:
            turned = link._replace(nodes=link.nodes[::-1], direction=-link.direction)
            between.setdefault((one, other), []).append(link)
            between.setdefault((other, one), []).append(turned)
    rings = {place[link.nodes[0]] for link in network.links if link.is_ring}
    near: dict[int, set[int]] = {}
    for (one, other), links in between.items():
        reach_m = network.reach_m * (1.0 if rings.isdisjoint((one, other)) else _LONG)
        parting = {(link.nodes[0], link.direction) for link in links if link.length_m <= reach_m}
        yield from (
            (one, other) for node, way in parting if way == 1 and (node, -1) in parting and network.is_split(node)
        )
        if any(link.length_m <= network.reach_m for link in links):
            near.setdefault(one, set()).add(other)
    for (one, other), links in between.items():
        if any(link.direction and link.length_m <= network.reach_m for link in links):
            yield from (pair for third in near[one] & near[other] for pair in ((one, other), (one, third)))


# Slips of drawing that hide a junction in OpenStreetMap: nodes at one place, and ways that cross without a node.

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
    import shapely  # noqa: PLC0415 - the server does without

    rows = np.flatnonzero(ways[graph.edge_way] & near[graph.edges].any(axis=1))
    edges, way = graph.edges[rows], graph.edge_way[rows]
    layer = graph.ways.layer[way]
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
    is_bare = np.array([not {"bridge", "tunnel"} & each.keys() for each in graph.ways.tags])
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
    levels: dict[int, set[int]] = {}
    for (a, b), level in zip(edges.tolist(), layer.tolist(), strict=True):
        levels.setdefault(a, set()).add(level)
        levels.setdefault(b, set()).add(level)
    edges, nodes = distinct_edges(edges), np.unique(edges)
    near = nodes[tree_of(xy[nodes]).query_pairs(ONE_PLACE_M, output_type="ndarray")].reshape(-1, 2)
    joined = {tuple(pair) for pair in edges.tolist()}
    pairs = [pair for pair in near.tolist() if tuple(pair) not in joined and levels[pair[0]] & levels[pair[1]]]
    if not pairs:
        return [], frozenset()
    one, other = np.searchsorted(nodes, np.array(pairs)).T
    place = linked_groups(one, other, len(nodes))
    own = np.bincount(np.searchsorted(nodes, edges).ravel(), minlength=len(nodes))
    between = distinct_edges(place[np.searchsorted(nodes, edges)])
    together = np.bincount(between.ravel(), minlength=int(place.max()) + 1)
    found = []
    for each in np.unique(place[np.concatenate([one, other])]).tolist():
        members = np.flatnonzero(place == each)
        if together[each] >= MIN_DEGREE and together[each] > own[members].max():
            ids = " and ".join(str(node) for node in graph.node_id[nodes[members]].tolist())
            text = f"nodes {ids} lie at the same place and are not joined"
            found.append(Unjoined("not_joined", xy[nodes[members]].mean(axis=0), int(nodes[members[0]]), text))
    return found, frozenset(np.array(pairs).ravel().tolist())
