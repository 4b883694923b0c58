"""The skeleton of the road as a graph: nodes where its lines meet or end, edges along its cells."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.geometry import travelled
from interloc.roadmap.surface import Ground

_SIDES = ((-1, 0), (0, 1), (1, 0), (0, -1))
_DIAGONALS = ((-1, 1), (1, 1), (1, -1), (-1, -1))  # each between a side and the next
_BACK, _BACK_SHARE = 40, 0.5  # cells within which a line may lead back to a node, and how much nearer to it


@dataclass
class Edge:
    """A line between two nodes."""

    start: int
    end: int
    """Nodes."""
    xy: FloatArray
    """(N, 2) float64: metres of the mosaic, from node to node."""
    half_m: FloatArray
    """(N,) float64: distance from the line to the edge of the road."""
    is_seen: BoolArray
    """(N,) bool: false where a gap was bridged."""

    @property
    def length_m(self) -> float:
        """Length of the line."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())

    def turned(self) -> "Edge":
        """Return it in the other direction."""
        return Edge(self.end, self.start, self.xy[::-1], self.half_m[::-1], self.is_seen[::-1])

    def from_node(self, node: int) -> "Edge":
        """Return it so that it starts at one of its nodes."""
        return self if self.start == node else self.turned()

    def then(self, other: "Edge") -> "Edge":
        """Return it with another edge that starts where it ends."""
        meeting = self.is_seen[-1:] & other.is_seen[:1]
        return Edge(
            self.start,
            other.end,
            np.concatenate([self.xy, other.xy[1:]]),
            np.concatenate([self.half_m, other.half_m[1:]]),
            np.concatenate([self.is_seen[:-1], meeting, other.is_seen[1:]]),
        )

    def beginning_at(self, node: int, xy: FloatArray) -> "Edge":
        """Return it with another node as its start, and a straight line from there: no detour that leads back to it."""
        away = np.linalg.norm(self.xy[:_BACK] - xy, axis=1)
        at = int(away.argmin()) if away.min() < _BACK_SHARE * away[0] else 0
        half_m, is_seen = (np.concatenate([each[at : at + 1], each[at:]]) for each in (self.half_m, self.is_seen))
        return Edge(node, self.end, np.vstack([xy, self.xy[at:]]), half_m, is_seen)

    def other(self, node: int) -> int:
        """Return the node at the other end."""
        return self.end if self.start == node else self.start


@dataclass
class Node:
    """Where lines meet or end."""

    xy: FloatArray
    """(2,) float64."""
    half_m: float
    """Distance to the edge of the road."""
    intersections: list[int] = field(default_factory=list)
    """Rows of the fused intersections that it is."""
    place: int | None = None
    """Number of the open place that it is."""

    @property
    def is_free(self) -> bool:
        """True where only the skeleton says that there is a node."""
        return not self.intersections and self.place is None


class Graph:
    """Nodes and edges by number; several edges may join the same two nodes, or one with itself."""

    def __init__(self) -> None:
        self.nodes: dict[int, Node] = {}
        self.edges: dict[int, Edge] = {}
        self._ends: dict[int, list[int]] = {}
        self._number = count()

    def add_node(self, node: Node) -> int:
        """Add a node; return its number."""
        number = next(self._number)
        self.nodes[number] = node
        self._ends[number] = []
        return number

    def add_edge(self, edge: Edge) -> None:
        """Add an edge."""
        number = next(self._number)
        self.edges[number] = edge
        self._ends[edge.start].append(number)
        self._ends[edge.end].append(number)

    def remove_edge(self, number: int) -> None:
        """Remove an edge; its nodes stay."""
        edge = self.edges.pop(number)
        self._ends[edge.start].remove(number)
        self._ends[edge.end].remove(number)

    def arms(self, node: int) -> list[tuple[int, Edge]]:
        """Return number and edge, turned to start here, of each end at a node; a loop comes twice."""
        arms = []
        for number in dict.fromkeys(self._ends[node]):
            edge = self.edges[number]
            arms.append((number, edge.from_node(node)))
            if edge.start == edge.end:
                arms.append((number, edge.turned()))
        return arms

    def degree(self, node: int) -> int:
        """Return how many ends of edges there are at a node."""
        return len(self._ends[node])

    def drop_lonely(self) -> None:
        """Remove nodes without edges that are no intersection and no place."""
        for number in [n for n, node in self.nodes.items() if not self._ends[n] and node.is_free]:
            del self.nodes[number], self._ends[number]

    def merge(self, node: int, into: int) -> None:
        """Let the edges of a node end at another one."""
        xy = self.nodes[into].xy
        for number in list(dict.fromkeys(self._ends[node])):
            edge = self.edges[number]
            self.remove_edge(number)
            if edge.start == node:
                edge = edge.beginning_at(into, xy)
            if edge.end == node:
                edge = edge.turned().beginning_at(into, xy)
            self.add_edge(edge)
        self.nodes[into].intersections += self.nodes[node].intersections
        del self.nodes[node], self._ends[node]

    def smooth_all(self) -> None:
        """Join the two edges of each free node that has two."""
        for node in [number for number, each in self.nodes.items() if each.is_free]:
            ends = self._ends[node]
            if len(ends) == 2 and ends[0] != ends[1]:
                first, second = (self.edges[number].from_node(node) for number in ends)
                for number in list(ends):
                    self.remove_edge(number)
                self.add_edge(first.turned().then(second))
                del self.nodes[node], self._ends[node]

    def split(self, number: int, row: int, node: Node) -> None:
        """Cut an edge at one of its positions, where a node comes."""
        edge = self.edges[number]
        self.remove_edge(number)
        new = self.add_node(node)
        for part, start, end in ((slice(0, row + 1), edge.start, new), (slice(row, None), new, edge.end)):
            xy = edge.xy[part].copy()
            xy[-1 if end == new else 0] = node.xy
            self.add_edge(Edge(start, end, xy, edge.half_m[part], edge.is_seen[part]))


