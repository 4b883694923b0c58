"""SemanticKITTI and KITTI odometry: ``velodyne/``, ``labels/`` or ``predictions/``, ``poses.txt``, ``calib.txt``."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from interloc.drives.parts import DriveParts, existing


def find_parts(root: Path, labels: str, scan_folders: Collection[str]) -> DriveParts | None:
    """Return the parts of a sequence, or None where the folder is none."""
    if "velodyne" not in scan_folders:
        return None
    return DriveParts(
        layout="semantickitti",
        root=root,
        scans=root / "velodyne",
        labels=root / labels,
        poses=root / "poses.txt",
        times=existing(root / "times.txt"),
        calibration=(root,),
        oxts=existing(root / "oxts"),
        geo=existing(root / "geo.csv"),
    )
