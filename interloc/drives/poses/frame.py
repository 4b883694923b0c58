"""Whose poses a pose file holds, the camera's (KITTI) or the LiDAR's (most LiDAR odometries), and what leads between.

A vehicle moves where it looks. In the frame of a camera (x right, y down, z forward) it moves along z and turns about
y; in that of a LiDAR (x forward, y left, z up) it moves along x and turns about z. Hills do not matter: the
vehicle, and its sensors with it, pitches along. Calibrations are those of KITTI and KITTI-360.
"""

from pathlib import Path
from typing import Literal

import numpy as np

from interloc.arrays import FloatArray
from interloc.drives.files import MAX_NUMBER, SourceFile
from interloc.drives.findings import Findings
from interloc.drives.layouts import DriveParts, PoseOwner
from interloc.drives.options import PoseFrame
from interloc.drives.poses.files import orthonormalised, rotation_complaint
from interloc.drives.poses.motion import MIN_MOTION_M, TURNED_RAD, body_motion
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

Frame = Literal["camera", "lidar", "imu"]

_CLEAR = 0.65
_STEADY = 0.8
_ENOUGH_M = 20.0

_DEVICES = {"camera": "camera", "lidar": "LiDAR", "imu": "IMU", "oxts": "LiDAR"}
_USUAL_CONTRADICTION = {
    "lidar": "poses.txt of KITTI and SemanticKITTI, which are camera poses (those of kiss-icp are not)",
    "camera": "poses of a LiDAR odometry, or poses that were already multiplied by the calibration",
}


def locate_calibration(parts: DriveParts, *names: str) -> Path | None:
    """Return the calibration file of one of some names that lies nearest to a drive, or None."""
    for place in parts.calibration:
        for name in names:
            path = place if place.name == name else place / name
            if path.is_file():
                return path
    return None


def find_camera_calibration(parts: DriveParts) -> tuple[SourceFile, FloatArray] | None:
    """Return the file and T_cam_lidar of a drive, or None where it has none."""
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


def guess_frame(poses: FloatArray) -> tuple[Frame | None, str]:
    """Guess whose (P, 4, 4) poses of a file these are, and say why; None where the motion leaves it open."""
    motion = body_motion(poses)
    if motion is None:
        return None, f"the vehicle moves less than {MIN_MOTION_M:g} m, which does not distinguish camera from LiDAR"
    if motion.along[2] > _CLEAR:
        return "camera", f"{motion.describe()}, as a camera that looks ahead (z forward, y down)"
    if motion.along[2] < 1 - _CLEAR:
        return "lidar", f"{motion.describe()}, as a LiDAR (x forward, z up)"
    if motion.turned_rad > TURNED_RAD and motion.turning_axis in "yz":
        frame: Frame = "camera" if motion.turning_axis == "y" else "lidar"
        return (
            frame,
            f"it turns about its {motion.turning_axis} axis, as a {'camera' if frame == 'camera' else 'LiDAR'}",
        )
    return None, f"{motion.describe()}, which fits neither a camera nor a LiDAR"


def to_lidar(
    poses: FloatArray, parts: DriveParts, file: SourceFile, declared: PoseFrame, findings: Findings
) -> tuple[FloatArray, PoseOwner, str]:
    """Turn the (P, 4, 4) poses of a file into those of the LiDAR in the world of the file.

    Calibrations are looked for among the parts, which also say whose poses these are where that is settled; findings
    get the doubts about the guess. Returns also whose poses the file holds, and why that is thought.
    """
    _look_for_inverted(poses, file, findings)
    owner: PoseOwner
    if parts.pose_frame is None:
        owner, why = _decide(poses, parts, file, declared, findings)
    else:
        owner, why = parts.pose_frame
        if declared not in {"auto", owner}:
            raise file.fault(
                f"declared as poses of the {_DEVICES[declared]} (pose frame {declared!r}), but the drive was reduced "
                f"with them as those of the {_DEVICES[owner]} ({why}), and its scans were chosen accordingly. "
                f"Give pose frame 'auto', or reduce the drive again with pose frame {declared!r}."
            )
    if owner == "camera":
        return _from_camera(poses, parts, file, why), owner, why
    if owner == "imu":
        return _from_imu(poses, parts, file), owner, why
    return poses, owner, why


