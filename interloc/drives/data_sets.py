"""Public data sets that are not read as they are unpacked: their signs, and the way out."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from itertools import islice
from pathlib import Path

_MAX_LOOKED_AT, _MAX_BYTES = 20_000, 16 * 1024 * 1024
_WRITE = (
    "Write each scan as float32 x y z remission to velodyne/000000.bin, 000001.bin, ... (NumPy: tofile), and the pose "
    "of the LiDAR at each, 12 numbers per line, to poses.txt. "
)
_SIGNS = {
    r"lidar/\d+\.pkl(\.gz)?": (
        "PandaSet: pandas.read_pickle reads a scan, which lidar/poses.json brings to the sensor"
    ),
    r"lidar/\d+\.feather": ("Argoverse 2: pandas.read_feather reads a scan; poses are in city_SE3_egovehicle.feather"),
    r"[^/]+\.tfrecord|lidar\w*/[^/]+\.parquet": "Waymo: its package makes the points of a segment of range images",
    r"pose/\d+\.txt": (
        "Waymo in KITTI's form: take one segment. Its scans are read as they are, six values per point, from "
        "velodyne/; the first 12 numbers of each file in pose/ are a line of poses.txt"
    ),
    r"pose/\d+\.json": "View of Delft: take one drive; the pose of each scan is in pose/",
    r"(samples|sweeps)/LIDAR_TOP/[^/]+|v1\.0-\w+/(ego_pose|scene)\.json": (
        "nuScenes: the scans of all scenes lie together in samples/LIDAR_TOP and sweeps/LIDAR_TOP (.pcd.bin, which "
        "are read as they are). Put those of one scene into a folder, and their poses by nuscenes-devkit into "
        "poses.txt"
    ),
    r"frames/frame_\d+\.ply|full_poses_lidar\.txt": (
        "KITTI-CARLA: write frames/*.ply as PCD files (x y z label), with --label-scheme 7,6 for road; each line of "
        "full_poses_lidar.txt is a pose of 12 numbers and its time"
    ),
    r"velodyne_(left|right)/\d+\.(bin|png)|velodyne_(left|right)\.timestamps": (
        "Oxford RobotCar: its .bin hold all x, then all y, z and intensity (np.fromfile(FILE, np.float32).reshape(4, "
        "-1).T); poses are in gps/ins.csv and vo/"
    ),
    r"LiDAR/(Ouster|Velodyne|Avia|Aeva)/\d+\.bin|LiDAR_GT/[^/]+": (
        "HeLiPR: its .bin hold records of 22 to 29 bytes, by the sensor; poses are in LiDAR_GT/"
    ),
    r"Ouster/\d+\.bin|sensor_data/\w+\.csv": (
        "MulRan: its .bin are named by nanoseconds, and hold float32 x y z intensity; global_pose.csv has the poses "
        "of the vehicle at other times"
    ),
    r"lidar/\d+\.bin|applanix/lidar_poses\.csv": (
        "Boreas: its .bin hold six float32 (x y z intensity ring time); poses are in applanix/lidar_poses.csv"
    ),
    r"velodyne_sync/\d+\.bin|velodyne_hits\.bin|groundtruth_\d{4}-\d\d-\d\d\.csv": (
        "NCLT: its .bin hold eight bytes per point (uint16 x y z in steps of 5 mm from -100 m, z down; uint8 "
        "intensity and laser); poses are in groundtruth_*.csv"
    ),
    r"ouster_points/(data/.+|timestamps\.txt)|\.dtype\.pkl": (
        "VBR: its .bin hold records of 29 bytes, by .dtype.pkl; its bags are read as they are, with --poses"
    ),
}
"""The ends of paths, as regular expressions -> what it is."""


def known_data_set(root: Path) -> str:
    """Return which public data set lies in a folder, or around it, and the way out, in sentences; "" for none."""
    paths = (path for depth in range(1, 6) for path in root.absolute().glob("/".join("*" * depth)))
    for path in islice(paths, _MAX_LOOKED_AT):
        for sign, what in _SIGNS.items():
            if re.search(f"(^|/)({sign})$", path.as_posix()):
                return f"It looks like {what}. {_scenes(root)}{'' if 'as they are' in what else _WRITE}"
    return ""


def _scenes(root: Path) -> str:
    """Return which scenes the tables of nuScenes name; "" where there are none."""
    with suppress(OSError, ValueError, LookupError, TypeError):
        for path in islice(root.glob("v1.0-*/scene.json"), 1):
            names = sorted(str(each["name"]) for each in json.loads(path.read_bytes()[:_MAX_BYTES]))
            more = ", ..." if len(names) > 3 else ""
            return f"{path.parent.name} names {len(names):,} scenes ({', '.join(names[:3])}{more}). " if names else ""
    return ""
