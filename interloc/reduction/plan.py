"""What a reduced drive will hold: worked out from the small files of a drive and the numbers of its scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.config import KeyframeConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drives.checks import sample_indices
from interloc.drives.files import rows_of_part
from interloc.drives.findings import DriveFileError, Finding, Findings
from interloc.drives.labels import LabelJudgement, judge_labels
from interloc.drives.layouts import DriveParts, ScanFolder, find_layout
from interloc.drives.open import SAMPLED_SCANS
from interloc.drives.options import DriveOptions, LabelFolder, LayoutChoice, ReadingOptions
from interloc.drives.scans.reduced_format import (
    MANIFEST,
    MAX_SCANS,
    ReducedManifest,
    Thinning,
    is_reduced,
    make_manifest,
    to_runs,
)
from interloc.drives.trajectory import Trajectory, posed_frames, read_trajectory
from interloc.reduction.small_files import SmallFileCopies, gather_small_files, make_small_files


@dataclass(frozen=True)
class ReductionPlan:
    """Which scans of a drive to keep, and all that is known without them."""

    options: DriveOptions
    """How the drive is read."""
    frames: IntArray
    """(N,) int64: numbers of all scans, ascending."""
    frames_to_send: IntArray
    """(K,) int64: numbers of the scans to keep; empty where the poses cannot be read."""
    frames_to_look_into: IntArray
    """(M,) int64: numbers of the scans whose label ids are counted to find the label scheme (see `judge_counts`)."""
    layout: str | None
    pose_frame: str | None
    pose_frame_reason: str | None
    """Whose poses the pose file holds, and why that is thought."""
    georeference: str | None
    georeference_reason: str | None
    """Where it comes from; why there is none."""
    length_m: float | None
    """Distance driven over the scans."""
    problems: list[Finding]
    manifest: ReducedManifest | None
    """To be completed with `ReducedManifest.with_labels`; None where the poses cannot be read."""
    copies: SmallFileCopies
    """Which files go where in the reduced drive."""

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self.frames)

    @property
    def ok(self) -> bool:
        """True where nothing makes the drive unusable."""
        return not any(problem.severity == "error" for problem in self.problems)


def plan_reduction(
    root: Path,
    frames: Sequence[int] | IntArray,
    options: ReadingOptions | None = None,
    *,
    keyframes: KeyframeConfig | None = KeyframeConfig(),  # noqa: B008 - frozen
    scan_folder: ScanFolder | None = None,
) -> ReductionPlan:
    """Plan the reduction of a drive whose scans need not be there yet.

    Parameters
    ----------
    root
        Folder with the small files: poses, calibration, times, oxts/, geo.csv.
    frames : (N,) int
        Numbers of all scans of the drive.
    options : ReadingOptions or None
        How the drive is read.
    keyframes : KeyframeConfig or None
        Scans to keep: the keyframes by these settings; None: all.
    scan_folder : {"velodyne", "velodyne_points/data"} or None
        Where the drive has its scans; None: where they lie in `root`, or else as the small files suggest.

    Returns
    -------
    ReductionPlan
        With all findings; a bad drive raises nothing.

    Raises
    ------
    ConfigError
        An unknown option or choice.
    """
    chosen, findings = DriveOptions.of(options), Findings(stop_at_first=False)
    numbers, parts, trajectory = np.empty(0, np.int64), None, Trajectory()
    with findings.stage():
        if is_reduced(root):
            raise DriveFileError(MANIFEST, "is there already: the drive is a reduced one, and has no scans to reduce.")
        numbers = checked_frames(frames)
        parts = find_layout(root, chosen, announced=scan_folder or _likely_scan_folder(root, chosen.layout))
        numbers = posed_frames(parts, numbers, findings)
        trajectory = read_trajectory(parts, numbers, chosen, findings)
        if chosen.frames is not None:
            rows = rows_of_part(chosen.frames, numbers, parts.file(parts.scans).name)
            numbers, trajectory = numbers[rows], trajectory.part(rows)
    return plan_of(parts, numbers, trajectory, chosen, keyframes, findings)


def plan_of(
    parts: DriveParts | None,
    frames: IntArray,
    trajectory: Trajectory,
    options: DriveOptions,
    keyframes: KeyframeConfig | None,
    findings: Findings,
    *,
    poses_in_files: bool = True,
) -> ReductionPlan:
    """Make the plan of what is known of a drive.

    Parameters
    ----------
    poses_in_files : bool
        Whether poses, times and georeference lie in small files that can be copied.
    """
    poses, georeference = trajectory.poses, trajectory.georeference
    kept, manifest, copies = np.empty(0, np.int64), None, SmallFileCopies()
    if parts is not None and poses is not None:
        kept = frames if keyframes is None else frames[select_keyframes(poses.T_world_lidar, keyframes)]
        thinning = None
        if keyframes is not None:
            thinning = Thinning(distance_m=keyframes.distance_m, angle_deg=keyframes.angle_deg)
        with findings.stage():
            if poses_in_files:
                copies = gather_small_files(parts, frames, options.oxts)
            else:
                copies = make_small_files(trajectory, frames)
            manifest = make_manifest(
                {
                    "name": parts.drive_name,
                    "layout": parts.layout,
                    "scans": to_runs(frames),
                    "kept": to_runs(kept),
                    "keyframes": thinning,
                    "pose_frame": poses.frame if poses_in_files else "lidar",
                    "pose_frame_reason": poses.reason,
                    "files": copies.files,
                    "warnings": [
                        {"path": each.path, "message": each.message}
                        for each in findings.found
                        if each.severity == "warning"
                    ][:100],
                }
            )
    return ReductionPlan(
        options=options,
        frames=frames,
        frames_to_send=kept,
        frames_to_look_into=frames[sample_indices(np.arange(len(frames)), SAMPLED_SCANS)],
        layout=parts.layout if parts else None,
        pose_frame=poses.frame if poses else None,
        pose_frame_reason=poses.reason if poses else None,
        georeference=georeference.source if georeference else None,
        georeference_reason=None if georeference else trajectory.georeference_reason,
        length_m=poses.length_m if poses else None,
        problems=findings.found,
        manifest=manifest,
        copies=copies,
    )


def judge_counts(
    plan: ReductionPlan, label_folder: LabelFolder, counts: dict[int, int]
) -> tuple[LabelJudgement, list[Finding]]:
    """Find out what label ids mean, as `open_drive` does.

    Parameters
    ----------
    counts : dict of int to int
        How many points of the scans `frames_to_look_into` carry each id.

    Returns
    -------
    LabelJudgement
        Its scheme is None where nothing was counted and no scheme was named.
    list of Finding
        An error among them where no point is road, or the ids contradict the scheme that was named.
    """
    findings = Findings(stop_at_first=False)
    judgement = judge_labels(
        label_folder,
        counts,
        plan.options.label_scheme,
        kitti360=plan.layout == "kitti360",
        check=True,
        findings=findings,
    )
    return judgement, findings.found


def checked_frames(frames: Sequence[int] | IntArray) -> IntArray:
    """Return scan numbers in ascending order.

    Raises
    ------
    DriveError
        There are none or too many, or one is negative or comes twice.
    """
    if not 0 < len(frames) <= MAX_SCANS:
        raise DriveFileError("scans", f"{len(frames):,} scans; expected 1 to {MAX_SCANS:,}.")
    if any(not 0 <= int(frame) <= 10**15 for frame in frames):
        raise DriveFileError("scans", "a scan number is negative or larger than any. Expected numbers from 0 on.")
    numbers, counts = np.unique(np.asarray(frames, dtype=np.int64), return_counts=True)
    if (counts > 1).any():
        raise DriveFileError("scans", f"scan {numbers[np.argmax(counts > 1)]} comes twice. Expected every number once.")
    return numbers


def _likely_scan_folder(root: Path, layout: LayoutChoice) -> ScanFolder:
    """Guess from the small files where the scans of a drive would be."""
    if layout == "auto" and not (root / "velodyne").is_dir():
        no_poses = (root / "oxts").is_dir() and not (root / "poses.txt").exists()
        layout = "kitti_raw" if no_poses or (root / "velodyne_points").is_dir() else layout
    return "velodyne_points/data" if layout == "kitti_raw" else "velodyne"
