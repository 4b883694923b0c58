"""How a drive is to be read where the folder leaves it open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

LabelFolder = Literal["labels", "predictions"]
PoseFrame = Literal["auto", "camera", "lidar"]
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
    check : bool
        Look into a few scans to see whether labels, poses and georeference fit together.
    """

    labels: LabelFolder = "labels"
    label_scheme: LabelSchemeChoice = "auto"
    pose_frame: PoseFrame = "auto"
    layout: LayoutChoice = "auto"
    oxts: Path | None = None
    check: bool = True
