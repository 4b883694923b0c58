"""How a drive is to be read where the folder leaves it open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from interloc.errors import ConfigError

LabelFolder = Literal["labels", "predictions"]
PoseFrame = Literal["auto", "camera", "lidar"]
LayoutName = Literal["semantickitti", "kitti_raw", "kitti360"]
LayoutChoice = Literal["auto", "semantickitti", "kitti_raw", "kitti360"]
LabelSchemeChoice = str | frozenset[int]
"""auto, semantickitti, learning, kitti360, or ids of road: a set, or a text such as "40,60"."""


@dataclass(frozen=True)
class DriveOptions:
    """Options of `open_drive` and `inspect_drive`.

    Attributes
    ----------
    labels : {"labels", "predictions"}
        Folder of the labels.
    label_scheme : str or frozenset of int
        "auto", "semantickitti", "learning", "kitti360", or the ids of road, as a set or as text ("40,60").
    pose_frame : {"auto", "camera", "lidar"}
        Whose poses the pose file holds.
    layout : {"auto", "semantickitti", "kitti_raw", "kitti360"}
    oxts : Path or None
        Georeference from elsewhere: a KITTI raw drive folder, a file with one OXTS row a frame (or its .gz), a geo.csv.
    name : str or None
        Name of the drive, where it is not that of the folder.
    check : bool
        Look into a few scans to see whether labels, poses and georeference fit together.

    Raises
    ------
    ConfigError
        A choice that is none.
    """

    labels: LabelFolder = "labels"
    label_scheme: LabelSchemeChoice = "auto"
    pose_frame: PoseFrame = "auto"
    layout: LayoutChoice = "auto"
    oxts: Path | None = None
    name: str | None = None
    check: bool = True

    def __post_init__(self) -> None:
        for name, value, choices in (
            ("labels", self.labels, get_args(LabelFolder)),
            ("pose frame", self.pose_frame, get_args(PoseFrame)),
            ("layout", self.layout, get_args(LayoutChoice)),
        ):
            if value not in choices:
                raise ConfigError(f"{name} {value!r}: expected {', '.join(choices)}.")
