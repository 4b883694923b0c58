"""Reduction of a drive: the plan, known without its scans, its small files, and the writing of all in a folder."""

import io
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray, JsonObject
from interloc.config import KeyframeConfig
from interloc.detection.keyframes import select_keyframes
from interloc.drives.files import MAX_ROWS, GeoreferenceFile, list_numbered
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.folder import DROPPED, read_dropped
from interloc.drives.georeference.read import geo_csv_text, locate_georeference
from interloc.drives.layouts import DriveParts
from interloc.drives.levelling import LevelScans
from interloc.drives.open import DriveReading, read_drive
from interloc.drives.options import LABEL_FILES, DriveOptions, LabelFolder, ReadingOptions
from interloc.drives.poses.frame import CAMERA_CALIBRATIONS, CAMERA_TO_POSE, IMU_CALIBRATION, locate_calibration
from interloc.drives.scans.raw import RawScans
from interloc.drives.scans.reduced_format import (
    MANIFEST,
    MAX_POINTS,
    ReducedLabels,
    ReducedManifest,
    SourceScans,
    Thinning,
    encode_ground,
    ground_path,
    is_reduced,
    make_manifest,
    to_runs,
)
from interloc.drives.trajectory import Trajectory
from interloc.errors import ConfigError
from interloc.files import atomic_folder, reason_of
from interloc.processes import Progress

GEOREFERENCE_FOLDER = "georeference"
"""Where a georeference lies that came from outside of the drive."""

_MAX_WARNINGS = 100


@dataclass(frozen=True)
class ReductionPlan:
    """Which scans of a drive to keep, and all that is known without them."""

    kept: IntArray
    """(K,) int64: numbers of the scans to keep."""
    manifest: ReducedManifest
    """To be completed with `ReducedManifest.with_labels`."""
    copies: "SmallFileCopies"
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
        if poses_in_files:
            copies = gather_small_files(parts, frames, given)
        else:
            copies = make_small_files(trajectory, frames, dropped_among(parts.root, frames, frames))
        warnings = [each for each in findings.found if each.severity == "warning"][:_MAX_WARNINGS]
        manifest = make_manifest(
            {
                "name": parts.drive_name,
                "layout": parts.layout,
                "scans": to_runs(frames),
                "kept": to_runs(kept),
                "keyframes": thinning,
                "pose_frame": poses.frame if poses_in_files else "lidar",
                "pose_frame_reason": poses.reason if poses_in_files else "written with the reduction",
                "files": copies.files,
                "warnings": [{"path": each.path, "message": each.message} for each in warnings],
            }
        )
        return ReductionPlan(kept, manifest, copies)
    return None


@dataclass
class SmallFileCopies:
    """Which files go where."""

    files: JsonObject = field(default_factory=dict)
    """Their part of the manifest (`SmallFiles`)."""
    sources: dict[str, Path | bytes] = field(default_factory=dict)
    """Path in the reduced drive -> the file as it lies now, or what is to be written."""

    def write_to(self, folder: Path) -> None:
        """Copy them to a reduced drive; those that lie there already stay."""
        for name, source in self.sources.items():
            try:
                data = source if isinstance(source, bytes) else source.read_bytes()
            except OSError as error:
                raise DriveFileError(str(source), f"cannot be read: {reason_of(error)}.") from error
            target = folder / name
            if target != source:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)


def small_files_of(root: Path, manifest: ReducedManifest) -> list[str]:
    """Return the paths of the files of a reduced drive that are neither ground points nor its manifest."""
    places = [root / name for name in (DROPPED, *manifest.files.paths)]
    files = [file for place in places for file in (place.rglob("*") if place.is_dir() else [place]) if file.is_file()]
    return sorted(file.relative_to(root).as_posix() for file in files)


def dropped_among(root: Path, frames: IntArray, numbers: IntArray) -> IntArray:
    """Return what `read_dropped` gives of a drive, (D, 2), among some of its scans that have other numbers now."""
    after, count = read_dropped(root, frames).T
    row, which = np.unique(np.searchsorted(frames, after, side="right"), return_inverse=True)
    return np.column_stack([np.append(numbers[0] - 1, numbers)[row], np.bincount(which, count).astype(np.int64)])


def make_small_files(trajectory: Trajectory, frames: IntArray, dropped: IntArray) -> SmallFileCopies:
    """Write down what is known of the motion, where it does not lie in files of its own (bags, LAS)."""
    assert trajectory.poses is not None
    copies = SmallFileCopies({"poses": "poses.txt", "times": None, "calibration": [], "oxts": None, "geo": None})
    if len(dropped):
        rows = "".join(f"{after},{scans}\n" for after, scans in dropped.tolist())
        copies.sources[DROPPED] = f"after_frame,scans\n{rows}".encode()
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


# The reduction


_THREADS = 4  # more than reading and deflating of one drive can use


@dataclass(frozen=True)
class Reduction:
    """A drive that is ready to be reduced, scan by scan, in any order and by any process."""

    plan: ReductionPlan
    manifest: ReducedManifest
    """Complete; to be written last."""
    scans: dict[LabelFolder, RawScans]
    """Where the points are read from, for every label folder."""
    is_georeferenced: bool

    def write_ground(self, frame: int, folder: Path) -> None:
        """Write the ground points of a scan into a reduced drive, by every label folder."""
        for labels, scans in self.scans.items():
            (folder / ground_path(labels, frame)).write_bytes(reduce_scan(scans, frame))

    def write_rest(self, folder: Path) -> None:
        """Write the small files and, last, the manifest."""
        self.plan.copies.write_to(folder)
        (folder / MANIFEST).write_bytes(self.manifest.to_bytes())


