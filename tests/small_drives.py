"""Small drives on disk: a road on a plane, seen by a LiDAR 1.73 m above it; and the beginning of a real drive."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import ArrayLike

from interloc.arrays import Float32Array, FloatArray, UInt32Array
from interloc.config import KeyframeConfig
from interloc.drives.folder import FolderDrive
from interloc.drives.open import open_drive
from interloc.errors import DriveError
from interloc.geometry import invert_transform, rotation_from_rpy
from interloc.pipeline import detect
from interloc.reduction.reduce import reduce_drive
from interloc.results import DriveResult

SENSOR_HEIGHT_M = 1.73

T_CAM_LIDAR = np.array(
    [[0.0, -1.0, 0.0, -0.004], [0.0, 0.0, -1.0, -0.076], [1.0, 0.0, 0.0, -0.27], [0.0, 0.0, 0.0, 1.0]]
)
"""Like KITTI's: the camera looks ahead, a little in front of and below the LiDAR."""

T_LIDAR_IMU = np.eye(4)
T_LIDAR_IMU[:3, 3] = -0.8, 0.3, -0.8
CALIBRATION = "R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n"
"""Of a raw drive, as calib_imu_to_velo.txt has it."""

IDS = {"semantickitti": (40, 48, 70), "learning": (9, 11, 15), "kitti360": (7, 8, 21)}
"""Road, sidewalk, vegetation."""


def level_poses(x_m: ArrayLike, y_m: ArrayLike = 0.0, yaw_rad: ArrayLike = 0.0) -> FloatArray:
    """Return the (..., 4, 4) poses of a vehicle that stands level at places, turned to the left by so much."""
    x, y, yaw = np.broadcast_arrays(x_m, y_m, yaw_rad)
    poses = np.zeros((*x.shape, 4, 4)) + np.eye(4)
    poses[..., :3, :3], poses[..., 0, 3], poses[..., 1, 3] = rotation_from_rpy(0.0, 0.0, yaw), x, y
    return poses


def lidar_poses(count: int = 12, step_m: float = 2.0, turn_rad: float = 0.03) -> FloatArray:
    """Return (N, 4, 4) poses of a vehicle that drives ahead and turns left a little at every step."""
    yaw = turn_rad * np.arange(count)
    x, y = (step_m * np.append(0.0, np.cumsum(part(yaw[:-1] + turn_rad / 2))) for part in (np.cos, np.sin))
    return level_poses(x, y, yaw)


def camera_poses(lidar: FloatArray) -> FloatArray:
    """Return the poses of the camera, in the frame of the first camera, as KITTI's poses.txt has them."""
    poses: FloatArray = T_CAM_LIDAR @ lidar @ invert_transform(T_CAM_LIDAR)
    return poses


def pose_text(poses: FloatArray, *, frames: list[int] | None = None, rows: int = 3) -> str:
    """Write pose lines: 12 numbers (rows=3) or 16 (rows=4), with frame numbers in front where given."""
    lines = []
    for index, pose in enumerate(poses):
        numbers = " ".join(f"{value:.9e}" for value in pose[:rows].ravel())
        lines.append(numbers if frames is None else f"{frames[index]} {numbers}")
    return "\n".join(lines) + "\n"


def calib_text() -> str:
    """Write a calib.txt of the odometry benchmark."""
    numbers = " ".join(f"{value:.9e}" for value in T_CAM_LIDAR[:3].ravel())
    return f"P0: {' '.join(['0.0'] * 12)}\nTr: {numbers}\n"


def scan_at(pose: FloatArray, ids: tuple[int, int, int]) -> tuple[Float32Array, UInt32Array]:
    """See the plane of W: a road around the vehicle, a sidewalk beside it, and vegetation above."""
    x, y = np.meshgrid(np.arange(-15, 15.1, 0.5), np.arange(-6, 6.1, 0.5))
    local = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -SENSOR_HEIGHT_M)])
    labels = np.where(np.abs(local[:, 1]) <= 4, ids[0], ids[1])
    bush = np.column_stack([np.linspace(-10, 10, 200), np.full(200, 7.0), np.linspace(-1, 1, 200)])
    points = np.concatenate([local, bush])
    points = np.column_stack([points, np.full(len(points), 0.3)]).astype(np.float32)
    instance = np.uint32(7 << 16)
    return points, np.concatenate([labels, np.full(200, ids[2])]).astype(np.uint32) | instance