def _decide(
    poses: FloatArray, parts: DriveParts, file: SourceFile, declared: PoseFrame, findings: Findings
) -> tuple[Frame, str]:
    guess, why = guess_frame(poses)
    if declared != "auto":
        if guess is not None and guess != declared:
            raise file.fault(
                f"declared as poses of the {_DEVICES[declared]} (pose frame {declared!r}), but they are those of the "
                f"{_DEVICES[guess]}: {why}. Give pose frame 'auto' or {guess!r}. "
                f"Usual cause: {_USUAL_CONTRADICTION[declared]}."
            )
        return declared, f"declared so ({why})"
    if guess is None:
        has_calibration = find_camera_calibration(parts) is not None
        guess = "camera" if has_calibration else "lidar"
        calibration = "there is a camera calibration" if has_calibration else "there is no camera calibration"
        why = f"{why}; {calibration}, so they are taken for {guess} poses"
        findings.note(file.name, f"{why}. Name the pose frame (camera or lidar) if that is wrong.")
    if guess == "lidar" and parts.layout == "kitti360" and float(np.median(poses[:, 2, 2])) < -0.7:
        return "imu", f"{why}, but its z axis points down, as KITTI-360's IMU"
    return guess, why


def _look_for_inverted(poses: FloatArray, file: SourceFile, findings: Findings) -> None:
    """Refuse poses of the world in the vehicle: they move in ever other directions, and their inverses do not."""
    motion = body_motion(poses)
    if motion is None or motion.distance_m < _ENOUGH_M:
        return
    inverse = body_motion(invert_transform(poses))
    if inverse is not None and motion.steadiness < _STEADY and inverse.steadiness > max(0.9, motion.steadiness + 0.1):
        raise file.fault(
            "holds inverted poses: read as they are, the vehicle slides sideways through its turns; inverted, it "
            "drives straight ahead. Expected the pose of the sensor in the world (p_world = T p_sensor). "
            "Usual cause: transforms from the world to the sensor; invert each."
        )
    if motion.forward < -_STEADY:
        findings.warning(
            file.name,
            f"the vehicle drives backwards: along -{motion.axis} of its own frame. "
            "Usual cause: inverted poses, or a sensor that is mounted backwards.",
        )


def _from_camera(poses: FloatArray, parts: DriveParts, file: SourceFile, why: str) -> FloatArray:
    """Return the LiDAR poses of camera poses: T_world_lidar = P Tr."""
    found = find_camera_calibration(parts)
    if found is None:
        raise file.fault(
            f"holds camera poses ({why}), and there is no calib.txt to turn them into LiDAR poses. "
            "Put the calib.txt of the sequence beside poses.txt (its line 'Tr:' is needed), "
            "or give pose frame 'lidar' if they are the LiDAR's after all."
        )
    calibration, T_cam_lidar = found
    lidar = poses @ T_cam_lidar
    before, after = body_motion(poses), body_motion(lidar)
    if before is not None and after is not None and before.axis == "z" and after.axis != "x":
        raise calibration.fault(
            f"does not lead from the LiDAR to the camera: with it the LiDAR moves along its {after.axis} axis, not x. "
            "Expected 'Tr' that maps points of the LiDAR (x forward, z up) into the camera (z forward, y down). "
            "Usual cause: the inverse transform, or an identity as a placeholder."
        )
    return lidar


def _from_imu(poses: FloatArray, parts: DriveParts, file: SourceFile) -> FloatArray:
    """Return the LiDAR poses of KITTI-360's IMU poses: T_world_lidar = P T_imu_cam T_cam_lidar."""
    camera, to_pose = find_camera_calibration(parts), find_camera_to_pose(parts)
    if camera is None or to_pose is None:
        raise file.fault(
            "holds poses of KITTI-360's IMU (x forward, z down), and no calibration leads from there to the LiDAR. "
            "Put calib_cam_to_velo.txt and calib_cam_to_pose.txt of KITTI-360 beside it."
        )
    return poses @ to_pose[1] @ camera[1]
