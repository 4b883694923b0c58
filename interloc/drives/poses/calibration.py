"""Rigid calibrations between camera, LiDAR and IMU, in the files of KITTI and KITTI-360."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import MAX_NUMBER, SourceFile
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.lines import orthonormalised, rotation_complaint
from interloc.geometry import invert_transform

IMU_CALIBRATION = "calib_imu_to_velo.txt"
"""From the IMU to the LiDAR."""

CAMERA_CALIBRATIONS = ("calib.txt", "calib_velo_to_cam.txt", "calib_cam_to_velo.txt")
"""From the LiDAR to the camera."""

CAMERA_TO_POSE = "calib_cam_to_pose.txt"
"""KITTI-360's, from the camera to the IMU."""

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


def locate_calibration(parts: DriveParts, *names: str) -> Path | None:
    """Return the calibration file of one of some names that lies nearest to a drive, or None."""
    for place in parts.calibration:
        for name in names:
            path = place if place.name == name else place / name
            if path.is_file():
                return path
    return None


def find_camera_calibration(parts: DriveParts) -> tuple[SourceFile, FloatArray] | None:
    """Return the file and T_cam_lidar of a drive, or None where it has none.

    Raises
    ------
    DriveError
        The file is damaged, or its transform is not rigid.
    """
    path = locate_calibration(parts, *CAMERA_CALIBRATIONS)
    if path is None:
        return None
    file = parts.file(path)
    if path.name == "calib.txt":
        return file, _read_keyed(file, _TR_KEYS)
    if path.name == "calib_velo_to_cam.txt":
        return file, read_rt(file)
    return file, invert_transform(_transform(file, file.text().split(), 1))


def find_camera_to_pose(parts: DriveParts) -> tuple[SourceFile, FloatArray] | None:
    """Return the file and T_imu_cam of KITTI-360's calib_cam_to_pose.txt, or None where it has none."""
    path = locate_calibration(parts, CAMERA_TO_POSE)
    return None if path is None else (parts.file(path), _read_keyed(parts.file(path), ("image_00",)))


def find_kitti360_imu(parts: DriveParts) -> FloatArray | None:
    """Return T_lidar_imu of a drive of KITTI-360, or None where its calibration is not there.

    The angles of its OXTS are those of an IMU with y left and z up, its poses and calib_cam_to_pose.txt those of one
    with y right and z down: half a turn about x lies between.
    """
    camera, to_pose = find_camera_calibration(parts), find_camera_to_pose(parts)
    if parts.layout != "kitti360" or camera is None or to_pose is None:
        return None
    T_down_lidar = to_pose[1] @ camera[1]
    return invert_transform(np.diag([1.0, -1.0, -1.0, 1.0]) @ T_down_lidar)


def read_rt(file: SourceFile) -> FloatArray:
    """Read the lines "R: 9 numbers" and "T: 3 numbers" of a KITTI raw calibration, such as calib_imu_to_velo.txt."""
    lines = _keyed_lines(file)
    missing = [key for key in ("R", "T") if key not in lines]
    if missing:
        raise file.fault(f"has no line '{missing[0]}:'. Expected 'R:' with 9 and 'T:' with 3 numbers.")
    (r_line, r), (t_line, t) = lines["R"], lines["T"]
    if len(r) != 9 or len(t) != 3:
        raise file.fault("expected 'R:' with 9 and 'T:' with 3 numbers.", r_line if len(r) != 9 else t_line)
    return _transform(file, [*r[:3], t[0], *r[3:6], t[1], *r[6:], t[2]], r_line)


def _read_keyed(file: SourceFile, keys: tuple[str, ...]) -> FloatArray:
    lines = _keyed_lines(file)
    key = next((key for key in keys if key in lines), None)
    if key is None:
        raise file.fault(
            f"has no line {keys[0]!r}. Expected '{keys[0]}: ' and the 12 numbers of a 3x4 transform. "
            "Usual cause: the calib.txt of KITTI's images only; SemanticKITTI's and the odometry benchmark's have it."
        )
    number, fields = lines[key]
    return _transform(file, fields, number)


def _keyed_lines(file: SourceFile) -> dict[str, tuple[int, list[str]]]:
    """Return line number and fields of every "key: numbers" line."""
    lines: dict[str, tuple[int, list[str]]] = {}
    for number, text in enumerate(file.lines(), start=1):
        key, colon, rest = text.partition(":")
        if colon:
            lines[key.strip()] = number, rest.split()
    return lines


def _transform(file: SourceFile, fields: list[str], line: int) -> FloatArray:
    if len(fields) != 12:
        raise file.fault(f"{len(fields)} numbers; expected 12 (a 3x4 matrix).", line)
    transform = np.eye(4)
    transform[:3] = np.array(file.numbers(fields, line)).reshape(3, 4)
    if np.abs(transform[:3, 3]).max() > MAX_NUMBER:
        raise file.fault("the sensors are thousands of km apart. Expected metres.", line)
    proper, bad = orthonormalised(transform[None])
    if bad is not None:
        raise file.fault(rotation_complaint(transform[:3, :3]), line)
    calibrated: FloatArray = proper[0]
    return calibrated
