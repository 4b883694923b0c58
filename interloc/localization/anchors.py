"""Other ways to place a drive: one pose that is known."""

from __future__ import annotations

import math

import numpy as np

from interloc.drive import Drive, Georeference
from interloc.errors import ConfigError
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, rotate_2d, rotation_from_rpy
from interloc.localization.track import track_of


def georeference_at(
    drive: Drive, lat_deg: float, lon_deg: float, heading_deg: float, *, frame: int | None = None
) -> Georeference:
    """Place a drive by one pose of its LiDAR.

    Parameters
    ----------
    drive
        Its poses carry the known one to all scans: the error grows with their drift, and by 1.7 m per 100 m of
        distance for each degree that the heading is wrong.
    lat_deg, lon_deg : float
        Position of the LiDAR.
    heading_deg : float
        Of its x axis, clockwise from north.
    frame : int or None
        Number of the scan; None: the first.

    Raises
    ------
    ConfigError
        The position or heading is not one, or the drive has no such scan.
    """
    if not (abs(lat_deg) <= 89.0 and abs(lon_deg) <= 180.0 and math.isfinite(heading_deg)):
        raise ConfigError(
            f"{lat_deg:g},{lon_deg:g} heading {heading_deg:g} is no pose on earth. "
            "Expected latitude, longitude and a heading clockwise from north, all in degrees."
        )
    row = 0 if frame is None else int(np.searchsorted(drive.frames, frame))
    if row >= len(drive.frames) or (frame is not None and drive.frames[row] != frame):
        raise ConfigError(
            f"{drive.name}: there is no scan {frame}. Expected one of {drive.frames[0]} to {drive.frames[-1]}."
        )
    track = track_of(drive.T_world_lidar)
    turn = math.radians(90.0 - heading_deg) - float(track.yaw_rad[row])
    enu = rotate_2d(track.xy - track.xy[row], turn)
    lonlat = lonlat_from_enu(lat_deg, lon_deg, enu)
    # North at each scan, seen from the known pose: meridians converge.
    ahead = enu_from_lonlat(lonlat[:, 1], lonlat[:, 0], lonlat_from_enu(lat_deg, lon_deg, enu + np.array([0.0, 100.0])))
    north = np.arctan2(ahead[:, 0], ahead[:, 1])
    zero = np.zeros(len(enu))
    return Georeference(
        lonlat[:, 1],
        lonlat[:, 0],
        track.z_m - track.z_m[row],
        rotation_from_rpy(zero, zero, turn - north) @ track.R_level_lidar,
        f"one pose given for scan {int(drive.frames[row])}",
    )
