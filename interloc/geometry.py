"""Rotations, planar angles and the small geodesy that the project needs.

Frames: W (world: the first LiDAR pose), L (LiDAR), ENU (east, north, up at a fix). ``T_dst_src`` maps points of
``src`` into ``dst``. Metres and radians; geodetic latitude and longitude in degrees on the WGS84 ellipsoid.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from interloc.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Angle = TypeVar("Angle", float, FloatArray)

WGS84_A_M = 6378137.0
WGS84_F = 1 / 298.257223563
WGS84_E2 = WGS84_F * (2 - WGS84_F)


def rotation_from_rpy(roll_rad: ArrayLike, pitch_rad: ArrayLike, yaw_rad: ArrayLike) -> FloatArray:
    """Return R_enu_body = Rz(yaw) Ry(pitch) Rx(roll), (..., 3, 3), of (...,) angles of the KITTI convention.

    Yaw 0 looks east, counter-clockwise.
    """
    roll, pitch, yaw = np.broadcast_arrays(*(np.asarray(a, dtype=np.float64) for a in (roll_rad, pitch_rad, yaw_rad)))
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rpy_from_rotation(rotation: FloatArray) -> FloatArray:
    """Return roll, pitch, yaw, (..., 3) radians, of (..., 3, 3) rotations: inverse of `rotation_from_rpy`."""
    roll = np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2])
    pitch = -np.arcsin(np.clip(rotation[..., 2, 0], -1.0, 1.0))
    return np.stack([roll, pitch, yaw_of(rotation)], axis=-1)


def yaw_of(rotation: FloatArray) -> FloatArray:
    """Return the heading of the x axis, radians counter-clockwise, of (..., 3, 3) rotations as (...,) float64."""
    return np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0])


def rotation_angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle in radians of the rotation between two (3, 3) rotations."""
    cosine = (float(np.sum(a * b)) - 1.0) / 2.0
    return math.acos(min(1.0, max(-1.0, cosine)))


