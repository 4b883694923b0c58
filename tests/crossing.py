"""A street with one crossing, as road points, as a drive with its OXTS, and as a map."""

import gzip
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from interloc.config import DetectorConfig
from interloc.drives.folder import FolderDrive
from interloc.geometry import lonlat_from_enu
from interloc.live.scan import LiveScan, play
from tests.osm_files import osm_text
from tests.small_drives import level_poses, oxts_lines, pose_text, write_scan

SPACING_M = 2.5


def paused(
    drive: FolderDrive, config: DetectorConfig, frame: int, pause: Callable[[], object], after: int
) -> Iterator[LiveScan]:
    """Play a drive from behind a scan on, and call `pause` before a frame."""
    for scan in play(drive, config, after=after):
        if scan.frame == frame:
            pause()
        yield scan


def road_at(x_m: float) -> np.ndarray:
    """Road points of a crossing 60 m from the start, seen within 35 m from a vehicle on one of its streets."""
    x, y = np.meshgrid(np.arange(-48, 176, 0.8), np.arange(-48, 48, 0.8))
    seen = (np.hypot(x - x_m, y) < 35) & ((np.abs(y) < 5) | (np.abs(x - 60) < 5))
    return np.stack([x[seen] - x_m, y[seen], np.full(int(seen.sum()), -1.73)], axis=1).astype(np.float32)


def write_drive(root: Path, raw: Path) -> None:
    """Write a drive through the crossing, with the OXTS of a raw drive beside, and its map."""
    (raw / "oxts" / "data").mkdir(parents=True)
    (raw / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
    poses = level_poses(SPACING_M * np.arange(48))
    for frame, row in enumerate(oxts_lines(poses, T_lidar_imu=np.eye(4))):
        write_scan(root, frame, np.pad(road_at(SPACING_M * frame), ((0, 0), (0, 1))), 40)
        (raw / f"oxts/data/{frame:010d}.txt").write_text(row + "\n")
    (root / "poses.txt").write_text(pose_text(poses))
    ends = lonlat_from_enu(49.0, 8.4, np.array([(0.0, 0.0), (60, 0), (240, 0), (60, -100), (60, 100)]))
    with gzip.open("map.osm.gz", "wt") as file:
        file.write(osm_text(ends, [(1, 2, 3), (4, 2, 5)]))
