"""Geodetic fixes: their checks, and rigid poses on the ellipsoid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings, GeoreferenceFileError
from interloc.drives.poses.motion import body_steps, rows_apart
from interloc.geometry import ecef_from_geodetic, invert_transform, wrap_longitude

MAX_GEOREFERENCE_ERROR = 0.1
"""Of the distance between two scans; all KITTI drives stay under 0.02, and those of other drives are over 0.1."""


def checked_fixes(file: SourceFile, rows: FloatArray, frames: IntArray) -> FloatArray:
    """Refuse positions that are not on Earth, and angles in degrees; bring longitudes of 0..360 to -180..180.

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
    return np.column_stack([rows[:, :1], wrap_longitude(rows[:, 1:2]), rows[:, 2:]])


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


def check_georeference(poses: FloatArray, georeference: Georeference, findings: Findings) -> float | None:
    """Check that the georeference moves as the poses do, piece by piece (drift does not matter).

    Parameters
    ----------
    poses : (N, 4, 4) float64
        T_world_lidar.

    Returns
    -------
    float or None
        Median error of the motion over pieces of some metres, as a share of their length; None where it hardly moves.
    """
    rows = rows_apart(poses[:, :3, 3], 10.0)
    if len(rows) < 2:
        return None
    ours = body_steps(poses[rows])

    def error_of(fixes: Georeference) -> float:
        theirs = body_steps(ecef_poses(fixes)[rows])
        return float(np.median(np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)))

    error = error_of(georeference)
    if error > MAX_GEOREFERENCE_ERROR:
        cause = (
            "Usual cause: the georeference of another drive, rows that start at another frame, or angles in another "
            "convention (expected: yaw 0 = east, counter-clockwise, radians)."
        )
        swapped = replace(georeference, lat_deg=georeference.lon_deg, lon_deg=georeference.lat_deg)
        if np.abs(swapped.lat_deg).max() < 90.0 and error_of(swapped) < MAX_GEOREFERENCE_ERROR:
            cause = "Latitude and longitude are swapped: the other way round the motion is that of the poses."
        findings.error(
            GeoreferenceFileError(
                georeference.source,
                f"describes another motion than the poses: off by {error:.0%} of the distance, piece by piece "
                f"(usual: under 2 %). {cause}",
            )
        )
    return error
