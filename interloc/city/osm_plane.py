"""The roads of OpenStreetMap in the plane of a map of many drives, and the questions that an audit asks them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.city.alignment import vote
from interloc.city.citymap import CityMap
from interloc.geometry import tree_of
from interloc.osm.graph import RoadGraph, Ways, distinct_edges, neighbours_of
from interloc.osm.intersections import MIN_DEGREE, road_ways

_ALIKE_M = 10.0  # place and node that are each other's nearest within this say how the two maps lie
_ENOUGH = 4
_BESIDE_M = (3.0, 25.0)  # two carriageways lie so far apart
_PIECE_M = 10.0
_OPPOSITE = -0.9  # cosine of the angle between their directions
_NOT_OPEN = ("private", "no", "customers", "delivery", "permit")
_MINOR = ("driveway", "parking_aisle", "drive-through", "emergency_access")


def joined(graphs: Sequence[RoadGraph]) -> tuple[RoadGraph, BoolArray]:
    """Return several maps as one, and which of its nodes any of them covers; what two have is as the last has it.

    A road of any of them is a road: what one extract lacks may lie beyond its edge, or be newer.
    """
    if len(graphs) == 1:
        return graphs[0], graphs[0].inside_bounds
    nodes, ways = (np.cumsum([0, *map(len, each)]) for each in zip(*((g.node_id, g.ways) for g in graphs), strict=True))
    node_id, row = np.unique(np.concatenate([g.node_id for g in graphs]), return_inverse=True)
    way_id, way = np.unique(np.concatenate([g.ways.id for g in graphs]), return_inverse=True)
    lonlat, is_covered, last = np.zeros((len(node_id), 2)), np.zeros(len(node_id), np.bool_), np.zeros_like(way_id)
    lonlat[row] = np.concatenate([g.lonlat for g in graphs])
    is_covered[row[np.concatenate([g.inside_bounds for g in graphs])]] = True
    last[way] = np.arange(len(way))

    def of_ways(name: str) -> list[Any]:
        values = [value for g in graphs for value in getattr(g.ways, name)]
        return [values[each] for each in last.tolist()]

    def rows(name: str) -> IntArray:
        """Return edges or loose ends with the rows of all maps; loose ends that another map goes on with are none."""
        found = []
        for g, node, first in zip(graphs, nodes[:-1], ways[:-1], strict=True):
            if name == "edges":
                found.append(np.column_stack([row[g.edges + node], way[g.edge_way + first]]))
            else:
                ends = g.loose_ends[~np.isin(g.loose_ends[:, 1], node_id)]
                found.append(np.column_stack([row[ends[:, 0] + node], ends[:, 1], way[ends[:, 2] + first]]))
        return np.unique(np.concatenate(found), axis=0)

    edges = rows("edges")
    one = replace(
        graphs[-1],
        node_id=node_id,
        lonlat=lonlat,
        edges=edges[:, :2],
        edge_way=edges[:, 2],
        ways=Ways(
            way_id,
            tuple(of_ways("highway")),
            tuple(of_ways("name")),
            np.array(of_ways("is_area"), dtype=np.bool_),
            np.array(of_ways("layer"), dtype=np.int64),
            tuple(of_ways("tags")),
        ),
        loose_ends=rows("loose_ends"),
    )
    return one, is_covered


@dataclass(frozen=True)
class OsmPlane:
    """A road graph in the plane of a map of many drives."""

    graph: RoadGraph
    is_covered: BoolArray
    """(N,) bool: its nodes where nothing is missing around them."""
    xy: FloatArray
    """(N, 2) float64: its nodes, metres."""
    offset_m: FloatArray
    """(2,) float64: what OpenStreetMap says minus what the map says, median of the junctions that both have; taken from
    `xy`."""

    @classmethod
    def of(cls, city: CityMap, *graphs: RoadGraph) -> "OsmPlane":
        """Lay road graphs over a map: a common offset of the two is no error of either place."""
        graph, is_covered = joined(graphs)
        whole = cls(graph, is_covered, city.plane(graph.lonlat), np.zeros(2))
        places, nodes = city.places.xy[city.places.is_shown], whole.xy[whole.junctions]
        if not len(places) or not len(nodes):
            return whole
        shift = vote(nodes, places, np.zeros(len(places), np.int64), 1, city.config)[0][0]
        nodes = nodes - shift
        distance, node = (np.atleast_1d(each) for each in tree_of(nodes).query(places))
        place = np.atleast_1d(tree_of(places).query(nodes)[1])
        rows = np.flatnonzero((distance < _ALIKE_M) & (place[node] == np.arange(len(places))))
        if len(rows) < _ENOUGH:
            return whole
        offset = shift + np.median(nodes[node[rows]] - places[rows], axis=0)
        return cls(graph, is_covered, whole.xy - offset, offset)

    @cached_property
    def highway(self) -> Any:  # noqa: ANN401 - an array of str
        """(W,) classes of the ways."""
        return np.array(self.graph.ways.highway, dtype=np.str_)

    def tagged(self, key: str, *values: str) -> BoolArray:
        """Return which ways have a tag, (W,), with one of some values or any but no."""
        found = (each.get(key, "") for each in self.graph.ways.tags)
        return np.array([value in values if values else value not in {"", "no"} for value in found], dtype=np.bool_)

    @cached_property
    def roads(self) -> BoolArray:
        """(W,) ways that are roads or service roads."""
        return road_ways(self.graph, "drive+service")

    @cached_property
    def open_roads(self) -> BoolArray:
        """(W,) roads that everybody may drive, that are no private drives or aisles."""
        closed = self.tagged("access", *_NOT_OPEN) | self.tagged("motor_vehicle", *_NOT_OPEN)
        return road_ways(self.graph, "drive") & ~closed & ~self.tagged("service", *_MINOR)

    @cached_property
    def odd(self) -> BoolArray:
        """(W,) links, roundabouts and roads with two carriageways: there one junction is several nodes."""
        twins: BoolArray = np.zeros(len(self.graph.ways), dtype=np.bool_)
        twins[self.graph.edge_way[self.carriageways]] = True
        return np.char.endswith(self.highway, "_link") | self.tagged("junction") | twins

    def is_odd(self, node: int) -> bool:
        """Tell whether a node lies on a link, a roundabout or one of two carriageways."""
        return any(self.odd[way] for way in self.ways_near(self.xy[node], 3.0))

    @cached_property
    def carriageways(self) -> BoolArray:
        """(E,) pieces of one-way roads beside which another one leads the other way, 3 to 25 m apart."""
        edges, sign = self.graph.edges, np.where(self.tagged("oneway", "-1"), -1.0, 1.0)[self.graph.edge_way]
        one_way = (self.tagged("oneway", "yes", "-1") & self.open_roads & ~self.tagged("junction"))[self.graph.edge_way]
        rows = np.flatnonzero(one_way)
        start, end = self.xy[edges[rows, 0]], self.xy[edges[rows, 1]]
        length = np.hypot(*(end - start).T)
        ahead = sign[rows, None] * (end - start) / np.maximum(length, 1e-9)[:, None]
        pieces = np.maximum(1, np.ceil(length / _PIECE_M).astype(np.int64))
        of = np.repeat(np.arange(len(rows)), pieces)
        share = (np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[of]
        at = start[of] + share[:, None] * (end - start)[of]
        found: BoolArray = np.zeros(len(edges), dtype=np.bool_)
        pairs = tree_of(at).query_pairs(_BESIDE_M[1], output_type="ndarray") if len(at) else np.zeros((0, 2), np.int64)
        a, b = of[pairs].T
        apart = at[pairs[:, 1]] - at[pairs[:, 0]]
        across = np.abs(apart[:, 0] * ahead[a, 1] - apart[:, 1] * ahead[a, 0])
        along = np.abs(np.sum(apart * ahead[a], axis=1))
        beside = (np.sum(ahead[a] * ahead[b], axis=1) < _OPPOSITE) & (across > _BESIDE_M[0]) & (along < _PIECE_M)
        found[rows[np.append(a[beside], b[beside])]] = True
        return found

    @cached_property
    def on_levels(self) -> BoolArray:
        """(W,) ways on bridges, in tunnels, or above or below others."""
        level: BoolArray = self.graph.ways.layer != 0
        return level | self.tagged("bridge") | self.tagged("tunnel") | self.tagged("covered")

    @cached_property
    def junctions(self) -> IntArray:
        """Rows of the nodes where three roads or more meet, service roads included."""
        return np.flatnonzero(self.graph.degree(self.roads) >= MIN_DEGREE)

    @cached_property
    def open_junctions(self) -> IntArray:
        """Rows of the nodes where three open roads or more meet, which the map covers."""
        return np.flatnonzero((self.graph.degree(self.open_roads) >= MIN_DEGREE) & self.is_covered)

    def distance(self, xy: FloatArray, ways: BoolArray | None = None) -> FloatArray:
        """Return the distance of (N, 2) positions from the nearest way under a mask, (N,) metres; infinite without."""
        import shapely  # noqa: PLC0415 - slow to import

        edges = self.graph.edges if ways is None else self.graph.edges_of(ways)
        found = np.full(len(xy), np.inf)
        if len(edges) and len(xy):
            lines: Any = shapely.linestrings(self.xy[edges])
            tree = shapely.STRtree(lines)
            (point, _), metres = tree.query_nearest(shapely.points(xy), return_distance=True, all_matches=False)
            found[point] = metres
        return found

    def ways_near(self, xy: FloatArray, reach_m: float) -> list[int]:
        """Return the rows of the ways within a distance of one position, (2,), nearest first."""
        ends = self.xy[self.graph.edges]
        near = np.flatnonzero((np.abs(ends - xy) <= reach_m + 500.0).all(axis=(1, 2)))
        a, b = ends[near, 0], ends[near, 1]
        along = b - a
        share = np.clip(np.sum((xy - a) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-9), 0.0, 1.0)
        metres = np.hypot(*(a + share[:, None] * along - xy).T)
        order = np.argsort(metres, kind="stable")
        return list(dict.fromkeys(self.graph.edge_way[near[order[metres[order] <= reach_m]]].tolist()))

    @cached_property
    def neighbours(self) -> dict[int, list[int]]:
        """Rows of the nodes that are next along an open road, of each node of one."""
        return neighbours_of(distinct_edges(self.graph.edges_of(self.open_roads)))

    def along(self, node: int, neighbour: int, length_m: float) -> tuple[list[int], FloatArray]:
        """Follow an open road from a node to the next junction, or so far; return its nodes and the way to each."""
        nodes, metres = [node, neighbour], [0.0, float(np.hypot(*(self.xy[node] - self.xy[neighbour])))]
        while metres[-1] < length_m:
            onward = [each for each in self.neighbours[nodes[-1]] if each != nodes[-2]]
            if len(onward) != 1:
                break
            metres.append(metres[-1] + float(np.hypot(*(self.xy[nodes[-1]] - self.xy[onward[0]]))))
            nodes.append(onward[0])
        return nodes, np.array(metres)

    def road_from(self, node: int, neighbour: int, length_m: float, step_m: float = 1.0) -> FloatArray:
        """Return positions every metre along an open road that leaves a node, (n, 2), as far as the next junction."""
        nodes, travelled = self.along(node, neighbour, length_m)
        at = np.arange(0.0, min(length_m, travelled[-1]), step_m)
        return np.stack([np.interp(at, travelled, self.xy[nodes, axis]) for axis in (0, 1)], axis=-1)

    def roads_from(self, node: int, length_m: float) -> list[FloatArray]:
        """Return `road_from` of all open roads that leave a node."""
        return [self.road_from(node, each, length_m) for each in self.neighbours.get(node, [])]
