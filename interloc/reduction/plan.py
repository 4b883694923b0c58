"""What a reduced drive will hold, known without its scans: which of them it keeps, its manifest, its small files."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import IntArray
from interloc.config import KeyframeConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drives.files import MAX_ROWS, GeoreferenceFile, list_numbered
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.folder import DROPPED
from interloc.drives.georeference.read import geo_csv_text, locate_georeference
from interloc.drives.layouts import DriveParts
from interloc.drives.poses.frame import CAMERA_CALIBRATIONS, CAMERA_TO_POSE, IMU_CALIBRATION, locate_calibration
from interloc.drives.scans.reduced_format import ReducedManifest, Thinning, make_manifest, to_runs
from interloc.drives.trajectory import Trajectory
from interloc.files import reason_of

GEOREFERENCE_FOLDER = "georeference"
"""Where a georeference lies that came from outside of the drive."""

_MAX_WARNINGS = 100


@dataclass(frozen=True)
class ReductionPlan:
    """Which scans of a drive to keep, and all that is known without them."""

    frames: IntArray
    """(N,) int64: numbers of all scans, ascending."""
    kept: IntArray
    """(K,) int64: numbers of the scans to keep."""
    manifest: ReducedManifest
    """To be completed with `ReducedManifest.with_labels`."""
    copies: SmallFileCopies
    """Which files go where in the reduced drive."""


def plan_of(
    parts: DriveParts,
    frames: IntArray,
    trajectory: Trajectory,
    given: Path | None,
    keyframes: KeyframeConfig | None,
    findings: Findings,
    *,
    poses_in_files: bool = True,
) -> ReductionPlan | None:
    """Make the plan of what is known of a drive, whose scans have the numbers `frames` ((N,) int64).

    A georeference may be given from elsewhere. The keyframes by these settings are kept, with None all scans.
    `poses_in_files` says whether poses, times and georeference lie in small files that can be copied. None where the
    poses are not known, or files cannot be gathered, which `findings` then says.
    """
    poses = trajectory.poses
    if poses is None:
        return None
    kept = frames if keyframes is None else frames[select_keyframes(poses.T_world_lidar, keyframes)]
    thinning = None
    if keyframes is not None:
        thinning = Thinning(distance_m=keyframes.distance_m, angle_deg=keyframes.angle_deg)
    with findings.stage():
        copies = gather_small_files(parts, frames, given) if poses_in_files else make_small_files(trajectory, frames)
        warnings = [each for each in findings.found if each.severity == "warning"][:_MAX_WARNINGS]
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
                "warnings": [{"path": each.path, "message": each.message} for each in warnings],
            }
        )
        return ReductionPlan(frames, kept, manifest, copies)
    return None


@dataclass
class SmallFileCopies:
    """Which files go where."""

    files: dict[str, Any] = field(default_factory=dict)
    """Their part of the manifest (`SmallFiles`)."""
    sources: dict[str, Path | bytes] = field(default_factory=dict)
    """Path in the reduced drive -> the file as it lies now, or what is to be written."""

    def write_to(self, folder: Path) -> int:
        """Copy them to a reduced drive; those that lie there already stay."""
        size = 0
        for name, source in self.sources.items():
            try:
                data = source if isinstance(source, bytes) else source.read_bytes()
            except OSError as error:
                raise DriveFileError(str(source), f"cannot be read: {reason_of(error)}.") from error
            target = folder / name
            if target != source:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            size += len(data)
        return size


def make_small_files(trajectory: Trajectory, frames: IntArray) -> SmallFileCopies:
    """Write down what is known of the motion, where it does not lie in files of its own (bags, LAS)."""
    assert trajectory.poses is not None
    copies = SmallFileCopies({"poses": "poses.txt", "times": None, "calibration": [], "oxts": None, "geo": None})
    contiguous = is_contiguous(frames)
    lines = io.StringIO()
    numbers = trajectory.poses.T_world_lidar[:, :3].reshape(-1, 12)
    for frame, row in zip(frames, numbers.tolist(), strict=True):
        front = "" if contiguous else f"{frame} "
        lines.write(front + " ".join(map(repr, row)) + "\n")
    copies.sources["poses.txt"] = lines.getvalue().encode()
    times = trajectory.times_s
    if times is not None and not contiguous:  # one line per frame, also for those without a scan
        times = np.interp(np.arange(frames[-1] + 1), frames, times) if frames[-1] < MAX_ROWS else None
    if times is not None:
        copies.files["times"] = "times.txt"
        copies.sources["times.txt"] = "".join(f"{time!r}\n" for time in times.tolist()).encode()
    if trajectory.georeference is not None:
        copies.files["geo"] = "geo.csv"
        copies.sources["geo.csv"] = geo_csv_text(frames, trajectory.georeference, exact=True).encode()
    return copies


def is_contiguous(frames: IntArray) -> bool:
    """Return whether ascending scan numbers leave none out."""
    return int(frames[-1] - frames[0]) == len(frames) - 1


def gather_small_files(parts: DriveParts, frames: IntArray, given: Path | None) -> SmallFileCopies:
    """Find all files that reading the drive needs besides scans and labels.

    Those inside the drive keep their paths. Of a KITTI raw drive that was given as georeference, the OXTS files of the
    drive's frames are taken, under the numbers of the drive.
    """
    copies = SmallFileCopies()

    def take(path: Path, otherwise: str = "") -> str:
        """Note a file under its path in the drive, or under another name where it lies outside."""
        name = path.relative_to(parts.root).as_posix() if _is_inside(path, parts.root) else otherwise or path.name
        copies.sources[name] = path
        return name

    found = locate_georeference(parts, frames, given)
    own_imu = locate_calibration(parts, IMU_CALIBRATION)
    imu = own_imu if found is None else found.imu_calibration
    calibrations = []
    if imu is not None:
        beside_given = given is not None and imu != own_imu
        calibrations.append(take(imu, f"{GEOREFERENCE_FOLDER}/{IMU_CALIBRATION}" if beside_given else ""))
    cameras = (locate_calibration(parts, *CAMERA_CALIBRATIONS), locate_calibration(parts, CAMERA_TO_POSE))
    calibrations += [take(path) for path in cameras if path is not None]

    oxts = geo = None
    if found is not None and found.kind == "folder":
        assert found.rows is not None
        oxts = _take_folder(copies, found.path, found.rows, frames, parts)
    elif found is not None:
        packed = ".gz" if found.path.suffix == ".gz" else ""
        name = "geo.csv" if found.kind == "geo" else "oxts.txt"
        place = take(found.path, f"{GEOREFERENCE_FOLDER}/{name}{packed}")
        oxts, geo = (None, place) if found.kind == "geo" else (place, None)
    if (parts.root / DROPPED).is_file():
        take(parts.root / DROPPED)
    copies.files = {
        "poses": None if parts.poses is None else take(parts.poses),
        "times": None if parts.times is None else take(parts.times),
        "calibration": calibrations,
        "oxts": oxts,
        "geo": geo,
    }
    return copies


def _take_folder(copies: SmallFileCopies, folder: Path, rows: IntArray, frames: IntArray, parts: DriveParts) -> str:
    """Note the OXTS files of the frames; return their folder in the reduced drive."""
    files = list_numbered(GeoreferenceFile(folder, parts.root), ".txt")
    if _is_inside(folder, parts.root) and np.array_equal(rows, frames):
        place = folder.relative_to(parts.root).as_posix()
        digits = files.digits
    else:
        place, digits = f"{GEOREFERENCE_FOLDER}/oxts", 10
    there = np.isin(rows, files.numbers)  # a missing fix is the complaint of who reads them
    for frame, row in zip(frames[there].tolist(), rows[there].tolist(), strict=True):
        copies.sources[f"{place}/{frame:0{digits}d}.txt"] = files.path(row)
    return place


def _is_inside(path: Path, root: Path) -> bool:
    return path.is_relative_to(root) and ".." not in path.relative_to(root).parts
