"""Where the LiDAR was at every scan, and when: poses, georeference and times, from the small files of a drive."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drives.files import gaps, is_number, listed, missing_numbers, read_text, rows_by_frame, shown
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.found import Survey
from interloc.drives.georeference.geodetic import poses_of
from interloc.drives.georeference.read import read_georeference
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.poses.frame import to_lidar
from interloc.drives.poses.lines import read_poses
from interloc.errors import InterLocError
from interloc.geometry import invert_transform


def read_track(found: Survey, options: DriveOptions, findings: Findings) -> None:
    """Read georeference, poses and times of the scans of `found` into it; no scan is needed for that.

    Raises
    ------
    DriveError, GeoreferenceError
        The first fault, where `findings` stops at it.
    """
    assert found.parts is not None
    assert found.frames is not None
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


def _rows_of(numbers: IntArray, frames: IntArray, name: str) -> IntArray:
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
    found.pose_frame_reason = "there is no poses.txt; the poses are those of the georeference"
    findings.note("oxts", found.pose_frame_reason)


def _from_first(poses: FloatArray) -> FloatArray:
    """Express poses in the LiDAR at the first scan."""
    relative: FloatArray = invert_transform(poses[0]) @ poses
    relative[0] = np.eye(4)
    return relative


def read_times(parts: DriveParts, frames: IntArray, findings: Findings) -> FloatArray | None:
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
