"""What a reduced drive will hold: worked out from the small files of a drive and the numbers of its scans."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.config import KeyframeConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drives.checks import sample_indices
from interloc.drives.findings import DriveFileError, Finding, Findings
from interloc.drives.found import Survey
from interloc.drives.layouts import ScanFolder, find_layout
from interloc.drives.open import drive_options
from interloc.drives.options import DriveOptions, LabelFolder, LayoutChoice, PoseFrame
from interloc.drives.scans.labels import LabelJudgement, judge_labels, named_scheme
from interloc.drives.scans.reduced_format import (
    MANIFEST,
    MAX_SCANS,
    ReducedManifest,
    Thinning,
    is_reduced,
    make_manifest,
    to_runs,
)
from interloc.drives.survey import SAMPLED_SCANS
from interloc.drives.trajectory import read_track
from interloc.reduction.small_files import SmallFileCopies, gather_small_files


@dataclass(frozen=True)
class ReductionPlan:
    """Which scans of a drive to keep, and all that is known without them.

    Attributes
    ----------
    root : Path
        Folder of the small files.
    options : DriveOptions
        How the drive is read.
    label_folders : tuple of str
        Labels by which ground points are chosen, "labels", "predictions" or both.
    frames : (N,) int64
        Numbers of all scans, ascending.
    frames_to_send : (K,) int64
        Numbers of the scans to keep; empty where the poses cannot be read.
    frames_to_look_into : (M,) int64
        Numbers of the scans whose label ids tell the label scheme (see `judge_counts`).
    layout : str or None
    pose_frame, pose_frame_reason : str or None
        Whose poses the pose file holds, and why that is thought.
    georeference, georeference_reason : str or None
        Where it comes from; why there is none.
    length_m : float or None
        Way driven over the scans.
    problems : list of Finding
    manifest : ReducedManifest or None
        To be completed with `ReducedManifest.with_labels`; None where the poses cannot be read.
    copies : SmallFileCopies
        Which files go where in the reduced drive.
    """

    root: Path
    options: DriveOptions
    label_folders: tuple[LabelFolder, ...]
    frames: IntArray
    frames_to_send: IntArray
    frames_to_look_into: IntArray
    layout: str | None
    pose_frame: str | None
    pose_frame_reason: str | None
    georeference: str | None
    georeference_reason: str | None
    length_m: float | None
    problems: list[Finding]
    manifest: ReducedManifest | None
    copies: SmallFileCopies

    @property
    def scans(self) -> int:
        """Number of scans."""
        return len(self.frames)

    @property
    def ok(self) -> bool:
        """True where nothing makes the drive unusable."""
        return not any(problem.severity == "error" for problem in self.problems)


def plan_reduction(
    root: str | os.PathLike[str],
    frames: Sequence[int] | IntArray,
    *,
    label_folders: Sequence[LabelFolder] = ("labels",),
    label_scheme: str | Collection[int] = "auto",
    pose_frame: PoseFrame = "auto",
    layout: LayoutChoice = "auto",
    oxts: str | os.PathLike[str] | None = None,
    name: str | None = None,
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
    label_folders, label_scheme, pose_frame, layout, oxts, name
        As of `open_drive`; label folders may be one or both.
    keyframes : KeyframeConfig or None
        Scans to keep: the keyframes by these settings; None: all.
    scan_folder : {"velodyne", "velodyne_points/data"} or None
        Where the drive has its scans; None: where they lie in `root`, or else as the small files suggest.

    Returns
    -------
    ReductionPlan
        With all problems; a bad drive raises nothing.

    Raises
    ------
    ConfigError
        An option without meaning.
    """
    options = drive_options(
        labels=label_folders[0],
        label_scheme=label_scheme,
        pose_frame=pose_frame,
        layout=layout,
        oxts=oxts,
        name=name,
    )
    for labels in label_folders:
        replace(options, labels=labels)  # refuses folders that are none
    named_scheme(options.label_scheme)
    folder, findings, found = Path(root), Findings(stop_at_first=False), Survey()
    with findings.stage():
        if is_reduced(folder):
            raise DriveFileError(MANIFEST, "is there already: the drive is a reduced one, and has no scans to reduce.")
        found.frames = checked_frames(frames)
        found.parts = find_layout(folder, options, announced=scan_folder or _likely_scan_folder(folder, layout))
        read_track(found, options, findings)
    return plan_of(found, folder, options, tuple(label_folders), keyframes, findings)


def plan_of(
    found: Survey,
    root: Path,
    options: DriveOptions,
    label_folders: tuple[LabelFolder, ...],
    keyframes: KeyframeConfig | None,
    findings: Findings,
) -> ReductionPlan:
    """Make the plan of what is known of a drive."""
    frames = np.empty(0, np.int64) if found.frames is None else found.frames
    kept, length_m, manifest, copies = np.empty(0, np.int64), None, None, SmallFileCopies()
    if found.parts is not None and found.T_world_lidar is not None:
        kept = frames if keyframes is None else frames[select_keyframes(found.T_world_lidar, keyframes)]
        length_m = float(np.linalg.norm(np.diff(found.T_world_lidar[:, :3, 3], axis=0), axis=1).sum())
        with findings.stage():
            copies = gather_small_files(found.parts, frames, options.oxts)
            manifest = _manifest(found, kept, keyframes, copies)
    return ReductionPlan(
        root=root,
        options=options,
        label_folders=label_folders,
        frames=frames,
        frames_to_send=kept,
        frames_to_look_into=frames[sample_indices(np.arange(len(frames)), SAMPLED_SCANS)],
        layout=found.parts.layout if found.parts else None,
        pose_frame=found.pose_frame or None,
        pose_frame_reason=found.pose_frame_reason or None,
        georeference=found.georeference.source if found.georeference else None,
        georeference_reason=None if found.georeference else found.georeference_reason,
        length_m=length_m,
        problems=findings.found,
        manifest=manifest,
        copies=copies,
    )


def judge_counts(
    plan: ReductionPlan, label_folder: LabelFolder, counts: dict[int, int]
) -> tuple[LabelJudgement, list[Finding]]:
    """Tell what label ids mean, as `open_drive` does.

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
        There are none, too many, negative ones, or the same twice.
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
    """Tell from the small files where the scans of a drive would be."""
    if layout == "auto" and not (root / "velodyne").is_dir():
        no_poses = (root / "oxts").is_dir() and not (root / "poses.txt").exists()
        layout = "kitti_raw" if no_poses or (root / "velodyne_points").is_dir() else layout
    return "velodyne_points/data" if layout == "kitti_raw" else "velodyne"


def _manifest(
    found: Survey, kept: IntArray, keyframes: KeyframeConfig | None, copies: SmallFileCopies
) -> ReducedManifest:
    """Write down what is known."""
    assert found.parts is not None
    assert found.frames is not None
    return make_manifest(
        {
            "name": found.parts.drive_name,
            "layout": found.parts.layout,
            "scans": to_runs(found.frames),
            "kept": to_runs(kept),
            "keyframes": None
            if keyframes is None
            else Thinning(distance_m=keyframes.distance_m, angle_deg=keyframes.angle_deg),
            "pose_frame": found.pose_frame,
            "pose_frame_reason": found.pose_frame_reason,
            "files": copies.files,
        }
    )
