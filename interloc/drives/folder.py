"""A drive in a folder: poses in memory, points read scan by scan from the store that keeps them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol, Self

import numpy as np
from pydantic import BaseModel, ConfigDict

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference, GroundPoints
from interloc.drives.findings import Findings
from interloc.drives.labels import LabelJudgement, LabelScheme
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions, LayoutName
from interloc.drives.trajectory import Trajectory


class GroundSource(Protocol):
    """Where the ground points of a drive are read from: raw scans with labels, or a reduced drive.

    Attributes
    ----------
    label_source : str
        Where the labels come from, in words.
    is_slow : bool
        A scan takes long enough (a network labels it) that several should be read at once.
    """

    @property
    def label_source(self) -> str: ...  # noqa: D102
    @property
    def is_slow(self) -> bool: ...  # noqa: D102

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan.

        Raises
        ------
        DriveError
            Its files are missing, damaged or do not fit together.
        """
        ...

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        ...


class ReducedReport(BaseModel):
    """What is left of the scans of a reduced drive.

    Attributes
    ----------
    kept_scans : int
    ground_bytes : int or None
        Size of their ground points, where the label folder has any.
    distance_m, angle_deg : float or None
        Keyframe settings by which they were chosen; None: every scan was kept.
    """

    model_config = ConfigDict(frozen=True)

    kept_scans: int
    ground_bytes: int | None
    distance_m: float | None
    angle_deg: float | None


class Topic(BaseModel):
    """A topic of a bag.

    Attributes
    ----------
    name, type : str
    messages : int
    role : {"points", "poses", "fix", "extrinsics"} or None
        What it is read as; None where it is not read.
    """

    model_config = ConfigDict(frozen=True)

    name: str
    type: str
    messages: int
    role: Literal["points", "poses", "fix", "extrinsics"] | None = None


class ScanFacts(BaseModel):
    """Count and size of the scans and labels of a drive.

    Attributes
    ----------
    scans : int
        Number of scans (also of those that a reduced drive did not keep).
    first_frame, last_frame : int or None
        Scan numbers.
    scan_bytes, label_bytes : int
        Size of all of them; of a reduced drive that of the files it was made of, 0 where that is not known.
    points_per_scan, least_points, most_points : int or None
        Median, minimum and maximum.
    reduced : ReducedReport or None
        What was kept, where this is a reduced drive.
    label_folder : str or None
    topics : tuple of Topic
        What a bag holds.
    """

    model_config = ConfigDict(frozen=True)

    scans: int = 0
    first_frame: int | None = None
    last_frame: int | None = None
    scan_bytes: int = 0
    label_bytes: int = 0
    points_per_scan: int | None = None
    least_points: int | None = None
    most_points: int | None = None
    reduced: ReducedReport | None = None
    label_folder: str | None = None
    topics: tuple[Topic, ...] = ()


class ScanStore(Protocol):
    """The scans of a drive in one of the ways in which they are kept: raw with labels, or reduced to the ground.

    Attributes
    ----------
    parts : DriveParts
    frames : (N,) int64 or None
        Numbers of all scans, ascending; None where they could not be listed.
    usable : (M,) int64
        Positions of the scans whose files are there, and of the right size.
    facts : ScanFacts
    """

    @property
    def parts(self) -> DriveParts: ...  # noqa: D102
    @property
    def frames(self) -> IntArray | None: ...  # noqa: D102
    @property
    def usable(self) -> IntArray: ...  # noqa: D102
    @property
    def facts(self) -> ScanFacts: ...  # noqa: D102

    def read_trajectory(self, options: DriveOptions, findings: Findings) -> Trajectory:
        """Read poses, times and georeference; what cannot be read is None.

        Raises
        ------
        DriveError, GeoreferenceError
            The first fault, where `findings` stops at it.
        """
        ...

    def judge_labels(self, sample: list[int], options: DriveOptions, findings: Findings) -> LabelJudgement:
        """Find the ids that occur in the scans at some positions, and what they mean."""
        ...

    def ground(self, scheme: LabelScheme) -> GroundSource | None:
        """Return where the ground points are read from; None where that is not there."""
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
    layout : str
        "semantickitti", "kitti_raw", "kitti360", "pcd", "rosbag" or "las".
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

    def __repr__(self) -> str:
        length_m = float(np.linalg.norm(np.diff(self.T_world_lidar[:, :3, 3], axis=0), axis=1).sum())
        return (
            f"<FolderDrive {self.name}: {len(self.frames):,} scans, {length_m:,.0f} m, {self.layout}, "
            f"{'without' if self.georeference is None else 'with'} georeference>"
        )

    @property
    def is_slow(self) -> bool:
        """Whether several scans should be read at once."""
        return self.ground.is_slow

    @property
    def label_source(self) -> str:
        """Where the labels come from, in words."""
        return self.ground.label_source

    def without_georeference(self) -> Self:
        """Return the drive as if it had no GNSS."""
        return replace(self, georeference=None)

    def ground_points(self, index: int) -> GroundPoints:
        """Read the road points, and the points most often confused with them, of the scan at a position 0..N-1.

        Raises
        ------
        DriveError
            The files of the scan are missing, damaged or do not fit together, or a reduced drive did not keep it.
        """
        return self.ground.read(int(self.frames[index]))
