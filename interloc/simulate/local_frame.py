"""The plane in which a scene is drawn: a transverse Mercator projection about a point of the track."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pyproj import Proj

from interloc.arrays import FloatArray
from interloc.geometry import rotation_from_rpy


class LocalFrame:
    """Frame M of a scene: x, y in metres, conformal, true to scale within 1e-7 some kilometres around its origin.

    Parameters
    ----------
    lat_deg, lon_deg
        Origin on WGS84.
    """

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = float(lat_deg)
        self.lon_deg = float(lon_deg)
        self._projection = Proj(proj="tmerc", lat_0=self.lat_deg, lon_0=self.lon_deg, k=1, ellps="WGS84")

    def xy(self, lonlat: FloatArray) -> FloatArray:
        """Project (..., 2) longitudes, latitudes in degrees to (..., 2) metres."""
        lonlat = np.asarray(lonlat, dtype=np.float64)
        return np.stack(self._projection(lonlat[..., 0], lonlat[..., 1]), axis=-1)

    def lonlat(self, xy: FloatArray) -> FloatArray:
        """Return (..., 2) longitudes, latitudes in degrees of (..., 2) metres."""
        xy = np.asarray(xy, dtype=np.float64)
        return np.stack(self._projection(xy[..., 0], xy[..., 1], inverse=True), axis=-1)

    def R_map_enu(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> FloatArray:
        """Return (..., 3, 3) rotations from the east-north-up frame at fixes to M: the meridian convergence."""
        lon, lat = np.asarray(lon_deg, dtype=np.float64), np.asarray(lat_deg, dtype=np.float64)
        here = self.xy(np.stack([lon, lat], axis=-1))
        north = self.xy(np.stack([lon, lat + 1e-5], axis=-1)) - here
        yaw = np.arctan2(-north[..., 0], north[..., 1])
        return rotation_from_rpy(0.0, 0.0, yaw)
