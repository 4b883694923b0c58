"""What is known of a drive while it is read step by step."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive, GroundSource
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.labels import LabelJudgement


class Contents(Protocol):
    """The scans of a drive in one of the ways in which they are kept: raw with labels, or reduced to the ground.

    Attributes
    ----------
    parts : DriveParts
    name : str
        Of the drive.
    """

    @property
    def parts(self) -> DriveParts: ...  # noqa: D102
    @property
    def name(self) -> str: ...  # noqa: D102

    def list_scans(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """Find the numbers of all scans, and which of them can be read (`frames`, `usable`)."""
        ...

    def look_into_labels(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """Find the ids that occur in the sampled scans, and what they mean (`labels`)."""
        ...

    def ground(self, found: Survey) -> GroundSource | None:
        """Return where the ground points are read from; None where that is not there."""
        ...

    def report(self, found: Survey) -> dict[str, Any]:
        """Return the fields of `DriveReport` about scans and labels."""
        ...


@dataclass
class Survey:
    """What is known of a drive so far; a step that failed leaves its part None.

    Attributes
    ----------
    contents : Contents or None
        Its scans.
    parts : DriveParts or None
        Layout.
    frames : (N,) int64 or None
        Scan numbers.
    usable : (M,) int64
        Positions of the scans whose files fit together by their sizes.
    sample : list of int
        Positions of the scans that are looked into.
    pose_count : int
        Poses in the file.
    T_world_lidar : (N, 4, 4) float64 or None
    pose_frame, pose_frame_reason : str
    times_s : (N,) float64 or None
    georeference : Georeference or None
    georeference_reason : str
        Why there is none.
    drive : FolderDrive or None
        The drive, where its parts are all there.
    labels : LabelJudgement
        Of the sampled scans.
    flatness_m : float or None
        Median difference in height of the same piece of road seen from two scans.
    georeference_error : float or None
        Median error of the motion against the georeference, as a share of the way.
    """

    contents: Contents | None = None
    parts: DriveParts | None = None
    frames: IntArray | None = None
    usable: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    sample: list[int] = field(default_factory=list)
    pose_count: int = 0
    T_world_lidar: FloatArray | None = None
    pose_frame: str = ""
    pose_frame_reason: str = ""
    times_s: FloatArray | None = None
    georeference: Georeference | None = None
    georeference_reason: str = "the drive has neither oxts/ nor geo.csv"
    drive: FolderDrive | None = None
    labels: LabelJudgement = field(default_factory=LabelJudgement)
    flatness_m: float | None = None
    georeference_error: float | None = None
