"""Mosaics of streets that are drawn, and results with the intersections that a drive would find on them."""

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike

from interloc.arrays import FloatArray
from interloc.mapping.mosaic import CELL_M, Mosaic, Raster
from interloc.results import DetectionTable, DriveResult, IntersectionTable, KeyframeTable
from interloc.roadmap.extract import extract_roads
from interloc.roadmap.network import RoadEdge, RoadNetwork

SEEN = 6  # sightings of each cell


def street(*points: tuple[float, float], width_m: float = 7.0) -> shapely.Geometry:
    """Return the surface of a street along some points, metres."""
    return shapely.LineString(points).buffer(width_m / 2, cap_style="flat")


def draw(ground: shapely.Geometry) -> Mosaic:
    """Return a mosaic that saw some ground, without georeference."""
    west, south, east, north = (round(v / CELL_M) for v in ground.bounds)
    rows, cols = np.mgrid[-north - 4 : -south + 4, west - 4 : east + 4]
    cells = shapely.contains_xy(ground, (cols + 0.5) * CELL_M, -(rows + 0.5) * CELL_M)
    raster = Raster(CELL_M)
    raster.add(-north - 4, west - 4, (SEEN * cells).astype(np.uint8))
    return Mosaic(raster, None)


def drive(track: Sequence[tuple[float, float]], intersections: ArrayLike = (), every_m: float = 2.0) -> DriveResult:
    """Return a drive along some points that found some intersections, in metres of W."""
    line = shapely.LineString(track)
    at = shapely.line_interpolate_point(line, np.arange(0.0, line.length, every_m))
    xy, places = shapely.get_coordinates(at), np.array(intersections, dtype=np.float64).reshape(-1, 2)
    frames, count = np.arange(len(xy)), len(places)
    nothing: list[FloatArray] = [np.zeros(0)] * count
    return DriveResult(
        drive="drawn",
        keyframes=KeyframeTable(frames, np.full(len(xy), np.nan), xy, np.zeros(len(xy))),
        detections=DetectionTable(
            np.zeros(0, np.int64), xy[:0], xy[:0], None, [], np.zeros(0), np.zeros(0, np.int64), [], np.zeros(0)
        ),
        intersections=IntersectionTable(
            id=np.arange(1, count + 1),
            world_xy=places,
            lonlat=None,
            position_std_m=np.full(count, 0.3),
            observations=np.ones(count, np.int64),
            confidence=np.ones(count),
            bearings_deg=nothing,
            widths_m=nothing,
            first_frame=np.zeros(count, np.int64),
            last_frame=np.zeros(count, np.int64),
        ),
        trajectory_world_xy=xy,
        trajectory_lonlat=None,
    )


def roads_of(
    ground: shapely.Geometry, track: Sequence[tuple[float, float]], intersections: ArrayLike = ()
) -> RoadNetwork:
    return extract_roads(drive(track, intersections), draw(ground))


def joined(network: RoadNetwork) -> set[frozenset[int]]:
    """Return the pairs of intersections that one road joins."""
    numbers = {node.id: number for node in network.nodes for number in node.intersections}
    return {frozenset((numbers[e.start], numbers[e.end])) for e in network.edges if {e.start, e.end} <= numbers.keys()}


def away(edge: RoadEdge, *points: tuple[float, float]) -> float:
    """Return the greatest distance of a road from the line through some points, metres."""
    return float(shapely.distance(shapely.points(edge.xy), shapely.LineString(points)).max())


def turned(degrees: float, *points: tuple[float, float]) -> list[tuple[float, float]]:
    """Return points turned around the origin."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return [(c * x - s * y, s * x + c * y) for x, y in points]