def write_scan(root: Path, frame: int, points: FloatArray, labels: ArrayLike) -> None:
    """Write (N, 4) points and their labels, one each or one for all, as SemanticKITTI has them."""
    for folder in ("velodyne", "labels"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    points.astype(np.float32).tofile(root / f"velodyne/{frame:06d}.bin")
    np.full(len(points), labels, np.uint32).tofile(root / f"labels/{frame:06d}.label")


def write_scans(
    folder: Path, labels: Path, poses: FloatArray, ids: tuple[int, int, int], frames: list[int], digits: int
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    labels.mkdir(parents=True, exist_ok=True)
    for frame, pose in zip(frames, poses, strict=True):
        points, ids_of_points = scan_at(pose, ids)
        points.tofile(folder / f"{frame:0{digits}d}.bin")
        ids_of_points.tofile(labels / f"{frame:0{digits}d}.label")


def write_semantickitti(
    path: Path,
    *,
    poses: FloatArray | None = None,
    pose_frame: str = "camera",
    scheme: str = "semantickitti",
    labels: str = "labels",
    frames: list[int] | None = None,
    calib: bool | None = None,
) -> Path:
    """Write a sequence; `poses` are the LiDAR's, `pose_frame` says whose are written."""
    poses = lidar_poses() if poses is None else poses
    frames = list(range(len(poses))) if frames is None else frames
    write_scans(path / "velodyne", path / labels, poses, IDS[scheme], frames, digits=6)
    (path / "poses.txt").write_text(pose_text(camera_poses(poses) if pose_frame == "camera" else poses))
    if calib if calib is not None else pose_frame == "camera":
        (path / "calib.txt").write_text(calib_text())
    (path / "times.txt").write_text("".join(f"{0.1 * frame:.6e}\n" for frame in range(len(poses))))
    return path


def oxts_lines(poses: FloatArray, *, T_lidar_imu: FloatArray) -> list[str]:
    """Write the OXTS rows (30 values) of the IMU of a level vehicle that starts at a fix and looks east."""
    imu = poses @ T_lidar_imu
    rows = []
    for pose in imu:
        lat = 49.0 + np.degrees(pose[1, 3] / 6_382_000)  # good to a centimetre over the metres driven here
        lon = 8.4 + np.degrees(pose[0, 3] / (6_390_400 * np.cos(np.radians(49.0))))
        yaw = np.arctan2(pose[1, 0], pose[0, 0])
        values = [lat, lon, 110.0 + pose[2, 3], 0.0, 0.0, yaw, *([0.0] * 19)]
        rows.append(" ".join(f"{value:.12g}" for value in values) + " 4 10 6 6 6")
    return rows


def write_kitti_raw(path: Path, *, poses: FloatArray | None = None) -> Path:
    """Write a raw drive, with IMU and LiDAR 0.8 m apart."""
    poses = lidar_poses() if poses is None else poses
    frames = list(range(len(poses)))
    write_scans(path / "velodyne_points" / "data", path / "labels", poses, IDS["semantickitti"], frames, digits=10)
    (path / "oxts" / "data").mkdir(parents=True)
    for frame, row in enumerate(oxts_lines(poses, T_lidar_imu=T_LIDAR_IMU)):
        (path / "oxts" / "data" / f"{frame:010d}.txt").write_text(row + "\n")
    (path / "calib_imu_to_velo.txt").write_text(f"calib_time: 25-May-2012\n{CALIBRATION}")
    stamps = [f"2011-09-26 13:02:{25 + 0.1 * frame:012.9f}" for frame in frames]
    (path / "velodyne_points" / "timestamps.txt").write_text("\n".join(stamps) + "\n")
    return path


def geo_csv(poses: FloatArray) -> str:
    """Write a geo.csv of the LiDAR: level, starts at a fix and looks east."""
    lines = ["frame,lat_deg,lon_deg,alt_m,roll_rad,pitch_rad,yaw_rad"]
    for frame, row in enumerate(oxts_lines(poses, T_lidar_imu=np.eye(4))):
        lines.append(",".join([str(frame), *row.split()[:6]]))
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="session")
def make() -> ModuleType:
    """The functions of this module, for tests that write drives of their own."""
    return sys.modules[__name__]


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A georeferenced sequence of 12 scans, 0.9 m apart and turning little: 0, 3, 6 and 9 are keyframes."""
    poses = lidar_poses(step_m=0.9, turn_rad=0.01)
    root = write_semantickitti(tmp_path / "07", poses=poses)
    (root / "geo.csv").write_text(geo_csv(poses))
    return root


@pytest.fixture
def reduced(drive: Path, tmp_path: Path) -> Path:
    reduce_drive(drive, tmp_path / "reduced", keyframes=KeyframeConfig())
    return tmp_path / "reduced"


_SCANS = 22


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """A sound SemanticKITTI sequence of 12 scans."""
    return write_semantickitti(tmp_path / "07")


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> FolderDrive:
    """The beginning of a real drive, which passes intersections; nothing in it may be changed."""
    whole = Path(__file__).resolve().parents[2] / "shared" / "data" / "kitti360_0009"
    if not whole.exists():
        pytest.skip("real data not here: kitti360_0009")
    root = tmp_path_factory.mktemp("sample") / "beginning"
    for name in ("velodyne/{:06d}.bin", "labels/{:06d}.label"):
        (root / name).parent.mkdir(parents=True)
        for frame in range(_SCANS):
            (root / name.format(frame)).symlink_to(whole / name.format(frame))
    for name, lines in (("poses.txt", _SCANS), ("times.txt", _SCANS), ("geo.csv", _SCANS + 1)):
        text = (whole / name).read_text().splitlines(keepends=True)
        (root / name).write_text("".join(text[:lines]))
    return open_drive(root)


@pytest.fixture(scope="session")
def sample_result(sample: FolderDrive) -> DriveResult:
    """What is found in it."""
    result = detect(sample)
    assert len(result.detections) > 10
    return result


def refusal_of(call: Callable[..., object], *given: object, **options: object) -> str:
    """Return what the DriveError says that a call raises."""
    with pytest.raises(DriveError) as caught:
        call(*given, **options)
    return str(caught.value)
