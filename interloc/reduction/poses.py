"""Poses of a drive, computed from its points, as a file that other programs read."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from interloc.drives.layouts import NUMBERED_ANYHOW
from interloc.drives.odometry import PARTLY
from interloc.drives.options import ODOMETRY, DriveOptions
from interloc.errors import ConfigError, DriveError
from interloc.files import atomic_write
from interloc.processes import Progress
from interloc.reduction.convert import read_unreduced
from interloc.reduction.plan import is_contiguous

_TUM_ENDING = ".tum"


@dataclass(frozen=True)
class WrittenPoses:
    """What was written."""

    name: str
    """Name of the drive."""
    scans: int
    length_m: float
    """Distance driven."""
    how: str
    """How the poses were made, in words."""
    has_times: bool
    """Whether the times of the scans are known."""


def write_poses(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    options: DriveOptions | None = None,
    *,
    progress: Progress | None = None,
) -> WrittenPoses:
    """Compute the poses of a drive from its points, and write them to a new file, which appears whole or not at all.

    Labels and poses are not needed. The file has lines of 12 numbers (KITTI), T_world_lidar, W being the LiDAR at the
    first scan, after the frame number where scans are left out between them; it is of the TUM format, which needs the
    times of the scans, where its name ends in .tum. A `DriveError` says that scans cannot be followed, or small_gicp is
    missing.
    """
    root, target = Path(root), Path(out)
    if target.exists():
        raise ConfigError(
            f"{target} is there already, and was not touched. Give another file (-o), or remove it first."
        )
    chosen = (options or DriveOptions()).model_copy(update={"poses": ODOMETRY})
    _, reading, scans = read_unreduced(root, chosen, needs_labels=False, progress=progress)
    trajectory = reading.trajectory
    assert scans.frames is not None
    assert trajectory.poses is not None
    if PARTLY in trajectory.poses.reason:
        raise DriveError(f"{trajectory.poses.reason}.")
    poses, times_s = trajectory.poses.T_world_lidar, trajectory.times_s
    rows, form = poses[:, :3].reshape(-1, 12), ["%.9g"] * 12
    if not is_contiguous(scans.frames) and scans.parts.layout not in NUMBERED_ANYHOW:
        rows, form = np.column_stack([scans.frames, rows]), ["%d", *form]
    if target.suffix.lower() == _TUM_ENDING:
        if times_s is None:
            raise ConfigError(f"{target}: TUM holds times, and those of the scans are not known. Give another ending.")
        rows, form = (
            np.column_stack([times_s, poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()]),
            ["%.6f", *["%.9g"] * 7],
        )
    with atomic_write(target) as file:
        np.savetxt(file, rows, fmt=form)
    return WrittenPoses(
        scans.parts.drive_name, len(poses), trajectory.poses.length_m, trajectory.poses.reason, times_s is not None
    )
