"""Where the LiDAR was at every scan, and when: poses, georeference and times, from the small files of a drive."""

from dataclasses import dataclass, replace

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference
from interloc.drives.files import SourceFile, gaps, in_seconds, rows_by_frame, seconds_of
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.georeference.geodetic import poses_of, without_standing
from interloc.drives.georeference.read import AS_PUBLISHED, georeference_of_kitti360, is_karlsruhe, read_georeference
from interloc.drives.layouts import NUMBERED_ANYHOW, DriveParts, PoseOwner
from interloc.drives.options import DriveOptions, PoseFrame
from interloc.drives.poses.files import PoseLines, is_tum, read_poses, read_tum
from interloc.drives.poses.frame import IMU_CALIBRATION, to_lidar
from interloc.drives.poses.motion import LONGEST_GAP_S, longest_piece
from interloc.errors import InterLocError
from interloc.geometry import enu_from_lonlat, from_first
from interloc.wording import counted, listed

_PROJECTED_M = 1e5
"""Farther from the origin of their world do no odometry's positions lie."""

_MOVED_M, _MIN_SPEED_MPS, _MAX_SPEED_MPS, _SINCE_2001_S = 0.05, 0.05, 80.0, 1e9

_FIX_ERROR_M = 50.0
"""OXTS of KITTI-360 and its poses lie at most some metres apart, where both are as published."""


@dataclass(frozen=True)
class LidarPoses:
    """The pose of the LiDAR at every scan."""

    T_world_lidar: FloatArray
    """(N, 4, 4) float64: w is the LiDAR at the first scan."""
    frame: PoseOwner
    """{"camera", "lidar", "imu", "oxts"}: whose poses the pose file holds."""
    reason: str
    """Why that is thought."""
    T_file_world: FloatArray | None = None
    """(4, 4) float64 or None: w in the world of the pose file."""
    is_computed: bool = False
    """They were computed from the points."""

    @property
    def steps_m(self) -> FloatArray:
        """(N - 1,) float64 distances from scan to scan."""
        steps: FloatArray = np.linalg.norm(np.diff(self.T_world_lidar[:, :3, 3], axis=0), axis=1)
        return steps

    @property
    def length_m(self) -> float:
        """Distance driven over the scans."""
        return float(self.steps_m.sum())


@dataclass(frozen=True)
class Trajectory:
    """What the small files of a drive say of its motion; what could not be read is None."""

    poses: LidarPoses | None = None
    pose_count: int = 0
    """Poses in the file (may be more than scans)."""
    times_s: FloatArray | None = None
    """(N,) float64 or None."""
    georeference: Georeference | None = None
    georeference_reason: str | None = None
    """Why there is none; None where it was not looked for."""

    def within_jumps(self, frames: IntArray, pose_file: str, findings: Findings) -> "tuple[slice | None, Trajectory]":
        """Cut where the poses jump; a warning says what is left out, by the numbers of the scans.

        Returns the rows of the longest piece between two jumps (None where there are none) and its trajectory.
        """
        if self.poses is None:
            return None, self
        rows, jumps = longest_piece(self.poses.T_world_lidar[:, :3, 3], self.times_s, frames)
        if not jumps:
            return None, self
        findings.warning(pose_file, f"the poses {jumps}")
        return rows, self.part(rows)

    def part(self, rows: slice | IntArray) -> "Trajectory":
        """Return that of some of the scans; W is the LiDAR at the first of them."""
        poses, times_s, georeference = self.poses, self.times_s, self.georeference
        if poses is not None:
            poses = replace(poses, T_world_lidar=from_first(poses.T_world_lidar[rows]), T_file_world=None)
        return replace(
            self,
            poses=poses,
            times_s=None if times_s is None else times_s[rows],
            georeference=None if georeference is None else georeference.part(rows),
        )