def rotate_2d(xy: FloatArray, angle_rad: ArrayLike) -> FloatArray:
    """Turn (..., 2) points counter-clockwise by one angle, or by one angle per point."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def wrap_angle(angle_rad: Angle) -> Angle:
    """Bring angles into [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


def bearing_deg(angle_rad: ArrayLike) -> FloatArray:
    """Turn mathematical angles (counter-clockwise from +x, east) into bearings (clockwise from +y, north), [0, 360)."""
    return wrap_bearing(90.0 - np.degrees(np.asarray(angle_rad, dtype=np.float64)))


def wrap_bearing(degrees: ArrayLike) -> FloatArray:
    """Bring bearings into [0, 360): a tiny negative number too, which the remainder alone would round to 360."""
    wrapped = np.asarray(degrees, dtype=np.float64) % 360.0
    return np.where(wrapped >= 360.0, 0.0, wrapped)


def wrap_longitude(degrees: ArrayLike) -> FloatArray:
    """Bring longitudes into [-180, 180); those that lie in it stay as they are to the last bit."""
    lon = np.asarray(degrees, dtype=np.float64)
    return np.where((lon >= -180.0) & (lon < 180.0), lon, (lon + 180.0) % 360.0 - 180.0)


def middle_of(lonlat: FloatArray) -> tuple[float, float]:
    """Return the median longitude and latitude of (N, 2) places that are near each other, also across 180 degrees."""
    first = lonlat[0, 0]
    lon = wrap_longitude(first + np.median(wrap_longitude(lonlat[:, 0] - first)))
    return float(lon), float(np.median(lonlat[:, 1]))


def rows_apart(position: FloatArray, step_m: float) -> list[int]:
    """Return rows of (P, 3) positions that lie at least a step apart, one after the other, from the first on."""
    rows = [0]
    x0, y0, z0 = position[0]
    limit = step_m * step_m
    for row, (x, y, z) in enumerate(position.tolist()):
        if (x - x0) ** 2 + (y - y0) ** 2 + (z - z0) ** 2 >= limit:
            rows.append(row)
            x0, y0, z0 = x, y, z
    return rows


def thin(xy: FloatArray, step_m: float) -> IntArray:
    """Return the rows of (N, 2) positions that lie `step_m` or more from the one kept before; first and last stay."""
    if not len(xy):
        return np.empty(0, np.int64)
    kept = rows_apart(np.pad(xy, ((0, 0), (0, 1))), step_m)
    return np.array(sorted({*kept, len(xy) - 1}), np.int64)


def travelled(places: FloatArray) -> FloatArray:
    """Return the distance along (N, 2 or 3) places up to each of them, (N,)."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    return np.concatenate([np.zeros(len(places[:1])), np.cumsum(steps)])


def rigid_transforms(rotations: FloatArray, shifts: FloatArray) -> FloatArray:
    """Return the (N, 4, 4) transforms of (N, 3, 3) rotations and (N, 3) shifts."""
    transforms = np.tile(np.eye(4), (len(shifts), 1, 1))
    transforms[:, :3, :3], transforms[:, :3, 3] = rotations, shifts
    return transforms


def invert_transform(transform: FloatArray) -> FloatArray:
    """Invert rigid (..., 4, 4) transforms."""
    inverse = np.zeros_like(transform)
    rotation_t = np.swapaxes(transform[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation_t
    inverse[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation_t, transform[..., :3, 3])
    inverse[..., 3, 3] = 1.0
    return inverse


def from_first(poses: FloatArray) -> FloatArray:
    """Return (N, 4, 4) poses as seen from the first, which becomes the identity."""
    relative: FloatArray = invert_transform(poses[0]) @ poses
    relative[0] = np.eye(4)
    return relative


def _metres_per_degree(lat_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return metres per degree of latitude and of longitude at a latitude, from the radii of curvature."""
    lat = np.radians(np.asarray(lat_deg, dtype=np.float64))
    w2 = 1.0 - WGS84_E2 * np.sin(lat) ** 2
    meridian = WGS84_A_M * (1.0 - WGS84_E2) / w2**1.5
    prime_vertical = WGS84_A_M / np.sqrt(w2)
    return np.radians(meridian), np.radians(prime_vertical * np.cos(lat))


def _curvature(lat_deg: ArrayLike) -> FloatArray:
    """Return tan(latitude) / prime vertical radius, 1/m: how fast meridians turn towards each other going east."""
    lat = np.radians(np.asarray(lat_deg, dtype=np.float64))
    return np.tan(lat) * np.sqrt(1.0 - WGS84_E2 * np.sin(lat) ** 2) / WGS84_A_M


def ecef_from_geodetic(lat_deg: ArrayLike, lon_deg: ArrayLike, alt_m: ArrayLike = 0.0) -> FloatArray:
    """Return (..., 3) metres in the earth-centred, earth-fixed frame of points over the ellipsoid."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    prime_vertical = WGS84_A_M / np.sqrt(1 - WGS84_E2 * np.sin(lat) ** 2)
    height = prime_vertical + np.asarray(alt_m, dtype=np.float64)
    x, y = height * np.cos(lat) * np.cos(lon), height * np.cos(lat) * np.sin(lon)
    return np.stack([x, y, (height - WGS84_E2 * prime_vertical) * np.sin(lat)], axis=-1)


def lonlat_from_enu(lat_deg: ArrayLike, lon_deg: ArrayLike, enu_xy: FloatArray) -> FloatArray:
    """Return (..., 2) longitude, latitude, degrees, of (..., 2) metres east and north of (...,) fixes on the ellipsoid.

    They lie in the tangent plane, within some kilometres of the fix. The Taylor series of the ellipsoid to second order
    is off by less than 0.1 mm at 100 m and 1 cm at 1 km up to 70 degrees of latitude; the first order alone is 1 mm off
    at 100 m at KITTI's latitude, 2.5 mm at 70 degrees.
    """
    north_scale, east_scale = _metres_per_degree(lat_deg)
    curvature = _curvature(lat_deg)
    east, north = enu_xy[..., 0], enu_xy[..., 1]
    lon = np.asarray(lon_deg, dtype=np.float64) + east * (1.0 + curvature * north) / east_scale
    lat = np.asarray(lat_deg, dtype=np.float64) + (north - 0.5 * curvature * east**2) / north_scale
    return np.stack([wrap_longitude(lon), lat], axis=-1)


def enu_from_lonlat(lat_deg: ArrayLike, lon_deg: ArrayLike, lonlat: FloatArray) -> FloatArray:
    """Return (..., 2) east, north in metres of (..., 2) longitudes, latitudes: inverse of `lonlat_from_enu`.

    Longitudes on both sides of the 180th meridian are neighbours.
    """
    north_scale, east_scale = _metres_per_degree(lat_deg)
    curvature = _curvature(lat_deg)
    east_arc = wrap_longitude(lonlat[..., 0] - np.asarray(lon_deg, dtype=np.float64)) * east_scale
    north_arc = (lonlat[..., 1] - np.asarray(lat_deg, dtype=np.float64)) * north_scale
    east, north = east_arc, north_arc
    for _ in range(6):  # each round gains a factor of distance / Earth's radius: exact within some ten kilometres
        east = east_arc / (1.0 + curvature * north)
        north = north_arc + 0.5 * curvature * east**2
    return np.stack([east, north], axis=-1)


def utm_zone(lon_deg: float, lat_deg: float) -> int:
    """Return the EPSG code of the UTM zone of a place, on WGS84."""
    zone = int((lon_deg + 180.0) // 6.0) % 60 + 1
    return (32600 if lat_deg >= 0 else 32700) + zone


@lru_cache(maxsize=32)
def projection(source: int, target: int) -> Callable[[FloatArray], FloatArray]:
    """Return what leads (..., 2) places from one coordinate system (EPSG, or a CRS) to another; 4326 is lon, lat."""
    from pyproj import Transformer  # noqa: PLC0415 - slow to import

    transformer = Transformer.from_crs(source, target, always_xy=True)
    return lambda xy: np.stack(transformer.transform(xy[..., 0], xy[..., 1]), axis=-1)


def near_pairs(xy: FloatArray, others: FloatArray, radius_m: float) -> IntArray:
    """Return which of (N, 2) points lie within a radius of which of (M, 2) others: (2, P) rows of both, ascending."""
    from shapely import STRtree, points  # noqa: PLC0415 - slow to import

    pairs = STRtree(np.asarray(points(others))).query(points(xy), predicate="dwithin", distance=radius_m)
    return pairs[:, np.lexsort(pairs[::-1])].astype(np.int64)


# What is nearest and what belongs together, by SciPy: `interloc run` without a map, `info` and the server do without.


def tree_of(points: FloatArray) -> cKDTree:
    """Return (N, D) points as a tree that finds those that are near."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    return cKDTree(points)


def nearest_of(xy: FloatArray, others: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the distance of each of (N, 2) positions from the nearest other one, infinite without any, and its row."""
    if not len(others) or not len(xy):
        return np.full(len(xy), np.inf), np.zeros(len(xy), dtype=np.int64)
    distance, row = tree_of(others).query(xy)
    return np.atleast_1d(distance).astype(np.float64), np.atleast_1d(row).astype(np.int64)


def linked_groups(one: IntArray, other: IntArray, count: int) -> IntArray:
    """Return the group of each of `count` things, (count,) from 0: links from each of `one` to each of `other` join."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - slow to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    links = coo_array((np.ones(len(one)), (one, other)), shape=(count, count))
    return connected_components(links, directed=False)[1].astype(np.int64)
