"""The parts of a drive on disk, whatever its layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

LayoutName = Literal["semantickitti", "kitti_raw", "kitti360"]


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
        Folders that calibration files may lie in, the nearest first.
    oxts, geo : Path or None
        Georeference that lies in the drive.
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


def existing(*paths: Path) -> Path | None:
    """Return the first path that exists."""
    return next((path for path in paths if path.exists()), None)