def reduce_scan(scans: RawScans, frame: int) -> bytes:
    """Return the .ground file of a scan: a pure function of its scan and labels."""
    points = scans.read(frame)
    if len(points.xyz) > MAX_POINTS:
        raise DriveFileError(
            scans.name(frame), f"{len(points.xyz):,} ground points; no scan has more than {MAX_POINTS:,}."
        )
    return encode_ground(points)


def prepare_reduction(
    root: str | os.PathLike[str],
    options: ReadingOptions | None = None,
    *,
    label_folders: Sequence[LabelFolder] | None = None,
    keyframes: KeyframeConfig | None = None,
) -> Reduction:
    """Check a drive as `open_drive` does, and find out all that its reduction needs.

    Ground points are chosen by the labels of `label_folders`, with None by all of which there are files. The keyframes
    by these settings are kept, with None all scans. A reduced drive is refused.
    """
    root, findings, chosen = Path(root), Findings(stop_at_first=True), DriveOptions.of(options)
    with findings.stage():
        folders = label_folders or label_folders_in(root, chosen)
        if is_reduced(root):
            raise DriveFileError(str(root), "is a reduced drive already. Expected a drive with its scans.")
    readings = read_drive(root, chosen, findings, label_folders=folders)
    return reduction_of(readings, chosen, findings, keyframes)


def reduction_of(
    readings: dict[LabelFolder, DriveReading],
    options: DriveOptions,
    findings: Findings,
    keyframes: KeyframeConfig | None,
) -> Reduction:
    """Find out what the reduction of a drive needs that was read by each of its label folders without an error."""
    labels, scans = [], {}
    for folder, reading in readings.items():
        assert reading.drive is not None  # else a fault was found
        source = reading.drive.scans
        assert isinstance(source, RawScans)
        scans[folder] = source
        labels.append(ReducedLabels.of(folder, source.scheme, reading.labels.counts, source.facts.label_bytes))
    first = next(iter(readings.values()))
    assert isinstance(first.scans, RawScans)
    assert first.trajectory.poses is not None
    if any(not np.array_equal(each.frames, first.scans.frames) for each in scans.values()):
        raise ConfigError(f"the labels {' and '.join(scans)} are of different scans: give one of them (--labels).")
    is_whole = first.trajectory.poses.T_file_world is not None  # else their lines are of other scans
    plan = plan_of(
        first.scans.parts,
        first.scans.frames,
        first.trajectory,
        options.oxts,
        keyframes,
        findings,
        poses_in_files=first.scans.recording.has_pose_files
        and (is_whole or first.trajectory.poses.frame == "oxts")
        and options.frames is None
        and not isinstance(first.scans.recording.points, LevelScans),  # points are written upright
    )
    assert plan is not None
    sizes = SourceScans.model_validate(first.scans.facts.model_dump(include=set(SourceScans.model_fields)))
    is_georeferenced = first.trajectory.georeference is not None
    return Reduction(plan, plan.manifest.with_labels(labels, sizes), scans, is_georeferenced)


def reduce_drive(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    options: ReadingOptions | None = None,
    *,
    label_folders: Sequence[LabelFolder] | None = None,
    keyframes: KeyframeConfig | None = None,
    progress: Progress | None = None,
) -> ReducedManifest:
    """Write a reduced drive, which appears whole or not at all, by the options of `prepare_reduction`.

    An older reduced drive at `out` is replaced; an `OutputError` says that something else is there, or that it could
    not be written, and nothing is left behind. `progress` is called with the scans done and the scans in all.
    """
    reduction = prepare_reduction(root, options, label_folders=label_folders, keyframes=keyframes)
    frames = [int(frame) for frame in reduction.plan.kept]
    with atomic_folder(Path(out), marker=MANIFEST, names=(DROPPED, "ground", GEOREFERENCE_FOLDER)) as folder:
        for labels in reduction.scans:
            (folder / ground_path(labels, 0)).parent.mkdir(parents=True)
        in_threads(lambda frame: reduction.write_ground(frame, folder), frames, _THREADS, progress)
        reduction.write_rest(folder)
    return reduction.manifest


def in_threads(work: Callable[[int], None], items: Sequence[int], threads: int, progress: Progress | None) -> None:
    """Do the work for each item; reading, deflating, networks and writing wait for no interpreter."""
    pool = ThreadPoolExecutor(threads)
    try:
        for done, _ in enumerate(pool.map(work, items), start=1):
            if progress is not None:
                progress(done, len(items))
    finally:
        pool.shutdown(cancel_futures=True)


def label_folders_in(root: Path, options: DriveOptions) -> tuple[LabelFolder, ...]:
    """Return by which labels a drive can be reduced: the one that was asked for, or all of which there are files."""
    if options.model is not None:
        return ("predictions",)  # what a network says counts as such
    if options.labels != "auto":
        return (options.labels,)
    inside = root if root.is_dir() else root.parent
    return tuple(folder for folder in LABEL_FILES if (inside / folder).is_dir())
