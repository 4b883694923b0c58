"""Whether the map belongs to the drive: distance of the track from the roads, before anything is scored."""

import logging
import math
from typing import Any

import numpy as np

from interloc.arrays import FloatArray
from interloc.errors import MapError
from interloc.geometry import ecef_from_geodetic, enu_from_lonlat, lonlat_from_enu, middle_of, tree_of, wrap_longitude
from interloc.osm.graph import Bounds, RoadGraph, bounds_of, within
from interloc.osm.intersections import road_ways

logger = logging.getLogger(__name__)

TRACK_OFF_ROAD_M = 5.0
"""A larger median distance of the track from the roads is suspicious: on KITTI it is 0.4 to 1.1 m."""

_AROUND_DEG = 0.02
_SURROUNDINGS_M = 3000.0  # more than the degrees around the track within which roads are looked for


def track_bounds(lonlat: FloatArray, *, margin_m: float = 200.0) -> Bounds:
    """Return what the map of a drive should cover: the bounds of its keyframes, (K, 2) degrees, and a margin.

    It is more than half the diagonal of the ROI (85 m for 120 m), so that no road is missed.
    """
    west, south, east, north = bounds_of(lonlat)
    # Degrees of longitude are shorter at the corner that is further from the equator.
    lat = max(south, north, key=abs)
    lon_margin, lat_margin = (lonlat_from_enu(lat, 0.0, np.array([margin_m, margin_m])) - np.array([0.0, lat])).tolist()
    west, east = wrap_longitude([west - lon_margin, east + lon_margin]).tolist()
    return west, south - lat_margin, east, north + lat_margin


def map_bounds(lonlat: FloatArray) -> Bounds:
    """Return what of a map can matter to a drive: the bounds of its keyframes, (K, 2) degrees, and some kilometres.

    Rounded outwards to thousandths of a degree, so that it is the same for coordinates from a result file. All roads
    that `track_to_road` looks at lie within.
    """
    west, south, east, north = track_bounds(lonlat, margin_m=_SURROUNDINGS_M)
    return (
        math.floor(west * 1000) / 1000,
        math.floor(south * 1000) / 1000,
        math.ceil(east * 1000) / 1000,
        math.ceil(north * 1000) / 1000,
    )


def track_to_road(track_lonlat: FloatArray, graph: RoadGraph) -> FloatArray:
    """Return the distance of (K, 2) track points from the nearest drivable road, (K,) metres.

    Infinite where the map holds no drivable road within about two kilometres.
    """
    import shapely  # noqa: PLC0415 - the server does without

    edges = graph.edges_of(road_ways(graph, "drive+service"))
    # The plane is accurate only around the drive, and the map may be of another continent.
    west, south, east, north = bounds_of(track_lonlat)
    west, east = wrap_longitude([west - _AROUND_DEG, east + _AROUND_DEG]).tolist()
    around = (west, south - _AROUND_DEG, east, north + _AROUND_DEG)
    edges = edges[within(around, graph.lonlat)[edges].any(axis=1)]
    if len(edges) == 0:
        return np.full(len(track_lonlat), np.inf)
    lon, lat = middle_of(track_lonlat)
    roads: Any = shapely.linestrings(enu_from_lonlat(lat, lon, graph.lonlat)[edges])
    points = shapely.points(enu_from_lonlat(lat, lon, track_lonlat))
    (point, _), distance = shapely.STRtree(roads).query_nearest(points, return_distance=True, all_matches=False)
    nearest = np.full(len(track_lonlat), np.inf)
    nearest[point] = distance
    return nearest


def check_coverage(track_lonlat: FloatArray, graph: RoadGraph, *, roi_m: float) -> tuple[float, tuple[str, ...]]:
    """Refuse (MapError) a map of another place than the (K, 2) degrees of a track; warn where it fits badly.

    Returns the median distance of the track from the nearest drivable road, metres, and reasons to read the figures
    with care.
    """
    distance = track_to_road(track_lonlat, graph)
    covered = distance <= roi_m / 2.0
    if not covered.any():
        raise MapError(_elsewhere(track_lonlat, graph))
    median = float(np.median(distance))
    warnings = []
    if covered.mean() < 0.99:
        warnings.append(
            f"{1.0 - covered.mean():.0%} of the keyframes have no drivable road of {graph.source} within "
            f"{roi_m / 2.0:.0f} m: the map does not cover the whole drive, and what was found there is "
            "not scored, or false."
        )
    if median > TRACK_OFF_ROAD_M:
        warnings.append(
            f"The track runs {median:.1f} m (median) from the nearest drivable road of {graph.source}; 0.4 to 1.1 m is "
            "usual. Usual causes: a georeference of another drive, an offset of the fixes, or a drive off the roads."
        )
    for warning in warnings:
        logger.warning(warning)
    return median, tuple(warnings)


def warn_of_border(track_lonlat: FloatArray, detection_lonlat: FloatArray, graph: RoadGraph) -> tuple[str, ...]:
    """Say where the content of a map ends within a drive, given (K, 2) and (D, 2) degrees, though it declares more."""
    keyframes, detections = (
        int((graph.declares(lonlat) & ~graph.covers(lonlat)).sum()) for lonlat in (track_lonlat, detection_lonlat)
    )
    if not detections and keyframes <= 0.01 * len(track_lonlat):
        return ()
    warning = (
        f"{graph.source} ends within the drive: at {keyframes} of {len(track_lonlat)} keyframes and "
        f"{detections} of {len(detection_lonlat)} detections it has no roads but those that come across its border, "
        "and what meets them there is missing. Nothing beyond the border is scored. Usual cause: an extract that was "
        "cut by a polygon or a box, or a map drawn no further; take one that goes on beyond the drive."
    )
    logger.warning(warning)
    return (warning,)


def _elsewhere(track_lonlat: FloatArray, graph: RoadGraph) -> str:
    highways, track = (ecef_from_geodetic(lonlat[:, 1], lonlat[:, 0]) for lonlat in (graph.lonlat, track_lonlat))
    distance_m, _ = tree_of(highways).query(track)
    nearest_km = np.min(distance_m) / 1000.0
    west, south, east, north = graph.extent
    lon0, lat0, lon1, lat1 = bounds_of(track_lonlat)
    elsewhere = "the OSM file of another sequence, or longitude and latitude swapped in geo.csv"
    usual = elsewhere if nearest_km > 1.0 else "a map without the roads for cars"
    return (
        f"the map {graph.source} covers lon {west:.4f}..{east:.4f}, lat {south:.4f}..{north:.4f}; the drive lies at "
        f"lon {lon0:.4f}..{lon1:.4f}, lat {lat0:.4f}..{lat1:.4f}, {nearest_km:.1f} km from its nearest highway, "
        f"and no drivable road is near. Usual mistake: {usual}."
    )
