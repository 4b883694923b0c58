"""KITTI raw: ``velodyne_points/data/``, ``oxts/data/``, calibration beside or one folder above."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from interloc.drives.parts import DriveParts, existing


def find_parts(root: Path, labels: str, scan_folders: Collection[str]) -> DriveParts | None:
    """Return the parts of a raw drive, or None where the folder is none."""
    if "velodyne_points/data" not in scan_folders:
        return None
    return DriveParts(
        layout="kitti_raw",
        root=root,
        scans=root / "velodyne_points" / "data",
        labels=root / labels,
        poses=existing(root / "poses.txt"),
        times=existing(root / "velodyne_points" / "timestamps.txt", root / "oxts" / "timestamps.txt"),
        calibration=(root, root.absolute().parent),
        oxts=existing(root / "oxts"),
        geo=existing(root / "geo.csv"),
    )
