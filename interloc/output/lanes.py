"""Lanes on the roads of a map, for vehicles and simulators: how many there are is assumed from the width.

A road of less than 4.5 m is one lane for both directions, any other two, and traffic keeps to the right. Roads end
before their junctions, across which curves lead from each lane to those of the other roads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from shapely.ops import substring

from interloc.arrays import FloatArray
from interloc.roadmap.network import RoadEdge, RoadNetwork

TWO_LANES_M = 4.5
"""Width from which a road has a lane for each direction."""

ASSUMED = "assumed"
"""Mark of lanes in exports."""

_MOUTH_HALVES, _MOUTH_M = 1.2, 5.0  # a road ends so far before its node: half widths of the widest, and metres
_MOUTH_SHARE = 0.35  # of its length, at most
_UNKNOWN_WIDTH_M = 6.0
_MIN_SEEN = 0.5
_CURVE = 8  # pieces of a curve


@dataclass(frozen=True)
class LaneRoad:
    """A road between the mouths of its junctions."""

    edge: RoadEdge
    xy: FloatArray
    """(N, 2) float64: centreline, metres."""
    normal: FloatArray
    """(N, 2) float64: unit vectors to the left of it."""
    width_m: float

    @property
    def is_single(self) -> bool:
        """One lane for both directions."""
        return self.width_m < TWO_LANES_M

    def border(self, side: int) -> FloatArray:
        """Return the left (1), the middle (0) or the right (-1) line, (N, 2)."""
        return self.xy + side * self.width_m / 2.0 * self.normal


class Arm(NamedTuple):
    """An end of a road at a node."""

    road: LaneRoad
    at_end: bool

    @property
    def way_in(self) -> FloatArray:
        """Unit direction of the road towards the node."""
        n = self.road.normal[-1 if self.at_end else 0]
        along = np.array([n[1], -n[0]])
        return along if self.at_end else -along

    def place(self, side: int) -> FloatArray:
        """Return the place of a line at this end: left (1), middle (0), right (-1) of the direction of the road."""
        place: FloatArray = self.road.border(side)[-1 if self.at_end else 0]
        return place

    def sides(self, *, inbound: bool) -> tuple[int, int]:
        """Return which lines of the road bound its lane into the node, or out of it: to the left and to the right."""
        forward = 1 if inbound == self.at_end else -1
        return (forward if self.road.is_single else 0), -forward


def lane_roads(network: RoadNetwork) -> list[LaneRoad]:
    """Return the roads that have lanes: those of which half or more was seen."""
    edges = [edge for edge in network.edges if edge.seen >= _MIN_SEEN and edge.length_m > 1.0]
    areas = {node.id for node in network.nodes if node.area is not None and node.kind == "place"}
    widths = {edge.id: _UNKNOWN_WIDTH_M if np.isnan(edge.width_m) else edge.width_m for edge in edges}
    at_node: dict[int, list[float]] = {}
    for edge in edges:
        for end in (edge.start, edge.end):
            at_node.setdefault(end, []).append(widths[edge.id])
    roads = []
    for edge in edges:
        line = shapely.LineString(edge.xy)
        cuts = []
        for end in (edge.start, edge.end):
            mouth = _MOUTH_HALVES * max(at_node[end]) / 2.0 + _MOUTH_M
            is_cut = len(at_node[end]) > 1 and end not in areas
            cuts.append(min(mouth, _MOUTH_SHARE * line.length) if is_cut else 0.0)
        xy = shapely.get_coordinates(substring(line, cuts[0], line.length - cuts[1]))
        roads.append(LaneRoad(edge, xy, _normals(xy), widths[edge.id]))
    return roads


def arms_of(roads: Sequence[LaneRoad]) -> dict[int, list[Arm]]:
    """Return the ends of roads by the id of their node."""
    arms: dict[int, list[Arm]] = {}
    for road in roads:
        arms.setdefault(road.edge.start, []).append(Arm(road, at_end=False))
        arms.setdefault(road.edge.end, []).append(Arm(road, at_end=True))
    return arms


def turns(arms: Sequence[Arm]) -> Iterator[tuple[Arm, Arm]]:
    """Yield each way across a node: from one arm to another one; there are no U-turns."""
    for a, first in enumerate(arms):
        yield from ((first, second) for b, second in enumerate(arms) if a != b)


def curve(start: FloatArray, way: FloatArray, end: FloatArray, way_on: FloatArray) -> FloatArray:
    """Return a smooth curve (Hermite) from a place in one direction to a place in another one, (9, 2)."""
    t = np.linspace(0.0, 1.0, _CURVE + 1)[:, None]
    reach = float(np.linalg.norm(end - start))
    polynomial = hermite(start, reach * way, end, reach * way_on)
    return np.asarray(sum(coefficient * t**k for k, coefficient in enumerate(polynomial)), np.float64)


def hermite(start: FloatArray, tangent: FloatArray, end: FloatArray, tangent_on: FloatArray) -> list[FloatArray]:
    """Return the four coefficients, each (2,), of the cubic between two places with two tangents."""
    step = end - start
    return [start, tangent, 3.0 * step - 2.0 * tangent - tangent_on, tangent + tangent_on - 2.0 * step]


def _normals(xy: FloatArray) -> FloatArray:
    way = np.diff(xy, axis=0)
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-9)[:, None]
    tangent = np.vstack([way[:1], way[:-1] + way[1:], way[-1:]])
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-9)[:, None]
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