def read_trajectory(
    parts: DriveParts, frames: IntArray, options: DriveOptions, findings: Findings, *, times_s: FloatArray | None = None
) -> Trajectory:
    """Read georeference, poses and times of scans, by their (N,) ascending numbers; no scan is needed for that.

    `times_s` are those of the scans, where they are known without a file of times.
    """
    georeference, reason = None, "the drive has neither oxts/ nor geo.csv"
    poses, pose_count = None, 0
    with findings.stage():
        try:
            georeference = read_georeference(parts, frames, options.oxts, findings)
        except InterLocError as error:
            reason = str(error)
            if options.oxts is not None or not parts.in_kitti360_world:  # its poses may tell
                raise
            findings.note("oxts", f"is not used: {reason}")
    if georeference is not None and georeference.source.endswith(AS_PUBLISHED):
        findings.note(
            IMU_CALIBRATION,
            "is missing: the lever arm from IMU to LiDAR that KITTI publishes is used, good to a few cm.",
        )
    with findings.stage():
        if times_s is None and parts.times is not None:
            times_s = _read_times(parts.file(parts.times), parts, frames, findings)
    with findings.stage():
        if parts.poses is None:
            poses = _poses_from_georeference(georeference, reason, findings)
            pose_count = len(frames)
        else:
            file = parts.file(parts.poses)
            lines = _read_timed(file, times_s, frames, findings) if is_tum(file.head()) else read_poses(file)
            pose_count = len(lines.poses)
            poses = _poses_of_scans(lines, file, parts, frames, options.pose_frame, findings)
            if lines.frames is None and parts.times is not None:
                _check_length(file, parts.file(parts.times), pose_count, findings)
        if poses is not None and times_s is not None:
            times_s = _right_times(poses, times_s, parts, findings)
    if georeference is not None and poses is not None and poses.frame != "oxts":
        georeference = without_standing(poses.T_world_lidar, georeference, frames, findings)
    if options.oxts is None and parts.geo is None and parts.in_kitti360_world and poses is not None:
        georeference = _in_kitti360_world(poses, parts, georeference, findings)
    return Trajectory(poses, pose_count, times_s, georeference, reason)


def _in_kitti360_world(
    poses: LidarPoses, parts: DriveParts, oxts: Georeference | None, findings: Findings
) -> Georeference | None:
    """Return the georeference that poses of KITTI-360 are, smoother than OXTS; that of OXTS where they were moved."""
    assert parts.poses is not None
    assert poses.T_file_world is not None
    name = parts.file(parts.poses).name
    world = georeference_of_kitti360(poses.T_file_world @ poses.T_world_lidar, f"{name}, in the world of KITTI-360")
    if oxts is None:
        return world if is_karlsruhe(world) else None
    east_north = enu_from_lonlat(oxts.lat_deg, oxts.lon_deg, world.lonlat)
    apart = float(np.median(np.linalg.norm(east_north, axis=1)))
    if apart > _FIX_ERROR_M:
        findings.note(name, f"the poses are {apart:,.0f} m away from OXTS in the world of KITTI-360: OXTS counts.")
        return oxts
    return world


def _read_timed(file: SourceFile, times_s: FloatArray | None, frames: IntArray, findings: Findings) -> PoseLines:
    """Read the poses of a TUM file at the times of the scans, or one per scan where these have none."""
    timed = read_tum(file, findings)
    numbers = timed.times_s.astype(np.int64)
    is_numbered = bool((timed.times_s == numbers).all() and np.isin(frames, numbers).all())
    one_each = np.array_equal(numbers, frames)  # times.txt may count seconds from 0, too
    if is_numbered and (times_s is None or one_each or not timed.covers(times_s).any()):
        findings.note(file.name, "the times of its poses are taken for the numbers of the scans.")
        return PoseLines(timed.poses, numbers)
    if times_s is not None:
        if lost := np.count_nonzero(timed.covers(times_s) & ~timed.covers(times_s, longest_gap_s=LONGEST_GAP_S)):
            what = f"{lost:,} scans lie between poses that are more than {LONGEST_GAP_S:g} s apart"
            findings.warning(file.name, f"{what}: they are put on a straight line there.")
        return PoseLines(timed.at(times_s), frames)
    if len(timed.poses) != len(frames):
        raise file.fault(
            f"{len(timed.poses):,} poses with times (TUM) for {len(frames):,} scans whose times are not known. "
            "Expected a times.txt with the time of every scan, scans named by their times, or one pose per scan."
        )
    findings.note(file.name, "the times of the scans are not known: one pose per scan, in their order.")
    return PoseLines(timed.poses, frames)


