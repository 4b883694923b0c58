"""A drive in a folder: poses in memory, points read scan by scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference, GroundPoints
from interloc.drives.options import LayoutName
from interloc.drives.scans.labels import LabelScheme


class GroundSource(Protocol):
    """Where the ground points of a drive are read from: raw scans with labels, or a reduced drive."""

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan.

        Raises
        ------
        DriveError
            Its files are missing, damaged or do not fit together.
        """
        ...

    def name(self, frame: int) -> str:
        """Name the file of a scan in messages."""
        ...


@dataclass(frozen=True)
class FolderDrive:
    """A drive on disk; a `Drive`.

    It holds arrays and paths only, so it is cheap to send to another process.

    Attributes
    ----------
    root : Path
        Folder of the drive.
    name : str
        Name of the folder, or of the one that a reduced drive was made of.
    layout : {"semantickitti", "kitti_raw", "kitti360"}
    frames : (N,) int64
        Scan numbers, ascending.
    T_world_lidar : (N, 4, 4) float64
        Pose of the LiDAR at each scan; W is the LiDAR at the first scan.
    times_s : (N,) float64 or None
        Seconds.
    georeference : Georeference or None
    ground : GroundSource
        Where the points come from.
    scheme : LabelScheme
        Which label ids are road.
    pose_frame, pose_frame_reason : str
        Whose poses the pose file holds ("camera", "lidar", "imu", "oxts"), and why that is thought.
    """

    root: Path
    name: str
    layout: LayoutName
    frames: IntArray
    T_world_lidar: FloatArray
    times_s: FloatArray | None
    georeference: Georeference | None
    ground: GroundSource
    scheme: LabelScheme
    pose_frame: str
    pose_frame_reason: str

    def ground_points(self, index: int) -> GroundPoints:
        """Read the road points, and the points most often confused with them, of the scan at a position 0..N-1.

        Raises
        ------
        DriveError
            The files of the scan are missing, damaged or do not fit together, or a reduced drive did not keep it.
        """
        return self.ground.read(int(self.frames[index]))
