"""The map around a drive, prepared for the questions of the rules that tell why something is wrong or was missed."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations
from typing import Any

import numpy as np
import shapely

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, middle_of, nearest_of
from interloc.mapping.mosaic import Mosaic
from interloc.osm.graph import RoadGraph, distinct_edges, neighbours_of
from interloc.osm.intersections import DRIVABLE, MIN_DEGREE, IntersectionNodes, Unjoined, road_ways, unjoined

ROAD_M = 10.0  # so near the line of a road lies on it
ARM_M = 20.0  # length of road on both sides of a place by which its turn is measured
BRANCH_M = 15.0  # a branch needs so much road: it is fitted beyond one road width, on at least another half
SEEN_FROM_M, SEEN_SHARE = 6.0, 0.6
"""A branch was seen if so much of it was, between so far from its node and `BRANCH_M`; nearer it is the road driven."""

TWICE_M = 1.0
"""A node so near the line to another neighbour lies on it: mappers place the middle of a road to about a metre."""

LEVEL_M = 30.0  # the road driven below or above a node is that of the keyframes so near it
_AROUND_M = 300.0

_VEHICLE = DRIVABLE | {
    *("service", "track", "pedestrian", "busway", "bus_guideway", "raceway", "escape", "rest_area", "services"),
    *("construction", "emergency_bay"),
}
"""Values of `highway` as wide as a vehicle; what is left are paths."""


@dataclass(frozen=True)
class Points:
    """Places of a map in the plane, each with what it is."""

    xy: FloatArray
    """(N, 2) float64."""
    row: IntArray
    """(N,) int64: row of what it is: a node of the policy, or a way."""

    def nearest(self, xy: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the distance of (Q, 2) places to the nearest of these (infinite without any) and its row, -1."""
        distance, index = nearest_of(xy, self.xy)
        return distance, np.append(self.row, -1)[index]


