"""Detections of keyframes in the tables of a run, georeferenced where the drive is (paper, eq. 13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from interloc.drives.drive import Georeference
from interloc.errors import GeoreferenceError
from interloc.geometry import Array, bearing_deg, lonlat_from_enu, rotate_2d, yaw_of
from interloc.results import DetectionTable, KeyframeTable


@dataclass(frozen=True)
class KeyframeDetections:
    """What the detector found at one keyframe.

    Attributes
    ----------
    index : int
        Position of the scan in the drive, 0..N-1.
    frame : int
        Scan number.
    time_s : float or None
        Time of the scan, seconds.
    T_world_lidar : (4, 4) float64
        Pose of the LiDAR in W.
    lidar_xy : (n, 2) float64
        Detections in L levelled (origin at the LiDAR, x along its heading), metres (paper, eq. 12).
    world_xy : (n, 2) float64
        The same in W, metres.
    branch_angles_rad : sequence of n (B,) float64
        Directions of the branches in W, counter-clockwise from +x, leaving the intersection.
    score : (n,) float64
        0..1, how sure the detector is.
    """

    index: int
    frame: int
    time_s: float | None
    T_world_lidar: Array
    lidar_xy: Array
    world_xy: Array
    branch_angles_rad: Sequence[Array]
    score: Array

    def __len__(self) -> int:
        return len(self.score)


def build_tables(
    keyframes: Sequence[KeyframeDetections], georeference: Georeference | None
) -> tuple[KeyframeTable, DetectionTable]:
    """Bring the detections of a run into columns, each placed on the ellipsoid by the fix of its own keyframe.

    Parameters
    ----------
    keyframes
        In the order of the drive; keyframes without detections too, since not seeing is an observation.
    georeference
        Geodetic poses of all scans of the drive; None leaves the run in local coordinates.

    Returns
    -------
    KeyframeTable, DetectionTable
        No detection belongs to an intersection yet (-1).

    Raises
    ------
    GeoreferenceError
        The georeference has no fix for a keyframe.

    Notes
    -----
    Paper, eq. 13, with the fix as the origin of a local east-north-up frame: p_enu = R(yaw) p_L. The drift of the
    poses over the drive thereby never reaches the map; only their error within one window does. Directions in W turn
    into directions in ENU by the difference of the two headings of that keyframe.
    """
    poses = np.array([k.T_world_lidar for k in keyframes], dtype=np.float64).reshape(-1, 4, 4)
    world_yaw = yaw_of(poses[:, :3, :3])
    counts = np.array([len(k) for k in keyframes], dtype=np.int64)
    keyframe = np.repeat(np.arange(len(keyframes), dtype=np.int64), counts)
    lidar_xy = _stack([k.lidar_xy for k in keyframes])
    fixes = None if georeference is None else _fixes(keyframes, georeference)

    turn = np.zeros(len(keyframes))  # from W to the frame of the bearings
    lonlat_keyframes = lonlat_detections = enu_yaw = None
    if fixes is not None:
        lat, lon, enu_yaw = fixes
        turn = enu_yaw - world_yaw
        lonlat_keyframes = np.stack([lon, lat], axis=-1)
        enu_xy = rotate_2d(lidar_xy, enu_yaw[keyframe])
        lonlat_detections = lonlat_from_enu(lat[keyframe], lon[keyframe], enu_xy)
    angles = [
        np.asarray(a, dtype=np.float64) + turn[row] for row, k in enumerate(keyframes) for a in k.branch_angles_rad
    ]

    keyframe_table = KeyframeTable(
        frame=np.array([k.frame for k in keyframes], dtype=np.int64),
        time_s=np.array([np.nan if k.time_s is None else k.time_s for k in keyframes], dtype=np.float64),
        world_xy=poses[:, :2, 3].copy(),
        world_yaw_rad=world_yaw,
        lonlat=lonlat_keyframes,
        enu_yaw_rad=enu_yaw,
    )
    detection_table = DetectionTable(
        keyframe=keyframe,
        lidar_xy=lidar_xy,
        world_xy=_stack([k.world_xy for k in keyframes]),
        lonlat=lonlat_detections,
        bearings_deg=[bearing_deg(a) for a in angles],
        score=np.concatenate([np.zeros(0), *(k.score for k in keyframes)]),
        intersection=np.full(len(keyframe), -1, dtype=np.int64),
    )
    return keyframe_table, detection_table


def trajectory(T_world_lidar: Array, georeference: Georeference | None) -> tuple[Array, Array | None]:
    """Return the track of the LiDAR over all N scans: (N, 2) in W, metres, and (N, 2) longitude, latitude or None."""
    world_xy = np.asarray(T_world_lidar, dtype=np.float64)[:, :2, 3].copy()
    if georeference is None:
        return world_xy, None
    return world_xy, np.stack([georeference.lon_deg, georeference.lat_deg], axis=-1)


def _fixes(keyframes: Sequence[KeyframeDetections], georeference: Georeference) -> tuple[Array, Array, Array]:
    """Return latitude and longitude in degrees and heading from east of each keyframe, (K,) each."""
    rows: NDArray[np.int64] = np.array([k.index for k in keyframes], dtype=np.int64)
    if rows.size and rows.max() >= len(georeference.lat_deg):
        missing = keyframes[int(np.argmax(rows >= len(georeference.lat_deg)))]
        raise GeoreferenceError(
            f"{georeference.source}: {len(georeference.lat_deg)} fixes, but scan {missing.frame} is number "
            f"{missing.index + 1} of the drive. Every scan needs a fix. Usual cause: the georeference of another drive."
        )
    return georeference.lat_deg[rows], georeference.lon_deg[rows], yaw_of(georeference.R_enu_lidar[rows])


def _stack(columns: Sequence[Array]) -> Array:
    """Concatenate (n, 2) arrays, none of them too."""
    return np.concatenate([np.zeros((0, 2)), *(np.asarray(c, dtype=np.float64).reshape(-1, 2) for c in columns)])
