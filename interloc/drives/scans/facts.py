"""What is to be told of the scans of a drive, whichever way they are kept."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict


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
