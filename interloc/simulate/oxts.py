"""Poses as KITTI's OXTS rows, and the lever arm between the IMU and the LiDAR."""

from __future__ import annotations

import numpy as np

from interloc.arrays import FloatArray
from interloc.geometry import enu_from_lonlat, invert_transform, lonlat_from_enu, rotation_from_rpy

IMU_TO_VELO_TEXT = (
    "R: 9.999976e-01 7.553071e-04 -2.035826e-03 -7.854027e-04 9.998898e-01 -1.482298e-02 "
    "2.024406e-03 1.482454e-02 9.998881e-01\nT: -8.086759e-01 3.195559e-01 -7.997231e-01\n"
)
"""`calib_imu_to_velo.txt` of KITTI's recording car."""

CALIB_TEXT = "".join(
    f"P{camera}: 7.070912000000e+02 0.000000000000e+00 6.018873000000e+02 {shift:.12e} 0.000000000000e+00 "
    "7.070912000000e+02 1.831104000000e+02 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 "
    "1.000000000000e+00 0.000000000000e+00\n"
    for camera, shift in enumerate((0.0, -379.8145, 46.88783, -333.4597))
) + (
    "Tr: 0.000000000000e+00 -1.000000000000e+00 0.000000000000e+00 0.000000000000e+00 "
    "0.000000000000e+00 0.000000000000e+00 -1.000000000000e+00 -8.000000000000e-02 "
    "1.000000000000e+00 0.000000000000e+00 0.000000000000e+00 -2.700000000000e-01\n"
)
"""A `calib.txt` for drives that have none: a camera that looks ahead, 0.27 m before and 0.08 m below the LiDAR."""


def parse_imu_to_velo(text: str) -> FloatArray:
    """Return T_velo_imu (4, 4) float64 of the text of a `calib_imu_to_velo.txt`."""
    fields = dict(line.split(":", 1) for line in text.splitlines() if ":" in line)
    transform = np.eye(4)
    transform[:3, :3] = np.array(fields["R"].split(), dtype=np.float64).reshape(3, 3)
    transform[:3, 3] = np.array(fields["T"].split(), dtype=np.float64)
    return transform


def parse_tr(text: str) -> FloatArray:
    """Return Tr = T_camera_velo (4, 4) float64 of the text of a `calib.txt`."""
    transform = np.eye(4)
    line = next(line for line in text.splitlines() if line.startswith("Tr:"))
    transform[:3] = np.array(line.split()[1:], dtype=np.float64).reshape(3, 4)
    return transform


def lidar_fixes(rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the geodetic poses of the LiDAR.

    Parameters
    ----------
    rows : (N, 6 or more) float64
        Latitude, longitude (degrees), altitude (metres), roll, pitch, yaw (radians) of the IMU.

    Returns
    -------
    lat_deg, lon_deg, alt_m : (N,) float64
    R_enu_lidar : (N, 3, 3) float64
    """
    T_imu_velo = invert_transform(parse_imu_to_velo(IMU_TO_VELO_TEXT))
    R_enu_imu = rotation_from_rpy(rows[:, 3], rows[:, 4], rows[:, 5])
    offset = R_enu_imu @ T_imu_velo[:3, 3]
    lonlat = lonlat_from_enu(rows[:, 0], rows[:, 1], offset[:, :2])
    return lonlat[:, 1], lonlat[:, 0], rows[:, 2] + offset[:, 2], R_enu_imu @ T_imu_velo[:3, :3]


def oxts_rows(
    lat_deg: FloatArray, lon_deg: FloatArray, alt_m: FloatArray, R_enu_lidar: FloatArray, times_s: FloatArray
) -> FloatArray:
    """Return (N, 30) OXTS values of an IMU that is mounted as in KITTI: `lidar_fixes` undone.

    Velocities are differences; accelerations and rates that nothing here reads are zero.
    """
    T_velo_imu = parse_imu_to_velo(IMU_TO_VELO_TEXT)
    R = R_enu_lidar @ T_velo_imu[:3, :3]
    offset = R_enu_lidar @ T_velo_imu[:3, 3]
    lonlat = lonlat_from_enu(lat_deg, lon_deg, offset[:, :2])
    rows = np.zeros((len(lat_deg), 30))
    rows[:, 0], rows[:, 1], rows[:, 2] = lonlat[:, 1], lonlat[:, 0], alt_m + offset[:, 2]
    rows[:, 3] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    rows[:, 4] = np.arcsin(np.clip(-R[:, 2, 0], -1, 1))
    rows[:, 5] = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    if len(rows) > 1:
        enu = enu_from_lonlat(rows[0, 0], rows[0, 1], lonlat)
        velocity = np.gradient(np.column_stack([enu, rows[:, 2]]), times_s, axis=0)
        rows[:, 6], rows[:, 7] = velocity[:, 1], velocity[:, 0]
        rows[:, 8:11] = np.einsum("nji,nj->ni", R, velocity)
    rows[:, 13] = 9.81
    rows[:, 23:25] = 0.02
    rows[:, 25:30] = [4, 10, 6, 6, 6]
    return rows


def format_oxts(row: FloatArray) -> str:
    """Write 30 values as one OXTS file: 25 numbers and 5 counts."""
    return " ".join([*(f"{v:.13g}" for v in row[:25]), *(str(int(v)) for v in row[25:30])]) + "\n"
