"""Opening of a drive."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive
from interloc.drives.options import DriveOptions, LabelFolder, LayoutChoice, PoseFrame
from interloc.drives.survey import survey


def open_drive(
    path: str | os.PathLike[str],
    *,
    labels: LabelFolder = "labels",
    label_scheme: str | Collection[int] = "auto",
    pose_frame: PoseFrame = "auto",
    layout: LayoutChoice = "auto",
    oxts: str | os.PathLike[str] | None = None,
    name: str | None = None,
    check: bool = True,
) -> FolderDrive:
    """Open a drive folder: poses, times and georeference are read, points when they are asked for.

    Parameters
    ----------
    path
        Folder of the drive: a SemanticKITTI / KITTI odometry sequence, a KITTI raw drive, or KITTI-360 scans with its
        pose lines; or a reduced drive (`interloc.drives.scans.reduced_format`).
    labels : {"labels", "predictions"}
        Folder of the labels.
    label_scheme
        "auto", "semantickitti", "learning" (0..19, road = 9), "kitti360", or the ids of road, as a collection or as
        text ("40,60").
    pose_frame : {"auto", "camera", "lidar"}
        Whose poses the pose file holds; "auto" tells it from the motion.
    layout : {"auto", "semantickitti", "kitti_raw", "kitti360"}
    oxts
        Georeference from elsewhere: the KITTI raw drive of an odometry sequence, a file with one OXTS row a frame (or
        its .gz), or a geo.csv.
    name : str or None
        Name of the drive, where it is not that of the folder.
    check : bool
        Check the sizes of all files, and look into a few scans to see whether labels, poses and georeference fit
        together.

    Returns
    -------
    FolderDrive
        A `Drive`, cheap to send to another process.

    Raises
    ------
    DriveError
        The folder is no drive, or something in it is damaged or does not fit together.
    GeoreferenceError
        The georeference is damaged or that of another drive.
    ConfigError
        An option without meaning.
    """
    options = drive_options(
        labels=labels,
        label_scheme=label_scheme,
        pose_frame=pose_frame,
        layout=layout,
        oxts=oxts,
        name=name,
        check=check,
    )
    drive = survey(Path(path), options, Findings(stop_at_first=True)).drive
    assert drive is not None
    return drive


def drive_options(
    *,
    labels: LabelFolder = "labels",
    label_scheme: str | Collection[int] = "auto",
    pose_frame: PoseFrame = "auto",
    layout: LayoutChoice = "auto",
    oxts: str | os.PathLike[str] | None = None,
    name: str | None = None,
    check: bool = True,
) -> DriveOptions:
    """Collect the options of `open_drive`."""
    return DriveOptions(
        labels=labels,
        label_scheme=label_scheme if isinstance(label_scheme, str) else frozenset(label_scheme),
        pose_frame=pose_frame,
        layout=layout,
        oxts=None if oxts is None else Path(oxts),
        name=name,
        check=check,
    )
