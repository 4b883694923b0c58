"""A drive in a folder: poses in memory, points read scan by scan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference, GroundPoints
from interloc.drives.labels import LabelScheme
from interloc.drives.scans.raw import RawScans
from interloc.drives.scans.reduced import ReducedScans

Scans = RawScans | ReducedScans
"""The scans of a drive by one of its label folders."""


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
        A name of `interloc.drives.formats`.
    frames : (N,) int64
        Scan numbers, ascending.
    T_world_lidar : (N, 4, 4) float64
        Pose of the LiDAR at each scan; W is the LiDAR at the first scan.
    times_s : (N,) float64 or None
        Seconds.
    georeference : Georeference or None
    scans : RawScans or ReducedScans
        Where the points come from.
    pose_frame, pose_frame_reason : str
        Whose poses the pose file holds ("camera", "lidar", "imu", "oxts"), and why that is thought.
    """

    root: Path
    name: str
    layout: str
    frames: IntArray
    T_world_lidar: FloatArray
    times_s: FloatArray | None
    georeference: Georeference | None
    scans: Scans
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
        return self.scans.is_slow

    @property
    def label_source(self) -> str:
        """Where the labels come from, in words."""
        return self.scans.label_source

    @property
    def scheme(self) -> LabelScheme:
        """Which label ids are road."""
        return self.scans.scheme

    def without_georeference(self) -> Self:
        """Return the drive as if it had no GNSS."""
        return replace(self, georeference=None)

    def ground_points(self, index: int) -> GroundPoints:
        """Read the road points, and the points most often confused with them, of the scan at a position 0..N-1."""
        return self.scans.read(int(self.frames[index]))
