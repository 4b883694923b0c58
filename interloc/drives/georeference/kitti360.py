"""The world of KITTI-360's poses: the spherical Mercator projection about a lake near Karlsruhe."""

from __future__ import annotations

import numpy as np

from interloc.arrays import FloatArray
from interloc.drive import Georeference
from interloc.geometry import WGS84_A_M

ORIGIN_LAT_DEG, ORIGIN_LON_DEG = 48.9843445, 8.4295857
"""Where the x and y of its poses are 0, and the projection has scale 1 (devkit of KITTI-360)."""

MIN_ALT_M, MAX_ALT_M = 50.0, 400.0
"""Bounds of the median height of a drive in that world, generous: it was driven at 100 to 250 m."""


def georeference_of_kitti360(T_file_lidar: FloatArray, source: str) -> Georeference:
    """Place poses of the LiDAR in the world of KITTI-360 on the ellipsoid.

    Parameters
    ----------
    T_file_lidar : (N, 4, 4) float64
        In the world of its poses.txt and cam0_to_world.txt: x east, y north, z the altitude.
    source : str
        Where they come from, in words.

    Notes
    -----
    The projection keeps angles, and its y axis looks north everywhere: rotations are those in the local east-north-up
    frame. It is that of a sphere: distances in the file are 0.2 % shorter to the east and 0.1 % longer to the north
    than on the ellipsoid, which adds up to metres within kilometres of the origin, and is undone here.
    """
    scale = np.cos(np.radians(ORIGIN_LAT_DEG)) * WGS84_A_M
    x, y, z = T_file_lidar[:, :3, 3].T
    mercator = np.arcsinh(np.tan(np.radians(ORIGIN_LAT_DEG))) + y / scale
    return Georeference(
        lat_deg=np.degrees(np.arctan(np.sinh(mercator))),
        lon_deg=ORIGIN_LON_DEG + np.degrees(x / scale),
        alt_m=z.copy(),
        R_enu_lidar=T_file_lidar[:, :3, :3].copy(),
        source=source,
    )


def is_karlsruhe(fixes: Georeference) -> bool:
    """Return whether fixes lie at heights where KITTI-360 was driven: poses from the identity do not."""
    return bool(MIN_ALT_M < np.median(fixes.alt_m) < MAX_ALT_M)
