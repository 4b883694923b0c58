"""KITTI-360: scans in ``velodyne/`` or ``velodyne_points/data/``, and pose lines that start with the frame number.

KITTI-360 publishes the poses of the left camera (``cam0_to_world.txt``) and of the IMU (``poses.txt``).
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from interloc.drives.parts import SCAN_FOLDERS, DriveParts, existing
from interloc.drives.poses import INDEXED_LENGTHS


def find_parts(root: Path, labels: str, scan_folders: Collection[str]) -> DriveParts | None:
    """Return the parts of a drive with frame numbers in its pose lines, or None where the folder is none."""
    scans = next((root / folder for folder in SCAN_FOLDERS if folder in scan_folders), None)
    poses = existing(root / "poses.txt", root / "cam0_to_world.txt")
    if scans is None or poses is None or _fields_of_first_line(poses) not in INDEXED_LENGTHS:
        return None
    above = root.absolute().parent
    return DriveParts(
        layout="kitti360",
        root=root,
        scans=scans,
        labels=root / labels,
        poses=poses,
        times=existing(root / "times.txt", scans.parent / "timestamps.txt"),
        calibration=(root, root / "calibration", above, above / "calibration", above.parent / "calibration"),
        oxts=existing(root / "oxts"),
        geo=existing(root / "geo.csv"),
    )


def _fields_of_first_line(path: Path) -> int:
    """Count the numbers of the first line; 0 where it cannot be read (its reader will say why)."""
    try:
        with path.open("rb") as file:
            return len(file.readline(4096).split())
    except OSError:
        return 0
