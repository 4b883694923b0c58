"""Reduction of a drive in a folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

from interloc.config import KeyframeConfig
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.open import drive_options
from interloc.drives.options import LabelFolder, LayoutChoice, PoseFrame
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
from interloc.drives.survey import survey
from interloc.files import atomic_folder
from interloc.reduction.plan import ReductionPlan, plan_of

Progress = Callable[[int, int], None]
"""Called with the scans done and the scans in all."""

_THREADS = 4  # more than reading and deflating of one drive can use


@dataclass(frozen=True)
class Reduction:
    """A drive that is ready to be reduced, scan by scan, in any order and by any process.

    Attributes
    ----------
    plan : ReductionPlan
    manifest : ReducedManifest
        Complete; to be written last.
    scans : dict of str to RawScans
        Where the points are read from, for every label folder.
    """

    plan: ReductionPlan
    manifest: ReducedManifest
    scans: dict[LabelFolder, RawScans]

    def write_ground(self, frame: int, folder: Path) -> None:
        """Write the ground points of a scan into a reduced drive, by every label folder."""
        for labels, scans in self.scans.items():
            (folder / ground_path(labels, frame)).write_bytes(reduce_scan(scans, frame))

    def write_rest(self, folder: Path) -> None:
        """Write the small files and, last, the manifest."""
        self.plan.copies.write_to(folder)
        (folder / MANIFEST).write_bytes(self.manifest.to_bytes())


def reduce_scan(scans: RawScans, frame: int) -> bytes:
    """Return the .ground file of a scan: a pure function of its scan and labels.

    Raises
    ------
    DriveError
        They are damaged or do not fit together, or there are more points than any scan has.
    """
    points = scans.read(frame)
    if len(points.xyz) > MAX_POINTS:
        raise DriveFileError(
            scans.name(frame), f"{len(points.xyz):,} ground points; no scan has more than {MAX_POINTS:,}."
        )
    return encode_ground(points)


def prepare_reduction(
    root: str | os.PathLike[str],
    *,
    label_folders: Sequence[LabelFolder] | None = None,
    label_scheme: str | Collection[int] = "auto",
    pose_frame: PoseFrame = "auto",
    layout: LayoutChoice = "auto",
    oxts: str | os.PathLike[str] | None = None,
    name: str | None = None,
    keyframes: KeyframeConfig | None = None,
) -> Reduction:
    """Check a drive as `open_drive` does, and find out all that its reduction needs.

    Parameters
    ----------
    root
        Folder of the drive, with its scans.
    label_folders : sequence of {"labels", "predictions"}, or None
        By which labels ground points are chosen; None: by all that are there.
    label_scheme, pose_frame, layout, oxts, name
        As of `open_drive`.
    keyframes : KeyframeConfig or None
        Scans to keep: the keyframes by these settings; None: all.

    Raises
    ------
    DriveError, GeoreferenceError
        The drive is damaged, something in it does not fit together, or it is a reduced one.
    ConfigError
        An option without meaning.
    """
    root, findings = Path(root), Findings(stop_at_first=True)
    with findings.stage():
        chosen = label_folders_in(root) if label_folders is None else tuple(dict.fromkeys(label_folders))
        if is_reduced(root):
            raise DriveFileError(str(root), "is a reduced drive already. Expected a drive with its scans.")
    options = drive_options(
        labels=chosen[0],
        label_scheme=label_scheme,
        pose_frame=pose_frame,
        layout=layout,
        oxts=oxts,
        name=name,
    )
    found = {labels: survey(root, replace(options, labels=labels), findings) for labels in chosen}
    first = found[chosen[0]]
    plan = plan_of(first, root, options, chosen, keyframes, findings)
    assert plan.manifest is not None
    labels, scans = [], {}
    for folder, part in found.items():
        assert part.contents is not None
        assert part.drive is not None
        assert isinstance(part.drive.ground, RawScans)
        scans[folder] = part.drive.ground
        label_bytes = int(part.drive.ground.label_files.sizes.sum())
        labels.append(ReducedLabels.of(folder, part.drive.scheme, part.labels.counts, label_bytes))
    assert first.contents is not None
    report = first.contents.report(first)
    source = SourceScans.model_validate({field: report[field] for field in SourceScans.model_fields})
    return Reduction(plan, plan.manifest.with_labels(labels, source), scans)


def reduce_drive(
    root: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    label_folders: Sequence[LabelFolder] | None = None,
    label_scheme: str | Collection[int] = "auto",
    pose_frame: PoseFrame = "auto",
    layout: LayoutChoice = "auto",
    oxts: str | os.PathLike[str] | None = None,
    name: str | None = None,
    keyframes: KeyframeConfig | None = None,
    progress: Progress | None = None,
) -> ReducedManifest:
    """Write a reduced drive, which appears whole or not at all.

    Parameters
    ----------
    root, label_folders, label_scheme, pose_frame, layout, oxts, name, keyframes
        As of `prepare_reduction`.
    out
        Folder to be made; an older reduced drive there is replaced.
    progress
        Called with the scans done and the scans in all.

    Raises
    ------
    DriveError, GeoreferenceError, ConfigError
        As of `prepare_reduction`, or a scan that is kept is damaged.
    OutputError
        `out` is something else, or could not be written; nothing is left behind.
    """
    reduction = prepare_reduction(
        root,
        label_folders=label_folders,
        label_scheme=label_scheme,
        pose_frame=pose_frame,
        layout=layout,
        oxts=oxts,
        name=name,
        keyframes=keyframes,
    )
    frames = [int(frame) for frame in reduction.plan.frames_to_send]
    with atomic_folder(Path(out), marker=MANIFEST) as folder:
        for labels in reduction.scans:
            (folder / ground_path(labels, 0)).parent.mkdir(parents=True)
        threads = ThreadPoolExecutor(_THREADS)  # reading and deflating wait for no interpreter
        try:
            written = threads.map(lambda frame: reduction.write_ground(frame, folder), frames)
            for done, _ in enumerate(written, start=1):
                if progress is not None:
                    progress(done, len(frames))
        finally:
            threads.shutdown(cancel_futures=True)
        reduction.write_rest(folder)
    return reduction.manifest


def label_folders_in(root: Path) -> tuple[LabelFolder, ...]:
    """Return the label folders that a drive has; "labels", which will be missed, where it has none."""
    folders: tuple[LabelFolder, ...] = get_args(LabelFolder)
    return tuple(folder for folder in folders if (root / folder).is_dir()) or folders[:1]
