"""The fused map against the OSM nodes, one-to-one, and what these are off themselves."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.evaluation.metrics import UNMATCHED, pairs_in_square, pairs_within
from interloc.geometry import enu_from_lonlat
from interloc.results import IntersectionTable, KeyframeTable

GATE_M = 10.0


@dataclass(frozen=True)
class MapLevel:
    """The M fused intersections assigned to the N nodes.

    All take part in the assignment, so an intersection at the rim of what was driven may claim a node just beyond it.
    Precision counts the intersections within the union of the relevant zones, recall the nodes within it.
    """

    node: IntArray
    """(M,) int64: row of the node assigned to each intersection, -1 for none."""
    error_m: FloatArray
    """(M,) float64: distance to it, infinite for none."""
    counts: BoolArray
    """(M,) bool: intersections in the relevant zone of some keyframe: those that precision is about."""
    node_in_zone: BoolArray
    node_found: BoolArray
    """(N,) bool: nodes in the relevant zone of some keyframe; nodes with an intersection assigned."""
    gate_m: float
    """Largest distance of an assigned pair."""

    @property
    def right(self) -> BoolArray:
        """(M,) bool: intersections that count and are nodes."""
        right: BoolArray = self.counts & (self.node != UNMATCHED)
        return right

    @property
    def wrong(self) -> BoolArray:
        """(M,) bool: intersections that count and are none."""
        wrong: BoolArray = self.counts & (self.node == UNMATCHED)
        return wrong

    @property
    def missed(self) -> BoolArray:
        """(N,) bool: nodes in the zones without an intersection."""
        return self.node_in_zone & ~self.node_found

    @property
    def precision(self) -> float | None:
        """Share of the intersections in the zones that are OSM nodes."""
        total = int(self.counts.sum())
        return int(self.right.sum()) / total if total else None

    @property
    def recall(self) -> float | None:
        """Share of the nodes in the zones that have an intersection."""
        total = int(self.node_in_zone.sum())
        return int(self.node_found[self.node_in_zone].sum()) / total if total else None

    @property
    def errors_m(self) -> FloatArray:
        """Distances of all assigned pairs, metres."""
        errors: FloatArray = self.error_m[self.node != UNMATCHED]
        return errors


def assign_intersections(
    keyframes: KeyframeTable,
    intersections: IntersectionTable,
    node_lonlat: FloatArray,
    node_in_zone: BoolArray,
    *,
    relevant_zone_m: float,
) -> MapLevel:
    """Assign fused intersections to nodes, one-to-one, with the smallest sum of distances, each cut off at the gate."""
    assert intersections.lonlat is not None
    node = np.full(len(intersections), UNMATCHED, dtype=np.int64)
    error = np.full(len(intersections), np.inf)
    rows, columns, distance = assign_one_to_one(intersections.lonlat, node_lonlat, GATE_M)
    node[rows], error[rows] = columns, distance
    counts = np.zeros(len(intersections), dtype=np.bool_)
    counts[pairs_in_square(keyframes, intersections.lonlat, relevant_zone_m)[1]] = True
    found = np.zeros(len(node_lonlat), dtype=np.bool_)
    found[columns] = True
    return MapLevel(node, error, counts, node_in_zone, found, GATE_M)


def assign_one_to_one(
    a_lonlat: FloatArray, b_lonlat: FloatArray, gate_m: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Assign points to others, one-to-one, with the smallest sum of distances, each cut off at the gate.

    Points are (A, 2) and (B, 2) degrees, the gate metres. Returns the rows of the P pairs in both, and their distances
    in metres. Solved within each group of points that the gate connects: the groups are small.
    """
    empty = np.empty(0, dtype=np.int64)
    a, b, distance = _pairs_under(a_lonlat, b_lonlat, gate_m)
    if len(a) == 0:
        return empty, empty, np.empty(0)
    size = len(a_lonlat) + len(b_lonlat)
    links = coo_array((np.ones(len(a)), (a, len(a_lonlat) + b)), shape=(size, size))
    _, group = connected_components(links, directed=False)
    found_a, found_b, found_distance = [], [], []
    group_of_pair = group[a]
    for each in np.unique(group_of_pair):
        pairs = np.flatnonzero(group_of_pair == each)
        rows, row = np.unique(a[pairs], return_inverse=True)
        columns, column = np.unique(b[pairs], return_inverse=True)
        cost = np.full((len(rows), len(columns)), gate_m)
        cost[row, column] = distance[pairs]
        i, j = linear_sum_assignment(cost)
        real = cost[i, j] < gate_m
        found_a.append(rows[i[real]])
        found_b.append(columns[j[real]])
        found_distance.append(cost[i[real], j[real]])
    return np.concatenate(found_a), np.concatenate(found_b), np.concatenate(found_distance)


def _pairs_under(a_lonlat: FloatArray, b_lonlat: FloatArray, gate_m: float) -> tuple[IntArray, IntArray, FloatArray]:
    a, b = pairs_within(a_lonlat, b_lonlat, gate_m)
    offset = enu_from_lonlat(a_lonlat[a, 1], a_lonlat[a, 0], b_lonlat[b])
    distance = np.hypot(offset[:, 0], offset[:, 1])
    near = distance < gate_m
    return a[near], b[near], distance[near]