def _poses_of_scans(
    lines: PoseLines, file: SourceFile, parts: DriveParts, frames: IntArray, declared: PoseFrame, findings: Findings
) -> LidarPoses:
    if parts.layout in NUMBERED_ANYHOW and lines.frames is None and len(lines.poses) == len(frames):
        lines = PoseLines(lines.poses, frames)  # the numbers in their names are whatever their maker chose
    missing = int(frames[-1] - frames[0]) + 1 - len(frames)
    if lines.frames is None and missing:
        findings.error(
            parts.file(parts.scans).fault(
                f"{counted(missing, 'scan')} missing between {frames[0]} and {frames[-1]} ({listed(gaps(frames))}), "
                f"and the lines of {file.name} do not say which frame they belong to. Frame numbers must be contiguous "
                "or explicitly mapped: put the missing scans back, or write the frame number in front of every pose "
                "line. Usual cause: an upload or copy that was interrupted."
            )
        )
    rows = rows_by_frame(frames, len(lines.poses)) if lines.frames is None else _rows_of(lines.frames, frames, file)
    if rows is None:
        raise file.fault(
            f"{len(lines.poses):,} poses for the scans {frames[0]} to {frames[-1]} ({len(frames):,} scans). "
            "Expected one line per scan, the first for frame 0. "
            "Usual cause: poses of another sequence, or a file cut short."
        )
    if len(lines.poses) > len(frames):
        findings.note(
            file.name,
            f"{len(lines.poses):,} poses for {counted(len(frames), 'scan')}; the poses of other frames are not used.",
        )
    elif frames[0] > 0 and lines.frames is None:
        findings.note(file.name, f"the scans start at {frames[0]}, and there is one pose per scan: taken one to one.")
    _check_digits(lines.poses[rows, :3, 3], file, findings)
    lidar, frame, reason = to_lidar(lines.poses, parts, file, declared, findings)
    return LidarPoses(from_first(lidar[rows]), frame, reason, lidar[rows[0]])


def _check_digits(positions: FloatArray, file: SourceFile, findings: Findings) -> None:
    """Warn where (N, 3) positions of a map projection have lost their decimals."""
    is_projected = (np.abs(positions).min(axis=0) > _PROJECTED_M) & (np.ptp(positions, axis=0) > 1.0)
    is_coarse = (2 * positions == np.rint(2 * positions)).all(axis=0)
    if (is_projected & is_coarse).any():
        findings.warning(
            file.name,
            "all positions lie on a grid of half a metre or a whole one, and are as far off as that. Usual cause: "
            "coordinates of a map projection written with seven digits, or kept as float32. Write more digits, or "
            "subtract the first position before.",
        )


def _check_length(file: SourceFile, times: SourceFile, pose_count: int, findings: Findings) -> None:
    """Warn where there are not as many times as poses: both have a line per frame of their sequence."""
    count = len(times.lines())
    if count == pose_count:
        return
    findings.warning(
        file.name,
        f"{pose_count:,} poses, but {times.name} has {count:,} lines: they are of two sequences, or one was cut. "
        "Usual cause: poses of another sequence.",
    )


def _right_times(poses: LidarPoses, times_s: FloatArray, parts: DriveParts, findings: Findings) -> FloatArray | None:
    """Return times that go with the poses; None where they are in another unit, as those since 1970 are not."""
    passed_s = np.diff(times_s)
    if not (known := passed_s > 0).any():
        return times_s
    steps_m = poses.steps_m[known]
    speeds_mps = steps_m / passed_s[known]
    moving_mps = speeds_mps[(steps_m > _MOVED_M) & (times_s[0] < _SINCE_2001_S)]  # of later ones the unit is known
    if len(moving_mps) and (slow_mps := float(np.median(moving_mps))) < _MIN_SPEED_MPS:
        findings.warning(
            parts.file(parts.times or parts.scans).name,
            f"it drives at {slow_mps:.2g} m/s; times are not used. Usual cause: milliseconds, or smaller units.",
        )
        return None
    speed_mps = float(np.median(speeds_mps))
    if speed_mps < _MAX_SPEED_MPS:
        return times_s
    findings.warning(
        parts.file(parts.poses or parts.scans).name,
        f"with the times of the scans it moves at {speed_mps:,.0f} m/s (usual: under 40 m/s). Usual cause: times or "
        "poses of another drive, or poses that are not in metres.",
    )
    return times_s