def trace(ground: Ground) -> Graph:
    """Make a graph of the cells of a skeleton.

    Two cells are joined side by side, or diagonally where no third one joins them (`interloc.kernels.skeleton`). Cells
    with two neighbours are parts of lines, all others are nodes; of a ring without a node any cell becomes one.
    """
    neighbours = _neighbours(ground.rows, ground.cols)
    xy, graph = ground.xy, Graph()
    node_at = {i: graph.add_node(Node(xy[i], float(ground.half_m[i]))) for i, n in enumerate(neighbours) if len(n) != 2}
    seen: set[int] = set()

    def follow(start: int, onward: int) -> None:
        path, before, here = [start], start, onward
        while here not in node_at:
            path.append(here)
            seen.add(here)
            one, two = neighbours[here]
            before, here = here, two if one == before else one
        rows = np.array([*path, here])
        edge = Edge(node_at[start], node_at[here], xy[rows], ground.half_m[rows], np.ones(len(rows), np.bool_))
        graph.add_edge(edge)

    for start in list(node_at):
        for onward in neighbours[start]:
            if (onward in node_at and start < onward) or (onward not in node_at and onward not in seen):
                follow(start, onward)
    for start, joined in enumerate(neighbours):
        if start not in seen and start not in node_at:
            node_at[start] = graph.add_node(Node(xy[start], float(ground.half_m[start])))
            follow(start, joined[0])
    graph.drop_lonely()
    return graph


def _neighbours(rows: IntArray, cols: IntArray) -> list[list[int]]:
    """Return the joined cells of each cell, as positions."""
    if not len(rows):
        return []
    stride = int(np.ptp(cols)) + 3
    key = (rows - rows.min() + 1) * stride + cols - cols.min() + 1

    def at(step: tuple[int, int]) -> IntArray:
        wanted = key + step[0] * stride + step[1]
        place = np.minimum(np.searchsorted(key, wanted), len(key) - 1)
        return np.where(key[place] == wanted, place, -1)

    sides = [at(step) for step in _SIDES]
    found = list(sides)
    for k, step in enumerate(_DIAGONALS):
        is_joined = (sides[k] >= 0) | (sides[(k + 1) % 4] >= 0)
        found.append(np.where(is_joined, -1, at(step)))
    table = np.stack(found, axis=-1)
    return [[q for q in row if q >= 0] for row in table.tolist()]


def directions(arms: Iterable[tuple[int, Edge]], near_m: float, far_m: float) -> Iterator[FloatArray]:
    """Yield the unit direction in which each arm leaves, between two distances along it."""
    for _, edge in arms:
        along = travelled(edge.xy)
        reach = min(far_m, along[-1])
        first, last = np.searchsorted(along, [min(near_m, reach / 2), reach])
        step = edge.xy[min(last, len(edge.xy) - 1)] - edge.xy[min(first, len(edge.xy) - 2)]
        yield step / max(float(np.linalg.norm(step)), 1e-9)
