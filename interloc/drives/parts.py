"""The parts of a drive on disk, whatever its layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

LayoutName = Literal["semantickitti", "kitti_raw", "kitti360"]
PoseOwner = Literal["camera", "lidar", "imu", "oxts"]
"""Whose poses a drive has; those of OXTS are the LiDAR's, taken from the georeference."""

ScanFolder = Literal["velodyne", "velodyne_points/data"]
SCAN_FOLDERS: tuple[ScanFolder, ...] = ("velodyne", "velodyne_points/data")
"""Where the layouts have their scans."""


@dataclass(frozen=True)
class DriveParts:
    """Files and folders of a drive, as its layout names them; they are not looked into yet.

    Attributes
    ----------
    layout : {"semantickitti", "kitti_raw", "kitti360"}
    root : Path
        Folder of the drive.
    scans, labels : Path
        Folders of .bin and .label files.
    poses : Path or None
        Pose lines; None where the poses come from OXTS.
    times : Path or None
        Seconds, or date and time, one line a frame.
    calibration : tuple of Path
        Calibration files, or folders that they may lie in, the nearest first.
    oxts, geo : Path or None
        Georeference of the drive: folder of OXTS files or file of OXTS rows; geo.csv.
    name : str
        Of the drive, where it is not that of the folder.
    pose_frame : tuple of str and str, or None
        Whose poses the pose file holds, and why, where that was found out before.
    """

    layout: LayoutName
    root: Path
    scans: Path
    labels: Path
    poses: Path | None
    times: Path | None
    calibration: tuple[Path, ...]
    oxts: Path | None
    geo: Path | None
    name: str = ""
    pose_frame: tuple[PoseOwner, str] | None = None

    @property
    def drive_name(self) -> str:
        """Name of the drive."""
        return self.name or self.root.absolute().name


def existing(*paths: Path) -> Path | None:
    """Return the first path that exists."""
    return next((path for path in paths if path.exists()), None)