def posed_frames(parts: DriveParts, frames: IntArray, findings: Findings) -> IntArray:
    """Leave out the scans of KITTI-360 that have no pose: it has none where the GNSS failed, and at the ends.

    In any other layout all are used, and where the poses cannot be read, which their reader says later.
    """
    if parts.layout != "kitti360" or parts.poses is None:
        return frames
    file = parts.file(parts.poses)
    try:
        numbers = read_poses(file).frames
    except InterLocError:
        return frames
    if numbers is None:
        return frames
    posed = frames[np.isin(frames, numbers)]
    if not len(posed):
        findings.error(
            file.fault(
                f"has poses for the frames {numbers[0]} to {numbers[-1]}, and none for the scans {frames[0]} to "
                f"{frames[-1]}. Usual cause: the poses of another drive."
            )
        )
        return frames
    if len(posed) < len(frames):
        missing = np.setdiff1d(frames, numbers)
        findings.note(
            file.name,
            f"{len(missing):,} of {len(frames):,} scans have no pose (frames {listed(missing)}) and are left out: "
            "KITTI-360 has none where the GNSS failed.",
        )
    return posed


def _rows_of(numbers: IntArray, frames: IntArray, file: SourceFile) -> IntArray:
    missing = np.setdiff1d(frames, numbers)
    if len(missing):
        raise file.fault(
            f"{len(missing):,} of {len(frames):,} scans have no pose (frames {listed(missing)}). "
            "Expected a line for every scan. KITTI-360 has no poses where the GNSS failed: leave those scans out."
        )
    return np.searchsorted(numbers, frames)


def _poses_from_georeference(georeference: Georeference | None, why_none: str, findings: Findings) -> LidarPoses:
    if georeference is None:
        raise DriveFileError(
            "oxts",
            f"gives no poses: {why_none}. Expected oxts/data/0000000000.txt, one file per scan, or a "
            "poses.txt of your own beside velodyne_points/.",
        )
    reason = "there is no poses.txt; the poses are those of the georeference"
    findings.note("oxts", reason)
    return LidarPoses(poses_of(georeference), "oxts", reason)


def _read_times(file: SourceFile, parts: DriveParts, frames: IntArray, findings: Findings) -> FloatArray | None:
    """Read the time of every scan, seconds; None where there is none that fits."""
    lines = [text.strip() for text in file.lines()]
    one_each = parts.layout in NUMBERED_ANYHOW and len(lines) == len(frames)
    rows = np.arange(len(lines)) if one_each else rows_by_frame(frames, len(lines))
    if rows is None:
        findings.warning(
            file.name, f"{len(lines):,} times for the scans {frames[0]} to {frames[-1]}; times are not used."
        )
        return None
    chosen = [lines[row] for row in rows]
    times = in_seconds(np.array([seconds_of(text) for text in chosen]))
    if not np.isfinite(times).all():
        row = int(np.argmax(~np.isfinite(times)))
        findings.warning(file.name, f"line {rows[row] + 1}: {chosen[row][:40]!r} is not a time; times are not used.")
        return None
    if len(times) > 1 and not np.ptp(times):
        findings.warning(
            file.name,
            f"all times are {chosen[0][:40]}: times are not used. Usual cause: seconds written with too few digits.",
        )
        return None
    if (np.diff(times) < 0).any():
        row = int(np.argmax(np.diff(times) < 0))
        findings.warning(file.name, f"line {rows[row + 1] + 1}: time runs backwards; times are not used.")
        return None
    return times
