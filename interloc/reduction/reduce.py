"""Reduction of a drive in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from interloc.config import KeyframeConfig
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.open import DriveReading, read_drive
from interloc.drives.options import LABEL_FILES, DriveOptions, LabelFolder, ReadingOptions
from interloc.drives.scans.raw import RawScans
from interloc.drives.scans.reduced_format import (
    MANIFEST,
    MAX_POINTS,
    ReducedLabels,
    ReducedManifest,
    SourceScans,
    encode_ground,
    ground_path,
    is_reduced,
)
from interloc.files import atomic_folder
from interloc.processes import Progress
from interloc.reduction.plan import ReductionPlan, plan_of

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
    assert first.scans.frames is not None
    plan = plan_of(
        first.scans.parts,
        first.scans.frames,
        first.trajectory,
        options.oxts,
        keyframes,
        findings,
        poses_in_files=first.scans.recording.has_pose_files and options.frames is None,
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
    with atomic_folder(Path(out), marker=MANIFEST) as folder:
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
