"""Reading of a drive folder step by step: the one path behind `open_drive` and `inspect_drive`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from interloc.drives.dialect import to_lidar
from interloc.drives.drive import Georeference
from interloc.drives.faults import DriveFileError, Findings
from interloc.drives.files import NumberedFiles, list_numbered, listed, missing_numbers, shown
from interloc.drives.fixes import poses_of
from interloc.drives.georeference import read_georeference
from interloc.drives.inventory import check_files, list_labels
from interloc.drives.labels import SEMANTICKITTI, LabelScheme, guess_scheme, named_scheme
from interloc.drives.layout import find_layout
from interloc.drives.options import DriveOptions
from interloc.drives.parts import DriveParts
from interloc.drives.plausibility import check_flat_road, check_georeference, check_labels, sample_indices
from interloc.drives.poses import read_poses
from interloc.drives.rows import gaps, rows_by_frame
from interloc.drives.scans import FolderDrive, read_label_ids
from interloc.drives.times import read_times
from interloc.errors import InterLocError
from interloc.geometry import invert_transform

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SAMPLED_SCANS = 5


@dataclass
class Survey:
    """What is known of a drive so far; a step that failed leaves its part None.

    Attributes
    ----------
    parts : DriveParts or None
        Layout.
    scans, labels : NumberedFiles or None
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
    scheme : LabelScheme or None
    label_counts : dict of int to int
        How many points of the sampled scans carry each id.
    flatness_m : float or None
        Median difference in height of the same piece of road seen from two scans.
    georeference_error : float or None
        Median error of the motion against the georeference, as a share of the way.
    """

    parts: DriveParts | None = None
    scans: NumberedFiles | None = None
    labels: NumberedFiles | None = None
    frames: NDArray[np.int64] | None = None
    usable: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    sample: list[int] = field(default_factory=list)
    pose_count: int = 0
    T_world_lidar: Array | None = None
    pose_frame: str = ""
    pose_frame_reason: str = ""
    times_s: Array | None = None
    georeference: Georeference | None = None
    georeference_reason: str = "the drive has neither oxts/ nor geo.csv"
    drive: FolderDrive | None = None
    scheme: LabelScheme | None = None
    label_counts: dict[int, int] = field(default_factory=dict)
    flatness_m: float | None = None
    georeference_error: float | None = None


def survey(root: Path, options: DriveOptions, findings: Findings, *, thorough: bool = False) -> Survey:
    """Read all of a drive but its points, and check it; look into some scans, or into all of them (`thorough`).

    Raises
    ------
    DriveError, GeoreferenceError, ConfigError
        The first fault, where `findings` stops at it.
    """
    found = Survey()
    scheme = named_scheme(options.label_scheme)
    with findings.stage():
        found.parts = find_layout(root, options)
    if found.parts is None:
        return found
    with findings.stage():
        found.scans = list_numbered(found.parts.scans, ".bin", root)
        found.frames = found.scans.numbers
    with findings.stage():
        found.labels = list_labels(found.parts)
    if found.scans is not None and found.labels is not None:
        found.usable = check_files(found.scans, found.labels, root, findings, sizes=options.check)
    if found.frames is None:
        return found
    with findings.stage():
        try:
            found.georeference = read_georeference(found.parts, found.frames, options.oxts)
        except InterLocError as error:
            found.georeference_reason = str(error)
            raise
    with findings.stage():
        _read_poses(found, options, findings)
    with findings.stage():
        found.times_s = read_times(found.parts, found.frames, findings)
    found.sample = sample_indices(found.usable, len(found.usable) if thorough else _SAMPLED_SCANS)
    if found.labels is not None:
        _read_label_ids(found, scheme, options, findings)
    found.drive = _assemble(found)
    if found.drive is not None and options.check:
        _check_contents(found, findings)
    return found


def _read_poses(found: Survey, options: DriveOptions, findings: Findings) -> None:
    """Find the pose of the LiDAR at every scan."""
    parts, frames = found.parts, found.frames
    assert parts is not None
    assert frames is not None
    if parts.poses is None:
        _poses_from_georeference(found, findings)
        return
    name = shown(parts.poses, parts.root)
    lines = read_poses(parts.poses, parts.root)
    found.pose_count = len(lines.poses)
    missing = int(frames[-1] - frames[0]) + 1 - len(frames)
    if lines.frames is None and missing:
        findings.error(
            DriveFileError(
                shown(parts.scans, parts.root),
                f"{missing:,} scans are missing between {frames[0]} and {frames[-1]} ({listed(gaps(frames))}), and the "
                f"lines of {name} do not say which frame they belong to. Frame numbers must be contiguous or "
                "explicitly mapped: put the missing scans back, or write the frame number in front of every pose line. "
                "Usual cause: an upload or copy that was interrupted.",
            )
        )
    rows = rows_by_frame(frames, len(lines.poses)) if lines.frames is None else _rows_of(lines.frames, frames, name)
    if rows is None:
        raise DriveFileError(
            name,
            f"{len(lines.poses):,} poses for the scans {frames[0]} to {frames[-1]} ({len(frames):,} scans). "
            "Expected one line a scan, the first for frame 0. "
            "Usual cause: poses of another sequence, or a file cut short.",
        )
    if len(lines.poses) > len(frames):
        findings.note(
            name, f"{len(lines.poses):,} poses for {len(frames):,} scans; the poses of other frames are not used."
        )
    elif frames[0] > 0 and lines.frames is None:
        findings.note(name, f"the scans start at {frames[0]}, and there is one pose a scan: taken one to one.")
    lidar, found.pose_frame, found.pose_frame_reason = to_lidar(lines.poses, parts, name, options.pose_frame, findings)
    found.T_world_lidar = _from_first(lidar[rows])


def _rows_of(numbers: NDArray[np.int64], frames: NDArray[np.int64], name: str) -> NDArray[np.int64]:
    """Return the row of every scan among numbered pose lines."""
    missing = missing_numbers(numbers, frames)
    if len(missing):
        raise DriveFileError(
            name,
            f"{len(missing):,} of {len(frames):,} scans have no pose (frames {listed(missing)}). "
            "Expected a line for every scan. KITTI-360 has no poses where the GNSS failed: leave those scans out.",
        )
    return np.searchsorted(numbers, frames)


def _poses_from_georeference(found: Survey, findings: Findings) -> None:
    """Take the poses of a KITTI raw drive from its OXTS."""
    parts = found.parts
    assert parts is not None
    if found.georeference is None:
        raise DriveFileError(
            "oxts",
            f"gives no poses: {found.georeference_reason}. Expected oxts/data/0000000000.txt, one file a scan, or a "
            "poses.txt of your own beside velodyne_points/.",
        )
    found.T_world_lidar = _from_first(poses_of(found.georeference))
    found.pose_count = len(found.T_world_lidar)
    found.pose_frame = "oxts"
    found.pose_frame_reason = f"there is no poses.txt; poses are those of {found.georeference.source}"
    findings.note("oxts", found.pose_frame_reason)


def _from_first(poses: Array) -> Array:
    """Express poses in the LiDAR at the first scan."""
    relative: Array = invert_transform(poses[0]) @ poses
    relative[0] = np.eye(4)
    return relative


def _read_label_ids(found: Survey, scheme: LabelScheme | None, options: DriveOptions, findings: Findings) -> None:
    """Find which ids occur in the sampled scans, and under which scheme they make sense."""
    assert found.parts is not None
    assert found.labels is not None
    assert found.frames is not None
    root, folder = found.parts.root, shown(found.labels.folder, found.parts.root)
    for index in found.sample:
        with findings.stage():
            for label, count in read_label_ids(found.labels.path(int(found.frames[index])), root):
                found.label_counts[label] = found.label_counts.get(label, 0) + count
    found.scheme = scheme
    if scheme is None and found.label_counts:
        ids = np.array(sorted(found.label_counts), dtype=np.int64)
        found.scheme = guess_scheme(ids, kitti360=found.parts.layout == "kitti360")
        if found.scheme is not SEMANTICKITTI:
            findings.note(folder, f"the ids look like scheme {found.scheme.name} and are read as such.")
    if options.check and found.scheme is not None and found.label_counts:
        check_labels(folder, found.scheme, found.label_counts, findings)


def _assemble(found: Survey) -> FolderDrive | None:
    """Make the drive of what was found; None where a part is missing."""
    if found.parts is None or found.frames is None or found.T_world_lidar is None:
        return None
    if found.scans is None or found.labels is None:
        return None
    return FolderDrive(
        root=found.parts.root,
        layout=found.parts.layout,
        frames=found.frames,
        T_world_lidar=found.T_world_lidar,
        times_s=found.times_s,
        georeference=found.georeference,
        scan_files=found.scans,
        label_files=found.labels,
        scheme=found.scheme or SEMANTICKITTI,
        pose_frame=found.pose_frame,
        pose_frame_reason=found.pose_frame_reason,
    )


def _check_contents(found: Survey, findings: Findings) -> None:
    """Read the sampled scans, and see whether labels, poses and georeference fit together."""
    drive = found.drive
    assert drive is not None
    assert found.parts is not None
    pose_file = "oxts" if found.parts.poses is None else shown(found.parts.poses, drive.root)
    for index in found.sample:
        with findings.stage():
            drive.ground_points(index)
    found.flatness_m = check_flat_road(drive, found.usable, pose_file, findings)
    if drive.georeference is not None and drive.pose_frame != "oxts":
        found.georeference_error = check_georeference(drive.T_world_lidar, drive.georeference, findings)
