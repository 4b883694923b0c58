"""Rigid calibrations between camera, LiDAR and IMU, in the files of KITTI and KITTI-360."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import MAX_NUMBER, numbers_of, read_text, shown
from interloc.drives.findings import DriveFileError
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.lines import orthonormalised, rotation_complaint
from interloc.geometry import invert_transform

IMU_CALIBRATION = "calib_imu_to_velo.txt"

_TR_KEYS = ("Tr", "Tr_velo_to_cam", "Tr_velo_cam")

KITTI_T_VELO_IMU: FloatArray = np.array(
    [
        [9.999976e-01, 7.553071e-04, -2.035826e-03, -8.086759e-01],
        [-7.854027e-04, 9.998898e-01, -1.482298e-02, 3.195559e-01],
        [2.024406e-03, 1.482454e-02, 9.998881e-01, -7.997231e-01],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""T_lidar_imu of the KITTI car, as KITTI publishes it in calib_imu_to_velo.txt of every day of recording."""


def locate_camera_calibration(parts: DriveParts) -> Path | None:
    """Return the file that leads from the LiDAR to the camera."""
    return _locate(parts, "calib.txt", "calib_velo_to_cam.txt", "calib_cam_to_velo.txt")


def locate_imu_calibration(parts: DriveParts) -> Path | None:
    """Return the file that leads from the IMU to the LiDAR."""
    return _locate(parts, IMU_CALIBRATION)


def locate_camera_to_pose(parts: DriveParts) -> Path | None:
    """Return KITTI-360's file that leads from the camera to the IMU."""
    return _locate(parts, "calib_cam_to_pose.txt")


def _locate(parts: DriveParts, *names: str) -> Path | None:
    """Return the first file of one of some names."""
    for place in parts.calibration:
        for name in names:
            path = place if place.name == name else place / name
            if path.is_file():
                return path
    return None


def find_camera_calibration(parts: DriveParts) -> tuple[Path, FloatArray] | None:
    """Return the file and T_cam_lidar of a drive, or None where it has none.

    Raises
    ------
    DriveError
        The file is damaged, or its transform is not rigid.
    """
    path = locate_camera_calibration(parts)
    if path is None:
        return None
    if path.name == "calib.txt":
        return path, _read_keyed(path, parts.root, _TR_KEYS)
    if path.name == "calib_velo_to_cam.txt":
        return path, _read_rt(path, parts.root)
    return path, invert_transform(_read_plain(path, parts.root))


def read_imu_calibration(path: Path, root: Path) -> FloatArray:
    """Read T_lidar_imu from a calib_imu_to_velo.txt."""
    return _read_rt(path, root)


def find_camera_to_pose(parts: DriveParts) -> tuple[Path, FloatArray] | None:
    """Return the file and T_imu_cam of KITTI-360's calib_cam_to_pose.txt, or None where it has none."""
    path = locate_camera_to_pose(parts)
    return None if path is None else (path, _read_keyed(path, parts.root, ("image_00",)))


def _keyed_lines(path: Path, root: Path) -> dict[str, tuple[int, list[str]]]:
    """Return line number and fields of every "key: numbers" line."""
    lines: dict[str, tuple[int, list[str]]] = {}
    for number, text in enumerate(read_text(path, root).splitlines(), start=1):
        key, colon, rest = text.partition(":")
        if colon:
            lines[key.strip()] = number, rest.split()
    return lines


def _read_keyed(path: Path, root: Path, keys: tuple[str, ...]) -> FloatArray:
    """Read the 12 numbers after one of some keys."""
    lines = _keyed_lines(path, root)
    key = next((key for key in keys if key in lines), None)
    if key is None:
        raise DriveFileError(
            shown(path, root),
            f"has no line {keys[0]!r}. Expected '{keys[0]}: ' and the 12 numbers of a 3x4 transform. "
            "Usual cause: the calib.txt of KITTI's images only; SemanticKITTI's and the odometry benchmark's have it.",
        )
    number, fields = lines[key]
    return _transform(fields, path, root, number)


def _read_rt(path: Path, root: Path) -> FloatArray:
    """Read the lines "R: 9 numbers" and "T: 3 numbers" of a KITTI raw calibration."""
    lines = _keyed_lines(path, root)
    missing = [key for key in ("R", "T") if key not in lines]
    if missing:
        raise DriveFileError(
            shown(path, root), f"has no line '{missing[0]}:'. Expected 'R:' with 9 and 'T:' with 3 numbers."
        )
    (r_line, r), (t_line, t) = lines["R"], lines["T"]
    if len(r) != 9 or len(t) != 3:
        line = r_line if len(r) != 9 else t_line
        raise DriveFileError(shown(path, root), f"line {line}: expected 'R:' with 9 and 'T:' with 3 numbers.")
    rows = [[*r[3 * i : 3 * i + 3], t[i]] for i in range(3)]
    return _transform([field for row in rows for field in row], path, root, r_line)


def _read_plain(path: Path, root: Path) -> FloatArray:
    """Read a file that holds nothing but 12 numbers."""
    return _transform(read_text(path, root).split(), path, root, 1)


def _transform(fields: list[str], path: Path, root: Path, line: int) -> FloatArray:
    """Make a rigid transform of 12 fields."""
    if len(fields) != 12:
        raise DriveFileError(shown(path, root), f"line {line}: {len(fields)} numbers; expected 12 (a 3x4 matrix).")
    transform = np.eye(4)
    transform[:3] = np.array(numbers_of(fields, path, root, line)).reshape(3, 4)
    if np.abs(transform[:3, 3]).max() > MAX_NUMBER:
        raise DriveFileError(shown(path, root), f"line {line}: the sensors are thousands of km apart. Expected metres.")
    proper, bad = orthonormalised(transform[None])
    if bad is not None:
        raise DriveFileError(shown(path, root), f"line {line}: {rotation_complaint(transform[:3, :3])}")
    calibrated: FloatArray = proper[0]
    return calibrated
