"""Geodetic fixes: their check, and rigid poses on the ellipsoid."""

from __future__ import annotations

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile
from interloc.geometry import ecef_from_geodetic, invert_transform


def checked_fixes(file: SourceFile, rows: FloatArray, frames: IntArray) -> FloatArray:
    """Refuse positions that are not on Earth, and angles in degrees.

    Parameters
    ----------
    file : SourceFile
        Where they come from.
    rows : (N, 6 or more) float64
        Latitude, longitude in degrees, altitude in metres, roll, pitch, yaw in radians.
    frames : (N,) int64
        Scan numbers, for messages.

    Raises
    ------
    GeoreferenceError
        One of them is out of range, or has no fix.
    """
    lat, lon, alt, angles = np.abs(rows[:, 0]), np.abs(rows[:, 1]), np.abs(rows[:, 2]), np.abs(rows[:, 3:6])
    off = (lat > 89) | (lon > 360) | (alt > 20_000)
    if off.any():
        row = int(np.argmax(off))
        raise file.fault(
            f"frame {frames[row]}: latitude {rows[row, 0]:g}, longitude {rows[row, 1]:g}, altitude {rows[row, 2]:g} "
            "is no place to drive. Expected degrees and metres. Usual cause: projected coordinates, or latitude and "
            "longitude swapped."
        )
    if ((lat == 0) & (lon == 0)).any():
        row = int(np.argmax((lat == 0) & (lon == 0)))
        raise file.fault(f"frame {frames[row]}: latitude and longitude are 0: the receiver had no fix.")
    if (angles > 2 * np.pi).any():
        row = int(np.argmax((angles > 2 * np.pi).any(axis=1)))
        raise file.fault(
            f"frame {frames[row]}: an angle of {angles[row].max():g}. Expected radians. Usual cause: degrees."
        )
    return rows


def poses_of(georeference: Georeference) -> FloatArray:
    """Return (N, 4, 4) T_world_lidar of a georeference, exact on the ellipsoid; W is the LiDAR at the first fix."""
    T_ecef_lidar = ecef_poses(georeference)
    relative: FloatArray = invert_transform(T_ecef_lidar[0]) @ T_ecef_lidar
    return relative


def ecef_poses(georeference: Georeference) -> FloatArray:
    """Return (N, 4, 4) poses of the LiDAR in the earth-centred, earth-fixed frame of WGS84, metres."""
    lat, lon = np.radians(georeference.lat_deg), np.radians(georeference.lon_deg)
    sin_lat, cos_lat, sin_lon, cos_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    poses = np.zeros((len(lat), 4, 4))
    poses[:, :3, 3] = ecef_from_geodetic(georeference.lat_deg, georeference.lon_deg, georeference.alt_m)
    poses[:, 3, 3] = 1
    zero = np.zeros_like(lat)
    east = np.stack([-sin_lon, cos_lon, zero], axis=1)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=1)
    up = np.stack([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat], axis=1)
    poses[:, :3, :3] = np.stack([east, north, up], axis=2) @ georeference.R_enu_lidar
    return poses