class MapEvidence:
    """The map around a drive, (K, 2) degrees, in a plane, prepared for the questions of the rules.

    `graph` is the whole map, with the ways that the policy leaves out; `nodes` are those of it that count.
    """

    def __init__(self, graph: RoadGraph, nodes: IntersectionNodes, lonlat: FloatArray) -> None:
        self.graph = graph
        self.nodes = nodes
        self._origin = middle_of(lonlat) if len(lonlat) else graph.lonlat[0]
        self.node_xy = self.plane(nodes.lonlat)
        self._xy = self.plane(graph.lonlat)
        self._driven_xy = self.plane(lonlat)
        self._near = _around(self._xy, self._driven_xy)
        self._is_road = road_ways(graph, nodes.policy)
        members = [np.searchsorted(graph.node_id, nodes.members_of(row)) for row in range(len(nodes))]
        self._members = [each.tolist() for each in members]
        self.counted = Points(self.node_xy, np.arange(len(nodes)))
        """The nodes that count."""
        self.parts = Points(
            self._xy[np.concatenate([*members, np.empty(0, dtype=np.int64)])],
            np.repeat(np.arange(len(nodes)), [len(each) for each in members]),
        )
        """The nodes that were merged to those that count; row: of the merged one."""

    def plane(self, lonlat: FloatArray) -> FloatArray:
        """Return metres east and north of the middle of the drive of (N, 2) degrees."""
        return enu_from_lonlat(self._origin[1], self._origin[0], lonlat)

    def parts_m(self, node: int, xy: FloatArray) -> FloatArray:
        """Return the distance of (Q, 2) places from a node that counts, or the nearest of those that were merged."""
        metres: FloatArray = np.hypot(*(xy[:, None] - self._xy[self._members[node]]).T).min(axis=0)
        return metres

    @cached_property
    def radius_m(self) -> FloatArray:
        """(N,) float64: how far the nodes of each that counts lie from its middle; 0 where it is one node."""
        return np.array(
            [np.hypot(*(self._xy[at] - xy).T).max() for at, xy in zip(self._members, self.node_xy, strict=True)]
        )

    def off_what(self, node: int) -> str:
        """Return what a place is off where several nodes are one: " the middle of ..."; else nothing."""
        return f" {self.name_of(node)}" if len(self._members[node]) > 1 else ""

    def name_of(self, node: int) -> str:
        """Return what a node that counts is called: "node 7", or "the middle of nodes 7, 8 and 9 (one place)"."""
        *others, last = (str(each) for each in self.nodes.members_of(node))
        return f"the middle of nodes {', '.join(others)} and {last} (one place)" if others else f"node {last}"

    @cached_property
    def unjoined(self) -> tuple[Points, list[Unjoined]]:
        """Junctions that a slip of the map hides; row: which."""
        found = unjoined(self.graph, self._xy, road_ways(self.graph, "drive+service"), self._near)
        return Points(np.array([each.xy for each in found]).reshape(-1, 2), np.arange(len(found))), found

    def streets(self, xy: FloatArray, reach_m: FloatArray) -> list[str | None]:
        """Return the names of the roads within (Q,) distances of (Q, 2) places, as "A / B"; None: no name is there."""
        names = self.graph.ways.name
        edges, ways = self.graph.edges, self.graph.edge_way
        is_named = np.array([bool(name) for name in names], dtype=np.bool_)
        rows = np.flatnonzero((is_named & self._is_vehicle)[ways] & self._near[edges].any(axis=1))
        found: list[set[str]] = [set() for _ in range(len(xy))]
        if len(rows) and len(xy):
            lines: Any = shapely.linestrings(self._xy[edges[rows]])
            place, line = shapely.STRtree(lines).query(shapely.points(xy), "dwithin", distance=reach_m)
            for at, way in zip(place.tolist(), ways[rows[line]].tolist(), strict=True):
                found[at].add(str(names[way]))
        return [" / ".join(sorted(each, key=str.casefold)) or None for each in found]

    @cached_property
    def left_out(self) -> Points:
        """Junctions of vehicle-wide ways that are none without those that the policy leaves out; row: such a way."""
        return self._junctions(self._is_road, self._is_vehicle)

    @cached_property
    def paths(self) -> Points:
        """Nodes where a path meets a road; row: the path."""
        return self._junctions(self._is_vehicle, self._is_vehicle | ~self.graph.ways.is_area, minimum=1)

    @cached_property
    def mouths(self) -> Points:
        """Nodes where a slip road meets another road; row: the slip road."""
        link = self._is_road & self._is_link
        at_link, way = self._touched(link)
        at_other, _ = self._touched(self._is_road & ~link)
        rows = np.flatnonzero(at_link & at_other & self._near)
        return Points(self._xy[rows], way[rows])

    @cached_property
    def _is_vehicle(self) -> BoolArray:
        wide = np.array([highway in _VEHICLE for highway in self.graph.ways.highway], dtype=np.bool_)
        return self._is_road | (wide & ~self.graph.ways.is_area)

    @cached_property
    def _is_link(self) -> BoolArray:
        return np.array([highway.endswith("_link") for highway in self.graph.ways.highway], dtype=np.bool_)

    def _junctions(self, fewer: BoolArray, more: BoolArray, *, minimum: int = 0) -> Points:
        """Return the nodes that are junctions of the (W,) ways `more`, not of `fewer`, which `minimum` edges touch."""
        degree = self.graph.degree(fewer)
        all_degree = self.graph.degree(more)
        touched, way = self._touched(more & ~fewer)
        is_new = (all_degree >= MIN_DEGREE) & (degree < MIN_DEGREE) & (degree >= minimum)
        rows = np.flatnonzero(is_new & touched & self._near)
        return Points(self._xy[rows], way[rows])

    def _touched(self, ways: BoolArray) -> tuple[BoolArray, IntArray]:
        """Return the nodes that edges of (W,) ways touch, (N,), and a way that does for each, -1 for none."""
        way = np.full(len(self.graph.node_id), -1, dtype=np.int64)
        edges = np.flatnonzero(ways[self.graph.edge_way])
        way[self.graph.edges[edges].ravel()] = np.repeat(self.graph.edge_way[edges], 2)
        return way >= 0, way

    @cached_property
    def links(self) -> "_Network":
        """Slip roads."""
        return _Network(self._xy, self.graph.edges_of(self._is_road & self._is_link), self._near)

    @cached_property
    def _roads(self) -> "_Network":
        return _Network(self._xy, self.graph.edges_of(self._is_road), self._near)

    @cached_property
    def _driven(self) -> "_Network":
        return _Network(self._xy, self.graph.edges_of(self._is_vehicle), self._near)

    def bend_deg(self, xy: FloatArray) -> float:
        """Return by how much the road at a place (2,) turns over 20 m before and after it; 0 where there is no road."""
        roads = self._driven
        (distance,), (line,) = roads.nearest(xy[None])
        if not distance <= ROAD_M:
            return 0.0
        a, b = roads.edges[line].tolist()
        foot = _foot(self._xy[a], self._xy[b], xy)
        back, walked_back = roads.walk(foot, b, a, ARM_M)
        ahead, walked_ahead = roads.walk(foot, a, b, ARM_M)
        if min(walked_back, walked_ahead) < ARM_M / 4.0:
            return 0.0
        coming, going = foot - back, ahead - foot
        return _angle_deg(_unit(coming), _unit(going))

    def fork_deg(self, node: int, xy: FloatArray) -> float:
        """Return the angle of the roads between which a place lies, seen from a node; 180 where it lies in no fork.

        It lies in one where the line from the node to it deviates from the bisector of two roads by no more than their
        angle.
        """
        row = min(self._members[node], key=lambda each: float(np.hypot(*(self._xy[each] - xy))))
        roads = self._roads
        ends = [roads.walk(self._xy[row], row, each, ARM_M)[0] for each in roads.neighbours.get(row, [])]
        directions = [_unit(end - self._xy[row]) for end in ends]
        place = _unit(xy - self._xy[row])
        smallest = 180.0
        for a, b in combinations(directions, 2):
            angle = _angle_deg(a, b)
            if _angle_deg(_unit(a + b), place) <= angle:
                smallest = min(smallest, angle)
        return smallest

    def _row_of(self, node: int) -> int:
        """Return the row in the graph of a node that counts; of a merged one, of its smallest node."""
        return int(self._members[node][0])

    @cached_property
    def road_ends(self) -> Points:
        """Ends of roads; row: of the node in the graph."""
        ends = [node for node, others in self._driven.neighbours.items() if len(others) == 1]
        rows = np.array(ends, dtype=np.int64)
        return Points(self._xy[rows], rows)

    @cached_property
    def _layers(self) -> dict[tuple[int, int], set[int]]:
        """Two neighbours along roads near the drive, the smaller row first -> levels of the roads between them."""
        graph, found = self.graph, dict[tuple[int, int], set[int]]()
        near = np.flatnonzero(self._is_vehicle[graph.edge_way] & self._near[graph.edges].any(axis=1))
        pairs, layers = np.sort(graph.edges[near], axis=1).tolist(), graph.ways.layer[graph.edge_way[near]].tolist()
        for (a, b), level in zip(pairs, layers, strict=True):
            found.setdefault((a, b), set()).add(level)
        return found

    @cached_property
    def _is_level(self) -> bool:
        return all(levels == {0} for levels in self._layers.values())

    def _layers_between(self, row: int, others: Iterable[int]) -> list[set[int]]:
        return [self._layers.get((min(row, each), max(row, each)), {0}) for each in others]

    def levels(self, node: int, driven_xy: FloatArray) -> str | None:
        """Say what is odd about the levels of the roads at a node that was driven past; None: they are on one."""
        if self._is_level:
            return None
        row = self._row_of(node)
        counts = Counter(chain.from_iterable(self._layers_between(row, self._roads.neighbours.get(row, []))))
        if len(counts) > 1 and min(counts.values()) >= 2:
            layers = " and ".join(str(level) for level in sorted(counts))
            return f"roads on layers {layers} share this node and pass each other: nobody can turn here"
        _, lines = self._driven.nearest(driven_xy)
        pairs = self._driven.edges[lines[lines >= 0]].tolist()
        below = Counter(chain.from_iterable(levels for a, b in pairs for levels in self._layers_between(a, [b])))
        if len(counts) == 1 and below and not counts.keys() & {(driven := below.most_common(1)[0][0])}:
            (level,) = counts
            side = "above" if level > driven else "below"
            return f"its roads lie on layer {level}, the road driven on layer {driven}: it passes {side}"
        return None

    def oddity(self, node: int) -> str | None:
        """Say what is odd about a node on the map, whether it was found or not: its levels, a road drawn twice."""
        near = np.hypot(*(self._driven_xy - self.node_xy[node]).T) <= LEVEL_M
        return self.levels(node, self._driven_xy[near]) or self.drawn_twice(node)

    def branches_seen(self, node: int, mosaic: Mosaic) -> str | None:
        """Say which of the branches of a node (row of the nodes that count) a drive saw; None: the node is merged."""
        if len(self._members[node]) > 1:
            return None
        row, roads = self._row_of(node), self._roads
        along = np.arange(SEEN_FROM_M, BRANCH_M, 1.0)
        counts: Counter[str] = Counter()
        for other in roads.neighbours.get(row, []):
            xy = np.array([roads.walk(self._xy[row], row, other, each)[0] for each in along])
            road, ground = mosaic.seen_at(lonlat_from_enu(self._origin[1], self._origin[0], xy))
            is_ground = (road | ground).mean() >= SEEN_SHARE
            counts["road" if road.mean() >= SEEN_SHARE else "other ground" if is_ground else "nothing"] += 1
        total = sum(counts.values())
        parts = [f"{counts[kind]} as {kind}" for kind in ("road", "other ground") if counts[kind]]
        parts += [f"{counts['nothing']} not"] if counts["nothing"] else []
        return f"of its {total} branches the LiDAR saw {', '.join(parts)}" if total else None

    def drawn_twice(self, node: int) -> str | None:
        """Say which two roads that leave a node (row of the nodes that count) run on one line; None: none do."""
        row = self._row_of(node)
        here = self._xy[row]
        for a, b in combinations(self._roads.neighbours.get(row, []), 2):
            near, far = sorted((a, b), key=lambda each: float(np.hypot(*(self._xy[each] - here))))
            off_m = float(np.hypot(*(_foot(here, self._xy[far], self._xy[near]) - self._xy[near])))
            if off_m <= TWICE_M:
                ids = self.graph.node_id[[near, far]].tolist()
                return f"two of its roads, to nodes {ids[0]} and {ids[1]}, run {off_m:.1f} m apart: drawn twice?"
        return None

    def branch_lengths_m(self, node: int) -> list[float] | None:
        """Return how long the roads are that leave a node (row of the nodes that count), up to the next junction.

        None: the node is a merged one. No road is followed further than `BRANCH_M`.
        """
        if len(self._members[node]) > 1:
            return None
        row = self._row_of(node)
        roads = self._roads
        lengths = [roads.walk(self._xy[row], row, each, BRANCH_M)[1] for each in roads.neighbours.get(row, [])]
        loose = self.graph.loose_ends
        return lengths + [BRANCH_M] * int((self._is_road[loose[:, 2]] & (loose[:, 0] == row)).sum())


