"""Drives of any format as SemanticKITTI has them, label files of what labels are made of, and files of poses."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.layouts import NUMBERED_ANYHOW
from interloc.drives.levelling import LevelScans
from interloc.drives.open import DriveReading, read_drive
from interloc.drives.options import LABEL_FILES, ODOMETRY, DriveOptions, LabelFolder
from interloc.drives.scans.raw import RawScans
from interloc.drives.scans.reduced_format import is_reduced
from interloc.errors import ConfigError
from interloc.files import PARTIAL, atomic_folder, atomic_write
from interloc.labelling.networks import remission_scale
from interloc.processes import Progress, cores
from interloc.reduction.reduce import dropped_among, in_threads, is_contiguous, make_small_files

_POSES, _TUM_ENDING = "poses.txt", ".tum"
_ROAD, _OTHER_GROUND = 40, 49  # ids of SemanticKITTI
_READING_THREADS = 4


@dataclass(frozen=True)
class Converted:
    """A drive in SemanticKITTI's layout."""

    name: str
    scans: int
    labels: LabelFolder | None
    """Its label folder; None where the drive has no labels."""
    is_renumbered: bool
    """Whether its scans have other numbers than those of the original: 0, 1, 2, ..."""
    has_georeference: bool


def convert_drive(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    options: DriveOptions | None = None,
    *,
    progress: Progress | None = None,
) -> Converted:
    """Write a drive of any format but a reduced one as a SemanticKITTI sequence, which appears whole or not at all.

    It holds velodyne/NNNNNN.bin, labels/ or predictions/NNNNNN.label where there are labels (or they are made, by a
    network or by geometry), poses.txt (LiDAR frame), times.txt and geo.csv where times and fixes are known. Label ids
    that only their format knows, or that were given as those of road, become SemanticKITTI's: road, other-ground, or
    unlabelled. What is there already is not touched (ConfigError); an `OutputError` says that the folder could not be
    written, and nothing is left behind.
    """
    _refuse_what_is_there(Path(out), "folder")
    chosen = options or DriveOptions()
    label_folder, reading, scans = read_unreduced(Path(root), chosen, needs_labels=False)
    source, frames, labels = scans.recording.points, scans.frames, scans.labels
    numbers = frames if is_contiguous(frames) else np.arange(len(frames), dtype=np.int64)
    if chosen.model is not None or label_folder not in LABEL_FILES:
        label_folder = "predictions"
    copies = make_small_files(reading.trajectory, numbers, dropped_among(scans.parts.root, frames, numbers))
    scheme = reading.labels.scheme
    ids_of = None  # those of SemanticKITTI
    if scheme is not None and scheme.name != "semantickitti":
        ids_of = np.array([0, _ROAD, _OTHER_GROUND], np.uint32)[scheme.groups()]
    scale = np.array([1, 1, 1, remission_scale(scans.recording.sampled_remission())], np.float32)

    def write(row: int, folder: Path) -> None:
        frame, stem = int(frames[row]), f"{int(numbers[row]):06d}"
        points = source.read(frame)
        has_return = np.isfinite(points.values[:, :3]).all(axis=1)
        values = np.nan_to_num(points.values[has_return] / scale, posinf=0.0, neginf=0.0)
        values = values if len(values) else np.zeros((1, 4))  # an empty file would be one that was cut short
        (folder / "velodyne" / f"{stem}.bin").write_bytes(values.astype("<f4").tobytes())
        if labels is not None:
            ids = labels.of(frame, points, source.name(frame))
            if ids_of is not None:
                ids = ids_of[ids & 0xFFFF]
            (folder / label_folder / f"{stem}.label").write_bytes(ids[has_return].astype("<u4").tobytes() or bytes(4))

    names = ("velodyne", *((label_folder,) if labels is not None else ()))
    with atomic_folder(Path(out), marker=_POSES) as folder:
        for name in names:
            (folder / name).mkdir()
        threads = _READING_THREADS if labels is None or not labels.is_slow else cores()
        in_threads(lambda row: write(row, folder), range(len(frames)), threads, progress)
        copies.write_to(folder)
        _refuse_what_is_there(Path(out), "folder")  # somebody else may have been faster
    return Converted(
        name=scans.parts.drive_name,
        scans=len(frames),
        labels=label_folder if labels is not None else None,
        is_renumbered=numbers is not frames,
        has_georeference=reading.trajectory.georeference is not None,
    )


def _refuse_what_is_there(target: Path, kind: str) -> None:
    there = [each for each in target.iterdir() if PARTIAL not in each.name] if target.is_dir() else [target]
    if target.exists() and (kind == "file" or there):
        raise ConfigError(f"{target} is there already, and was not touched. Give another {kind} (-o), or remove it.")


def label_drive(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str] | None,
    options: DriveOptions,
    *,
    progress: Progress | None = None,
) -> tuple[Path, DriveReading]:
    """Write what a network, or geometry, says of all scans as .label files, in a folder that appears whole or not.

    The folder predictions/ is made in `out`, or in the drive's own; it must not be there already. The options have a
    `model`, or `labels` "geometry". Returns the folder, and what the drive is, with the labels of the scans looked
    into.
    """
    root = Path(root)
    if options.model is None and options.labels != "geometry":
        raise ConfigError("no model: give the folder of a network, or have the labels made by geometry.")
    inside = (root if root.is_dir() else root.parent) if out is None else Path(out)
    target = inside if inside.name == "predictions" else inside / "predictions"
    _refuse_what_is_there(target, "folder")
    _, reading, scans = read_unreduced(root, options)
    (source, labels), frames = scans.sources, scans.frames

    def write(frame: int, folder: Path) -> None:
        ids = labels.of(frame, source.read(frame), source.name(frame))
        (folder / f"{frame:06d}.label").write_bytes(ids.astype("<u4").tobytes())

    with atomic_folder(target, marker=f"{int(frames[-1]):06d}.label") as folder:
        in_threads(lambda frame: write(frame, folder), frames.tolist(), cores(), progress)
    return target, reading


def read_unreduced(
    root: Path, options: DriveOptions, *, needs_labels: bool = True, progress: Progress | None = None
) -> tuple[LabelFolder, DriveReading, RawScans]:
    """Read a drive that is not a reduced one, and by which labels; the first fault is raised."""
    findings = Findings(stop_at_first=True)
    with findings.stage():
        if is_reduced(root):
            raise DriveFileError(
                str(root), "is a reduced drive, which holds no scans. Expected the drive that it was made from."
            )
    ((folder, reading),) = read_drive(root, options, findings, needs_labels=needs_labels, progress=progress).items()
    assert isinstance(reading.scans, RawScans)
    return folder, reading, reading.scans


# Poses that were computed from the points, as a file that other programs read


@dataclass(frozen=True)
class WrittenPoses:
    """What was written."""

    name: str
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
    _refuse_what_is_there(target, "file")
    chosen = (options or DriveOptions()).model_copy(update={"poses": ODOMETRY})
    _, reading, scans = read_unreduced(root, chosen, needs_labels=False, progress=progress)
    trajectory = reading.trajectory
    assert trajectory.poses is not None
    poses, times_s = trajectory.poses.T_world_lidar, trajectory.times_s
    if isinstance(scans.recording.points, LevelScans):  # the file is of the sensor as it is mounted
        T_upright_lidar = np.eye(4)
        T_upright_lidar[:3, :3] = scans.recording.points.level
        poses = T_upright_lidar.T @ poses @ T_upright_lidar
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
