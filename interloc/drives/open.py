"""Opening of a drive: its folder is read step by step, on the one path behind `open_drive` and `inspect_drive`."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Unpack

from interloc.drives.checks import check_flat_road, check_georeference, check_turns, sample_indices
from interloc.drives.findings import Findings
from interloc.drives.folder import FolderDrive, ScanStore
from interloc.drives.labels import SEMANTICKITTI, LabelJudgement
from interloc.drives.layouts import find_layout
from interloc.drives.options import DriveArguments, DriveOptions, ReadingOptions
from interloc.drives.scans.bin_files import open_bin_files
from interloc.drives.scans.las.open import open_las
from interloc.drives.scans.pcd import open_pcd_files
from interloc.drives.scans.raw import RawStore
from interloc.drives.scans.recorded import Recording
from interloc.drives.scans.reduced import ReducedStore
from interloc.drives.scans.rosbag.open import open_rosbag
from interloc.drives.trajectory import Trajectory

SAMPLED_SCANS = 5
"""How many scans are looked into, unless all are."""


def _open_scan_files(root: Path, options: DriveOptions, findings: Findings) -> Recording:
    """Open a folder with one file per scan."""
    parts = find_layout(root, options)
    if parts.layout == "pcd":
        return open_pcd_files(parts, options, findings)
    return open_bin_files(parts, findings, check=options.check)


_FORMATS: tuple[Callable[[Path, DriveOptions, Findings], Recording | None], ...] = (
    open_rosbag,
    open_las,
    _open_scan_files,  # the last: it refuses a folder that is not a drive, with the usual mistake
)
"""Formats of scans; the first that knows a folder or file reads it. A new one is a module of `scans` and a line."""


def open_drive(
    path: str | os.PathLike[str], options: ReadingOptions | None = None, **arguments: Unpack[DriveArguments]
) -> FolderDrive:
    """Open a drive folder: poses, times and georeference are read, points when they are asked for.

    Parameters
    ----------
    path
        The drive: a SemanticKITTI / KITTI odometry sequence, a KITTI raw drive, a drive of KITTI-360, a folder of PCD
        files, a ROS bag (.bag, .db3, .mcap), LAS or LAZ files with their trajectory; or a reduced drive
        (`interloc.drives.scans.reduced_format`).
    options : ReadingOptions or None
        All of the following at once; those that are named beside it count.
    labels : {"labels", "predictions"}
        Folder of the labels.
    label_scheme
        "auto", "semantickitti", "learning" (0..19, road = 9), "kitti360", or the ids of road, as a collection or as
        text ("40,60").
    pose_frame : {"auto", "camera", "lidar"}
        Sensor whose poses the pose file holds; "auto" finds it out from the motion.
    layout : {"auto", "semantickitti", "kitti_raw", "kitti360", "pcd", "rosbag", "las"}
    poses, points, fix, crs : str or None
        Where poses, scans and fixes are, and the coordinate system of LAS files: see `ReadingOptions`.
    model
        Folder of a network (`interloc.labelling`) that labels the scans as they are read; label files do not count.
    provider
        What the network runs on.
    oxts
        Georeference from elsewhere: the KITTI raw drive of an odometry sequence, a file with one OXTS row per frame
        (or its .gz), or a geo.csv.
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
        The folder is not a drive, or something in it is damaged or does not fit together.
    GeoreferenceError
        The georeference is damaged or that of another drive.
    ModelError
        The network cannot be used.
    ConfigError
        An unknown option or choice.
    """
    drive = read_drive(Path(path), DriveOptions.of(options, **arguments), Findings(stop_at_first=True)).drive
    assert drive is not None  # else a fault was raised
    return drive


@dataclass(frozen=True)
class DriveReading:
    """What was found out about a drive; a step that failed leaves its part None or empty.

    Attributes
    ----------
    store : ScanStore or None
        Its scans.
    trajectory : Trajectory
        Where the LiDAR was at each of them.
    sample : list of int
        Positions of the scans that were looked into.
    labels : LabelJudgement
        What their labels mean.
    drive : FolderDrive or None
        The drive, where all of these are there.
    flatness_m : float or None
        Median difference in height of the same piece of road seen from two scans.
    georeference_error : float or None
        Median error of the motion against the georeference, as a share of the distance.
    """

    store: ScanStore | None = None
    trajectory: Trajectory = field(default_factory=Trajectory)
    sample: list[int] = field(default_factory=list)
    labels: LabelJudgement = field(default_factory=LabelJudgement)
    drive: FolderDrive | None = None
    flatness_m: float | None = None
    georeference_error: float | None = None


def read_drive(
    root: Path, options: DriveOptions, findings: Findings, *, thorough: bool = False, needs_labels: bool = True
) -> DriveReading:
    """Read all of a drive but its points, and check it; look into some scans, or into all of them (`thorough`).

    Raises
    ------
    DriveError, GeoreferenceError
        The first fault, where `findings` stops at it.
    """
    store = None
    with findings.stage():
        store = _open_store(root, options, findings, needs_labels=needs_labels)
    if store is None or store.frames is None:
        return DriveReading(store)
    trajectory = store.read_trajectory(options, findings)
    sample = sample_indices(store.usable, len(store.usable) if thorough else SAMPLED_SCANS)
    labels = store.judge_labels(sample, options, findings)
    reading = DriveReading(store, trajectory, sample, labels, _drive_of(store, trajectory, labels))
    return _checked(reading, findings) if options.check else reading


def _open_store(root: Path, options: DriveOptions, findings: Findings, *, needs_labels: bool) -> ScanStore:
    """Open the scans of a drive, in whichever way they are kept."""
    if (reduced := ReducedStore.open(root, options, findings)) is not None:
        return reduced
    recordings = (open_format(root, options, findings) for open_format in _FORMATS)
    recording = next(opened for opened in recordings if opened is not None)
    return RawStore.of(recording, options, findings, needs_labels=needs_labels)


def _drive_of(store: ScanStore, trajectory: Trajectory, labels: LabelJudgement) -> FolderDrive | None:
    """Make the drive of what was found; None where a part is missing."""
    scheme = labels.scheme or SEMANTICKITTI
    ground, poses = store.ground(scheme), trajectory.poses
    if store.frames is None or ground is None or poses is None:
        return None
    return FolderDrive(
        root=store.parts.root,
        name=store.parts.drive_name,
        layout=store.parts.layout,
        frames=store.frames,
        T_world_lidar=poses.T_world_lidar,
        times_s=trajectory.times_s,
        georeference=trajectory.georeference,
        ground=ground,
        scheme=scheme,
        pose_frame=poses.frame,
        pose_frame_reason=poses.reason,
    )


def _checked(reading: DriveReading, findings: Findings) -> DriveReading:
    """Read the sampled scans, and see whether labels, poses and georeference fit together."""
    drive, store = reading.drive, reading.store
    if drive is None or store is None:
        return reading
    pose_file = "oxts" if drive.pose_frame == "oxts" else "poses"  # those of a bag are in no file
    if store.parts.poses is not None:
        pose_file = store.parts.file(store.parts.poses).name
    for index in reading.sample:
        with findings.stage():
            drive.ground_points(index)
    reading = replace(reading, flatness_m=check_flat_road(drive, store.usable, pose_file, findings))
    check_turns(drive, store.usable, pose_file, findings, suspected=reading.trajectory.is_odd)
    if drive.georeference is None or drive.pose_frame == "oxts":
        return reading
    error = check_georeference(drive.T_world_lidar, drive.georeference, findings)
    return replace(reading, georeference_error=error)
