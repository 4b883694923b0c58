"""Reading of a drive folder step by step: the one path behind `open_drive` and `inspect_drive`."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from interloc.drives.dialect import to_lidar
from interloc.drives.drive import Georeference
from interloc.drives.faults import DriveFileError, Findings
from interloc.drives.files import NumberedFiles, is_number, list_numbered, listed, missing_numbers, read_text, shown
from interloc.drives.georeference import poses_of, read_georeference
from interloc.drives.labels import SEMANTICKITTI, LabelScheme, guess_scheme, named_scheme
from interloc.drives.layout import find_layout
from interloc.drives.options import DriveOptions
from interloc.drives.parts import DriveParts
from interloc.drives.plausibility import check_flat_road, check_georeference, check_labels, sample_indices
from interloc.drives.poses import read_poses
from interloc.drives.rows import gaps, rows_by_frame
from interloc.drives.scans import (
    LABEL_BYTES,
    POINT_BYTES,
    FolderDrive,
    label_count_complaint,
    read_label_ids,
    scan_size_complaint,
)
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
        found.labels = _list_labels(found.parts)
    if found.scans is not None and found.labels is not None:
        found.usable = _check_files(found.scans, found.labels, root, findings, sizes=options.check)
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
        found.times_s = _read_times(found.parts, found.frames, findings)
    found.sample = sample_indices(found.usable, len(found.usable) if thorough else _SAMPLED_SCANS)
    if found.labels is not None:
        _read_label_ids(found, scheme, options, findings)
    found.drive = _assemble(found)
    if found.drive is not None and options.check:
        _check_contents(found, findings)
    return found


def _list_labels(parts: DriveParts) -> NumberedFiles:
    """List the label files."""
    folder = parts.labels
    if not folder.is_dir():
        other = parts.root / ("predictions" if folder.name == "labels" else "labels")
        hint = (
            f"There is {other.name}/: choose it as the label folder."
            if other.is_dir()
            else "Any semantic segmentation that writes SemanticKITTI .label files will do."
        )
        raise DriveFileError(
            shown(folder, parts.root), f"is missing. Expected one .label file a scan: uint32 a point. {hint}"
        )
    return list_numbered(folder, ".label", parts.root)


def _check_files(
    scans: NumberedFiles, labels: NumberedFiles, root: Path, findings: Findings, *, sizes: bool
) -> Indices:
    """Check that every scan has its labels, and that their sizes fit, by names and sizes only.

    Returns
    -------
    (M,) int64
        Positions of the scans that can be read.
    """
    missing = missing_numbers(labels.numbers, scans.numbers)
    if len(missing):
        findings.error(
            DriveFileError(
                shown(labels.path(int(missing[0])), root),
                f"is missing: {len(missing):,} of {len(scans.numbers):,} scans have no labels ({listed(missing)}). "
                "Expected one .label file a scan. Usual cause: an archive that was not unpacked to the end.",
            )
        )
    extra = missing_numbers(scans.numbers, labels.numbers)
    if len(extra):
        findings.note(shown(labels.folder, root), f"labels of {len(extra):,} scans that are not there are not used.")
    common, at_scan, at_label = np.intersect1d(scans.numbers, labels.numbers, assume_unique=True, return_indices=True)
    if not sizes:
        return at_scan
    for row in np.flatnonzero((scans.sizes % POINT_BYTES != 0) | (scans.sizes == 0)):
        name = shown(scans.path(int(scans.numbers[row])), root)
        findings.error(DriveFileError(name, scan_size_complaint(int(scans.sizes[row]))))
    scan_sizes, label_sizes = scans.sizes[at_scan], labels.sizes[at_label]
    wrong = (
        (label_sizes * (POINT_BYTES // LABEL_BYTES) != scan_sizes) & (scan_sizes % POINT_BYTES == 0) & (scan_sizes > 0)
    )
    for row in np.flatnonzero(wrong):
        scan, label = (shown(files.path(int(common[row])), root) for files in (scans, labels))
        count, left = divmod(int(label_sizes[row]), LABEL_BYTES)
        if left:
            message = f"{label_sizes[row]:,} bytes, which is no multiple of 4. Expected one uint32 a point."
        else:
            message = label_count_complaint(count, int(scan_sizes[row]) // POINT_BYTES, scan)
        findings.error(DriveFileError(label, message))
    whole = (
        (label_sizes * (POINT_BYTES // LABEL_BYTES) == scan_sizes) & (scan_sizes % POINT_BYTES == 0) & (scan_sizes > 0)
    )
    usable: Indices = at_scan[whole]
    return usable


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
    missing = gaps(frames)
    if lines.frames is None and len(missing):
        findings.error(
            DriveFileError(
                shown(parts.scans, parts.root),
                f"{len(missing):,} scans are missing between {frames[0]} and {frames[-1]} ({listed(missing)}), and the "
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


def _read_times(parts: DriveParts, frames: NDArray[np.int64], findings: Findings) -> Array | None:
    """Read the time of every scan, seconds; None where there is none that fits."""
    if parts.times is None:
        return None
    name = shown(parts.times, parts.root)
    lines = [text.strip() for text in read_text(parts.times, parts.root).splitlines() if text.strip()]
    rows = rows_by_frame(frames, len(lines))
    if rows is None:
        findings.warning(name, f"{len(lines):,} times for the scans {frames[0]} to {frames[-1]}; times are not used.")
        return None
    chosen = [lines[row] for row in rows]
    times = np.array([_seconds(text) for text in chosen])
    if not np.isfinite(times).all():
        row = int(np.argmax(~np.isfinite(times)))
        findings.warning(name, f"line {rows[row] + 1}: {chosen[row][:40]!r} is no time; times are not used.")
        return None
    if (np.diff(times) < 0).any():
        row = int(np.argmax(np.diff(times) < 0))
        findings.warning(name, f"line {rows[row + 1] + 1}: time runs backwards; times are not used.")
        return None
    return times


def _seconds(text: str) -> float:
    """Read seconds, or a date and time with up to nanoseconds (KITTI raw); NaN where it is neither."""
    if is_number(text):
        return float(text)
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.fromisoformat(whole + "+00:00")
        return moment.timestamp() + (float("0." + fraction) if fraction else 0.0)
    except ValueError:
        return float("nan")


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
    for index in found.sample:
        with findings.stage():
            drive.ground_points(index)
    found.flatness_m = check_flat_road(drive, found.usable, findings)
    if drive.georeference is not None and drive.pose_frame != "oxts":
        found.georeference_error = check_georeference(drive.T_world_lidar, drive.georeference, findings)
