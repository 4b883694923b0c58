"""The map of the roads of a drive: nodes, edges, areas."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import projection

if TYPE_CHECKING:
    import shapely  # slow to import

NodeKind = Literal["intersection", "fork", "place", "dead_end", "end_of_view"]
"""What a node is.

intersection: one of the result, or several in one place. fork: three or more lines of the road meet, and the result has
no intersection there. place: an open place without one. dead_end: the road ends and the drive came near. end_of_view:
the road was not seen farther.
"""

PROFILE_STEP_M = 10.0
"""Between two widths of the profile of an edge."""


@dataclass(frozen=True)
class RoadNode:
    """Where roads meet or end."""

    id: int
    """From 1."""
    kind: NodeKind
    xy: FloatArray
    """(2,) float64: metres of the network's coordinate system."""
    intersections: tuple[int, ...] = ()
    """Ids of the fused intersections that it is."""
    area: shapely.Polygon | None = None
    """The ground where its roads meet; None where one ends."""


@dataclass(frozen=True)
class RoadEdge:
    """A road between two nodes."""

    id: int
    """From 1."""
    start: int
    end: int
    """Ids of its nodes."""
    xy: FloatArray
    """(N, 2) float64: centreline, metres of the network's coordinate system: from node to node, or to the edge of an
    open place."""
    width_m: float
    width_p10_m: float
    width_p90_m: float
    """Width from edge to edge: median along it, 10th and 90th percentile; NaN where it is too short to measure."""
    profile_m: FloatArray
    """(P,) float64: width every `PROFILE_STEP_M` from the start; NaN where it was not measured."""
    seen: float
    """Share of its length that was seen, 0..1; the rest are gaps between two ends that face each other."""
    keyframes: int
    """Median number of the keyframes, 10 m apart, that saw its middle."""
    offset_std_m: float
    """One-sigma uncertainty of the centreline across its direction, without that of the georeference; NaN where the
    width is not known."""
    is_driven: bool
    """The drive went along it. Of other roads one flank may be hidden: their width is a minimum."""

    @property
    def length_m(self) -> float:
        """Length of the centreline."""
        return float(np.linalg.norm(np.diff(self.xy, axis=0), axis=1).sum())


@dataclass(frozen=True)
class RoadNetwork:
    """The roads that a drive saw."""

    nodes: list[RoadNode] = field(default_factory=list)
    edges: list[RoadEdge] = field(default_factory=list)
    surface: list[shapely.Polygon] = field(default_factory=list)
    """The ground that was seen as road, in squares of 256 m (of 512 cells)."""
    epsg: int | None = None
    """Coordinates are metres of this system; None: metres of W, without georeference."""

    def __repr__(self) -> str:
        km = sum(edge.length_m for edge in self.edges) / 1000.0
        return f"<RoadNetwork {len(self.nodes)} nodes, {len(self.edges)} roads, {km:.1f} km>"

    def lonlat(self, xy: FloatArray) -> FloatArray:
        """Return longitude and latitude, degrees, of (N, 2) places; the places themselves without georeference."""
        return xy if self.epsg is None else projection(self.epsg, 4326)(xy)