class _Network:
    """The (E, 2) edges of a graph that have a node `near`, as lines in the plane to be near to and to walk along."""

    def __init__(self, xy: FloatArray, edges: IntArray, near: BoolArray) -> None:
        edges = distinct_edges(edges)
        self.edges: IntArray = edges[near[edges].any(axis=1)]
        self._xy = xy

    @cached_property
    def neighbours(self) -> dict[int, list[int]]:
        """Row of a node -> rows of those that an edge joins to it."""
        return neighbours_of(self.edges)

    @cached_property
    def _tree(self) -> Any:  # noqa: ANN401 - shapely has no types
        lines: Any = shapely.linestrings(self._xy[self.edges])
        return shapely.STRtree(lines)

    def nearest(self, xy: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the distance of (Q, 2) places to the nearest edge, and its row; infinite and -1 without any."""
        distance, line = np.full(len(xy), np.inf), np.full(len(xy), -1, dtype=np.int64)
        if len(self.edges) and len(xy):
            points = shapely.points(xy)
            (place, row), found = self._tree.query_nearest(points, return_distance=True, all_matches=False)
            distance[place], line[place] = found, row
        return distance, line

    def walk(self, start: FloatArray, before: int, node: int, length_m: float) -> tuple[FloatArray, float]:
        """Follow a road from a place on the edge `before` - `node` to its next junction or end, or for a length.

        Returns where the walk ended, and how long it was.
        """
        place, walked = start, 0.0
        passed: dict[int, float] = {}
        while True:
            step = self._xy[node] - place
            reach = float(np.hypot(*step))
            if walked + reach >= length_m:
                return place + step * ((length_m - walked) / max(reach, 1e-9)), length_m
            place, walked = self._xy[node], walked + reach
            others = [each for each in self.neighbours[node] if each != before]
            if len(others) != 1 or passed.get(node) == walked:  # or a ring without length
                return place, walked
            passed[node] = walked
            before, node = node, others[0]


def _around(xy: FloatArray, track_xy: FloatArray) -> BoolArray:
    """Return which (N, 2) places lie in the box around a track and its regions of interest."""
    if len(track_xy) == 0:
        return np.zeros(len(xy), dtype=np.bool_)
    low, high = track_xy.min(axis=0) - _AROUND_M, track_xy.max(axis=0) + _AROUND_M
    inside: BoolArray = ((xy >= low) & (xy <= high)).all(axis=1)
    return inside


def _unit(xy: FloatArray) -> FloatArray:
    """Return a vector (2,) at a length of 1."""
    return xy / max(float(np.hypot(*xy)), 1e-9)


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    """Return the angle between two vectors of length 1, (2,) each, 0 to 180 degrees."""
    return float(np.degrees(np.arccos(np.clip(float(a @ b), -1.0, 1.0))))


def _foot(a: FloatArray, b: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the place on the line from a to b that is nearest to a third, (2,) each."""
    along = b - a
    share = float((xy - a) @ along) / max(float(along @ along), 1e-12)
    return a + along * min(max(share, 0.0), 1.0)
