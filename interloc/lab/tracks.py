"""Where the LiDAR is at every scan: along OXTS rows, or along a line of longitudes and latitudes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pyproj import Proj
from scipy.ndimage import gaussian_filter1d

from interloc.arrays import FloatArray
from interloc.drives.georeference.read import georeference_of_lidar
from interloc.drives.poses.frame import KITTI_T_VELO_IMU
from interloc.errors import DriveError
from interloc.geometry import (
    enu_from_lonlat,
    invert_transform,
    lonlat_from_enu,
    rigid_transforms,
    rotation_from_rpy,
    rpy_from_rotation,
)
from interloc.lab.config import TrackConfig


class LocalFrame:
    """Frame M of a scene: x, y in metres, conformal, true to scale within 1e-7 some kilometres around its origin."""

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
_STEP_M = 0.25
_SMOOTHING_M = 3.0  # width of the Gaussian that smooths a path


def parse_tr(text: str) -> FloatArray:
    """Return Tr = T_camera_velo (4, 4) float64 of the text of a `calib.txt`."""
    transform = np.eye(4)
    line = next(line for line in text.splitlines() if line.startswith("Tr:"))
    transform[:3] = np.array(line.split()[1:], dtype=np.float64).reshape(3, 4)
    return transform


def oxts_rows(
    lat_deg: FloatArray, lon_deg: FloatArray, alt_m: FloatArray, R_enu_lidar: FloatArray, times_s: FloatArray
) -> FloatArray:
    """Return (N, 30) OXTS values of an IMU that is mounted as in KITTI: the inverse of `georeference_of_lidar`.

    Velocities are differences; accelerations and rates that nothing here reads are zero.
    """
    R = R_enu_lidar @ KITTI_T_VELO_IMU[:3, :3]
    offset = R_enu_lidar @ KITTI_T_VELO_IMU[:3, 3]
    lonlat = lonlat_from_enu(lat_deg, lon_deg, offset[:, :2])
    rows = np.zeros((len(lat_deg), 30))
    rows[:, 0], rows[:, 1], rows[:, 2] = lonlat[:, 1], lonlat[:, 0], alt_m + offset[:, 2]
    rows[:, 3:6] = rpy_from_rotation(R)
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


@dataclass(frozen=True)
class LidarTrack:
    """The poses of a drive to be."""

    lat_deg: FloatArray
    lon_deg: FloatArray
    alt_m: FloatArray
    """(N,) float64: position of the LiDAR on WGS84."""
    R_enu_lidar: FloatArray
    """(N, 3, 3) float64: its attitude in the east-north-up frame at the fix."""
    times_s: FloatArray
    """(N,) float64."""
    oxts: FloatArray
    """(N, 30) float64: OXTS values of the IMU, written with the drive."""
    poses_camera: FloatArray | None = None
    """(N, 3, 4) float64 or None: camera-frame poses to be written; None: those of the track itself."""
    calib_text: str = CALIB_TEXT
    """The `calib.txt` that goes with them."""

    def __len__(self) -> int:
        return len(self.lat_deg)

    def frame(self) -> LocalFrame:
        """Return a plane about the middle of the track."""
        return LocalFrame((self.lat_deg.min() + self.lat_deg.max()) / 2, (self.lon_deg.min() + self.lon_deg.max()) / 2)

    def T_map_lidar(self, frame: LocalFrame) -> FloatArray:
        """Return (N, 4, 4) poses in the plane of a scene, with the altitude as height."""
        xy = frame.xy(np.column_stack([self.lon_deg, self.lat_deg]))
        R_map_lidar = frame.R_map_enu(self.lat_deg, self.lon_deg) @ self.R_enu_lidar
        return rigid_transforms(R_map_lidar, np.column_stack([xy, self.alt_m]))


def track_from_oxts(rows: FloatArray, times_s: FloatArray) -> LidarTrack:
    """Take the track of a GNSS/INS: (N, 30) OXTS values of the IMU, one row per scan, and the (N,) times of them."""
    fixes = georeference_of_lidar(rows, KITTI_T_VELO_IMU, "OXTS")
    return LidarTrack(fixes.lat_deg, fixes.lon_deg, fixes.alt_m, fixes.R_enu_lidar, times_s, rows)


def track_from_line(
    lonlat: FloatArray, alt_m: FloatArray | None = None, config: TrackConfig | None = None
) -> LidarTrack:
    """Drive along a line at a constant speed, looking ahead.

    `lonlat` are (N, 2) longitudes, latitudes in degrees of at least two points, metres to tens of metres apart, `alt_m`
    (N,) heights of the LiDAR (None: flat ground). It follows the smoothed line: yaw along it, pitch along its slope, no
    roll.
    """
    config = config or TrackConfig()
    lonlat = np.asarray(lonlat, dtype=np.float64).reshape(-1, 2)
    if len(lonlat) < 2:
        raise DriveError(f"The track has {len(lonlat)} point(s). Expected at least two.")
    frame = LocalFrame(lonlat[:, 1].mean(), lonlat[:, 0].mean())
    xyz = np.column_stack([frame.xy(lonlat), np.zeros(len(lonlat)) if alt_m is None else alt_m])
    path = smooth_path(xyz, config.offset_m)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
    wanted = np.arange(0.0, along[-1], config.speed_mps / config.rate_hz)
    places = np.column_stack([np.interp(wanted, along, path[:, i]) for i in range(3)])
    reach = 1.0
    ahead = np.column_stack([np.interp(np.minimum(wanted + reach, along[-1]), along, path[:, i]) for i in range(3)])
    behind = np.column_stack([np.interp(np.maximum(wanted - reach, 0.0), along, path[:, i]) for i in range(3)])
    run = ahead - behind
    yaw = np.unwrap(np.arctan2(run[:, 1], run[:, 0]))
    pitch = -np.arctan2(run[:, 2], np.hypot(run[:, 0], run[:, 1]))
    back = frame.lonlat(places[:, :2])
    lon, lat = back[:, 0], back[:, 1]
    R_map_lidar = rotation_from_rpy(0.0, pitch, yaw)
    R_enu_lidar = np.swapaxes(frame.R_map_enu(lat, lon), -1, -2) @ R_map_lidar
    times = np.arange(len(wanted)) / config.rate_hz
    rows = oxts_rows(lat, lon, places[:, 2], R_enu_lidar, times)
    return LidarTrack(lat, lon, places[:, 2], R_enu_lidar, times, rows)


def smooth_path(xyz: FloatArray, offset_m: float = 0.0) -> FloatArray:
    """Resample a line, (N, 3) metres, move it to the right by an offset, and round its corners by a Gaussian along it.

    The points returned are some 0.25 m apart. The ends stay.
    """
    keep = np.concatenate([[True], np.hypot(*np.diff(xyz[:, :2], axis=0).T) > 1e-6])
    xyz = xyz[keep]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xyz[:, :2], axis=0).T))])
    fine = np.linspace(0.0, along[-1], max(int(along[-1] / _STEP_M) + 1, 2))
    path = np.column_stack([np.interp(fine, along, xyz[:, i]) for i in range(3)])
    if offset_m:
        run = np.gradient(gaussian_filter1d(path[:, :2], 4, axis=0, mode="nearest"), axis=0)
        run /= np.maximum(np.hypot(run[:, 0], run[:, 1]), 1e-9)[:, None]
        path[:, :2] += offset_m * np.column_stack([run[:, 1], -run[:, 0]])
    # Mirrored about its ends as points, so that the line keeps them.
    width = min(_SMOOTHING_M / _STEP_M, len(path) / 4)
    reach = min(int(4 * width) + 1, len(path) - 1)
    longer = np.pad(path, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    smooth: FloatArray = gaussian_filter1d(longer, width, axis=0, mode="nearest")
    return smooth[reach:-reach]


def camera_poses(T_map_lidar: FloatArray, tr: FloatArray) -> FloatArray:
    """Return (N, 3, 4) KITTI poses: camera at each scan in the frame of the first camera."""
    T_world_lidar = invert_transform(T_map_lidar[:1]) @ T_map_lidar
    return (tr @ T_world_lidar @ invert_transform(tr))[:, :3]


def lidar_poses(poses_camera: FloatArray, tr: FloatArray) -> FloatArray:
    """Return (N, 4, 4) T_world_lidar of (N, 3, 4) KITTI poses."""
    return invert_transform(tr) @ rigid_transforms(poses_camera[:, :, :3], poses_camera[:, :, 3]) @ tr
