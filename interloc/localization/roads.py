"""The roads of a map as the search needs them: in metres, as segments, intersections with branches, and a raster."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from interloc.arrays import FloatArray, IntArray, UInt8Array, UInt16Array
from interloc.errors import MapError
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, middle_of
from interloc.kernels.roads import bucket_segments, draw_roads, nearest_ways
from interloc.osm.graph import RoadGraph, distinct_edges, neighbours_of
from interloc.osm.intersections import MIN_DEGREE, road_ways

CELLS_M = (2.0, 4.0)
"""Sides of the cells of the raster: the first that the map is not too large for."""

REACH_M = 20.0
NEAR_M = 12.0
MAX_CELLS = 100_000_000
"""Three bytes each."""

NO_ROAD = 255
WAY_REACH_M = 25.0
MAX_BRANCHES = 8
_BRANCH_M = 15.0
_BUCKET_M = 32.0
_TURN_COST_M = 20.0


@dataclass(frozen=True)
class RoadRaster:
    """Distance to the roads and their directions, cell by cell; see `interloc.kernels.roads`."""

    distance: UInt8Array
    """(H, W) uint8: 0.1 m; 255 where no road is within `REACH_M`."""
    directions: UInt16Array
    """(H, W) uint16: a bit per sector of undirected bearing."""
    origin: FloatArray
    """(2,) float64: east, north of the corner of cell (0, 0), metres."""
    cell_m: float


class Nodes:
    """Intersections of the map that a fit may use, (K, 2); leaving one out makes it a test of the others."""

    def __init__(self, xy: FloatArray) -> None:
        self.xy = xy
        self._tree = cKDTree(xy) if len(xy) else None

    def nearest(self, at: FloatArray, reach_m: float = np.inf) -> tuple[FloatArray, IntArray]:
        """Return distance, inf beyond reach, and row of the node nearest to each of (J, 2) points."""
        if self._tree is None:
            return np.full(len(at), np.inf), np.zeros(len(at), dtype=np.int64)
        distance, row = self._tree.query(at, distance_upper_bound=reach_m)
        return np.asarray(distance, dtype=np.float64), np.asarray(row, dtype=np.int64)


@dataclass(frozen=True)
class RoadMap:
    """Roads in the plane M: east and north of the middle of the map on the ellipsoid, metres."""

    lat_deg: float
    lon_deg: float
    """Origin of M."""
    segments: FloatArray
    """(S, 4) float64: x, y of both ends of every piece of road."""
    node_xy: FloatArray
    """(K, 2) float64: intersections of policy `drive`."""
    node_angles_rad: FloatArray
    """(K, MAX_BRANCHES) float64: directions in which their roads leave, counter-clockwise from east; NaN where there
    are no more."""
    node_osm_id: IntArray
    """(K,) int64."""

    @property
    def length_m(self) -> float:
        """Length of all roads."""
        return float(np.hypot(*(self.segments[:, 2:] - self.segments[:, :2]).T).sum())

    def lonlat(self, xy: FloatArray) -> FloatArray:
        """Return longitudes, latitudes of (..., 2) points of M."""
        return lonlat_from_enu(self.lat_deg, self.lon_deg, xy)

    def xy(self, lonlat: FloatArray) -> FloatArray:
        """Return points of M of (..., 2) longitudes, latitudes."""
        return enu_from_lonlat(self.lat_deg, self.lon_deg, lonlat)

    @cached_property
    def nodes(self) -> Nodes:
        """All of its intersections, to find the nearest one."""
        return Nodes(self.node_xy)

    def nearest_ways(self, poses: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the segment, (P,), and the foot with its direction, (P, 4), of (P, 3) poses; -1 where none is near."""
        segments, origin, starts, items = self._buckets
        return nearest_ways(poses, segments, origin, _BUCKET_M, starts, items, WAY_REACH_M, _TURN_COST_M)

    @cached_property
    def _buckets(self) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
        """The segments in buckets; see `interloc.kernels.roads.nearest_ways`."""
        segments = np.ascontiguousarray(self.segments)
        ends = segments.reshape(-1, 2)
        origin = ends.min(axis=0) - WAY_REACH_M
        size = ends.max(axis=0) + WAY_REACH_M - origin
        columns, rows = (int(each // _BUCKET_M) + 1 for each in size)
        return segments, origin, *bucket_segments(segments, origin, _BUCKET_M, rows, columns, WAY_REACH_M)

    def prepare(self) -> None:
        """Make what a search looks up, before several threads do."""
        _ = self.raster, self.nodes, self._buckets

    def north_rad(self, xy: FloatArray) -> FloatArray:
        """Return how far north turned counter-clockwise from the y axis of M at (..., 2) points: meridians converge."""
        step = 100.0
        here, there = self.lonlat(xy), self.lonlat(xy + np.array([0.0, step]))
        seen = enu_from_lonlat(here[..., 1], here[..., 0], there)  # the y axis of M, in east and north at the point
        return np.arctan2(seen[..., 0], seen[..., 1])

    @cached_property
    def raster(self) -> RoadRaster:
        """The raster of the roads; a MapError where the map is too large for one."""
        low = self.segments.reshape(-1, 2).min(axis=0) - REACH_M
        size = self.segments.reshape(-1, 2).max(axis=0) + REACH_M - low
        fitting = (each for each in CELLS_M if float(np.prod(size)) / each**2 <= MAX_CELLS)
        cell_m = next(fitting, None)
        if cell_m is None:
            raise MapError(
                f"the map is {size[0] / 1000:.0f} km by {size[1] / 1000:.0f} km. To be searched as a whole it may have "
                f"{MAX_CELLS * CELLS_M[-1] ** 2 / 1e6:.0f} km2. Say roughly where the drive was (--near, --radius), "
                "or cut the map."
            )
        columns, rows = (int(np.ceil(each / cell_m)) for each in size)
        distance = np.full((rows, columns), NO_ROAD, dtype=np.uint8)
        directions = np.zeros((rows, columns), dtype=np.uint16)
        draw_roads(distance, directions, self.segments, low, cell_m, REACH_M, NEAR_M)
        return RoadRaster(distance, directions, low, cell_m)


def road_map(graph: RoadGraph, near: tuple[float, float] | None = None, radius_m: float | None = None) -> RoadMap:
    """Bring the roads that cars use into a plane, service roads too: drives begin on them.

    Only what lies within `radius_m` of `near` (latitude, longitude) is taken, if given. Raises a MapError where there
    are none.
    """
    edges = distinct_edges(graph.edges_of(road_ways(graph, "drive+service")))
    is_drivable = road_ways(graph, "drive")
    drivable = distinct_edges(graph.edges_of(is_drivable))
    if near is None:
        used = graph.lonlat[np.unique(edges)] if len(edges) else graph.lonlat
        lon, lat = middle_of(used)
    else:
        lat, lon = near
    all_xy = enu_from_lonlat(lat, lon, graph.lonlat)
    keep = np.ones(len(all_xy), dtype=np.bool_)
    if radius_m is not None:
        keep = np.hypot(all_xy[:, 0], all_xy[:, 1]) <= radius_m
        edges = edges[keep[edges].any(axis=1)]
    if len(edges) == 0:
        where = "" if near is None else f" within {(radius_m or 0) / 1000:g} km of {near[0]:.5f}, {near[1]:.5f}"
        raise MapError(f"{graph.source}: holds no roads for cars{where}. Expected the map of where the drive was.")
    segments = np.column_stack([all_xy[edges[:, 0]], all_xy[edges[:, 1]]])
    rows = np.flatnonzero((graph.degree(is_drivable) >= MIN_DEGREE) & graph.inside_bounds & keep)
    return RoadMap(
        lat_deg=float(lat),
        lon_deg=float(lon),
        segments=segments,
        node_xy=all_xy[rows],
        node_angles_rad=_branches(rows, drivable, all_xy),
        node_osm_id=graph.node_id[rows],
    )


def _branches(rows: IntArray, edges: IntArray, xy: FloatArray) -> FloatArray:
    """Return the directions in which roads leave each node, to the point about `_BRANCH_M` along each of them."""
    neighbours = neighbours_of(edges)
    angles = np.full((len(rows), MAX_BRANCHES), np.nan)
    for row, node in enumerate(rows.tolist()):
        for branch, first in enumerate(neighbours[node][:MAX_BRANCHES]):
            before, here = node, first
            while np.hypot(*(xy[here] - xy[node])) < _BRANCH_M and len(neighbours[here]) == 2:
                a, b = neighbours[here]
                before, here = here, b if a == before else a
                if here == node:
                    break
            away = xy[here] - xy[node]
            angles[row, branch] = np.arctan2(away[1], away[0])
    return angles
