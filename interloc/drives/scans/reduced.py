"""The scans of a reduced drive: read from ground points instead of scans and labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import IntArray
from interloc.drive import GroundPoints
from interloc.drives.files import SourceFile, list_numbered, listed
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.labels import LabelJudgement, LabelScheme, check_labels, named_scheme
from interloc.drives.layouts import DriveParts
from interloc.drives.options import LABEL_FILES, DriveOptions, LabelFolder
from interloc.drives.scans.recording import ReducedReport, ScanFacts
from interloc.drives.scans.reduced_format import (
    GROUND_FOLDER,
    MANIFEST,
    MAX_BYTES,
    MIN_BYTES,
    ReducedLabels,
    ReducedManifest,
    decode_ground,
    ground_path,
    size_complaint,
)
from interloc.drives.trajectory import Trajectory, read_trajectory


def read_ground(root: Path, folder: LabelFolder, frame: int) -> GroundPoints:
    """Read the ground points of a scan of a reduced drive, chosen by the labels of a folder."""
    file = SourceFile(root / ground_path(folder, frame), root)
    try:
        with file.path.open("rb") as handle:
            data = handle.read(MAX_BYTES + 1)
    except OSError as error:
        raise file.unreadable(error) from error
    return decode_ground(data, file.name)


@dataclass(frozen=True)
class ReducedScans:
    """The scans of a reduced drive, by one of its label folders."""

    manifest: ReducedManifest
    parts: DriveParts
    frames: IntArray
    """(N,) int64: numbers of all scans, also of those that were not kept."""
    kept: IntArray
    """(K,) int64: numbers of the scans that are here."""
    usable: IntArray
    """(M,) int64: positions of those whose files are there, and of a size that can be."""
    labels: ReducedLabels | None = None
    """Of the label folder; None where the drive has none of it."""
    ground_bytes: int | None = None
    """Size of its ground files; None where they could not be listed."""

    is_slow = False

    @classmethod
    def of(
        cls, manifest: ReducedManifest, root: Path, folder: LabelFolder, options: DriveOptions, findings: Findings
    ) -> ReducedScans:
        """Choose the labels of a folder, and see whether all scans that were kept are there."""
        if options.layout not in {"auto", manifest.layout}:
            raise DriveFileError(
                MANIFEST, f"is a drive of layout {manifest.layout}, not {options.layout}. Give layout 'auto'."
            )
        for each in manifest.warnings:
            findings.warning(each.path, each.message)
        parts = _parts_of(manifest, root, folder)
        frames, kept = manifest.frames, manifest.kept_frames
        labels = ground_bytes = None
        usable = np.empty(0, dtype=np.int64)
        with findings.stage():
            labels = _choose_labels(manifest, folder, options)
            there, ground_bytes = _list_ground(kept, parts, findings, sizes=options.check)
            usable = np.searchsorted(frames, there)
        return cls(manifest, parts, frames, kept, usable, labels, ground_bytes)

    @property
    def is_complete(self) -> bool:
        """Whether there are scans to be read."""
        return self.labels is not None

    def judge_labels(self, _sample: list[int], options: DriveOptions, findings: Findings) -> LabelJudgement:
        """Take what the labels meant from the manifest."""
        if self.labels is None:
            return LabelJudgement()
        judgement = LabelJudgement(self.labels.label_scheme, dict(self.labels.counts))
        if options.check:
            with findings.stage():
                check_labels(self.labels.folder, judgement, findings)
        return judgement

    def by_scheme(self, _scheme: LabelScheme) -> ReducedScans:
        """Return the scans as they are: other points are not here."""
        return self

    @property
    def facts(self) -> ScanFacts:
        """What the scans were, and what is left of them."""
        by, source = self.manifest.keyframes, self.manifest.source
        facts = ScanFacts(
            scans=len(self.frames),
            first_frame=int(self.frames[0]),
            last_frame=int(self.frames[-1]),
            reduced=ReducedReport(
                kept_scans=len(self.kept),
                ground_bytes=self.ground_bytes,
                distance_m=None if by is None else by.distance_m,
                angle_deg=None if by is None else by.angle_deg,
            ),
        )
        known = {} if source is None else source.model_dump()
        if self.labels is not None:
            known |= {"label_folder": self.labels.folder, "label_bytes": self.labels.label_bytes or 0}
        return facts.model_copy(update=known)

    @property
    def _labels(self) -> ReducedLabels:
        assert self.labels is not None
        return self.labels

    @property
    def scheme(self) -> LabelScheme:
        """Which label ids were road."""
        return self._labels.label_scheme

    @property
    def label_source(self) -> str:
        """Name of the label folder."""
        return self._labels.folder

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return ground_path(self._labels.folder, frame)

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan."""
        row = int(np.searchsorted(self.kept, frame))
        if row == len(self.kept) or self.kept[row] != frame:
            by = f"thinned to {self.manifest.keyframes}" if self.manifest.keyframes is not None else "thinned"
            raise DriveFileError(
                MANIFEST,
                f"the drive was {by} when it was reduced, and scan {frame} was not kept. Usual cause: other settings "
                "keyframes.distance_m or keyframes.angle_deg. Use those, or reduce the drive again from its scans with "
                "--all-scans.",
            )
        return read_ground(self.parts.root, self._labels.folder, frame)


def reduced_trajectory(manifest: ReducedManifest, root: Path, options: DriveOptions, findings: Findings) -> Trajectory:
    """Read poses, times and georeference of a reduced drive from its small files."""
    return read_trajectory(_parts_of(manifest, root, LABEL_FILES[0]), manifest.frames, options, findings)


def _choose_labels(manifest: ReducedManifest, folder: LabelFolder, options: DriveOptions) -> ReducedLabels:
    chosen = next((labels for labels in manifest.labels if labels.folder == folder), None)
    if chosen is None:
        others = [labels.folder for labels in manifest.labels]
        if folder == "geometry":
            raise DriveFileError(
                MANIFEST,
                "is of a reduced drive, which holds ground points only: labels by geometry need all points of the "
                f"scans. Give the drive that it was made from, or its labels ({' or '.join(others)}).",
            )
        hint = f"There is {others[0]}/: choose it as the label folder." if others else "It has none at all."
        raise DriveFileError(
            f"{GROUND_FOLDER}/{folder}",
            f"is missing: the drive was reduced without {folder}. {hint}",
        )
    asked = named_scheme(options.label_scheme)
    if asked is not None and not asked.means_the_same(chosen.label_scheme):
        raise DriveFileError(
            MANIFEST,
            f"its points were chosen by label scheme {chosen.scheme} (road {listed(chosen.road, 12)}), "
            f"which label scheme {options.label_scheme!r} contradicts. Other points are not here: give label "
            "scheme 'auto', or reduce the drive again with that scheme.",
        )
    return chosen


def _list_ground(kept: IntArray, parts: DriveParts, findings: Findings, *, sizes: bool) -> tuple[IntArray, int]:
    """Return the numbers of the kept scans whose files are there, and the size of all of these."""
    files = list_numbered(parts.file(parts.scans), ".ground")
    missing = np.setdiff1d(kept, files.numbers)
    if len(missing):
        findings.error(
            files.file(int(missing[0])).fault(
                f"is missing: {len(missing):,} of {len(kept):,} scans that were kept are not there "
                f"({listed(missing)}). Usual cause: an upload or copy that did not finish."
            )
        )
    there, _, at_file = np.intersect1d(kept, files.numbers, assume_unique=True, return_indices=True)
    file_sizes = files.sizes[at_file]
    total = int(file_sizes.sum())
    if not sizes:
        return there, total
    sound = (file_sizes >= MIN_BYTES) & (file_sizes <= MAX_BYTES)
    for row in np.flatnonzero(~sound):
        findings.error(files.file(int(there[row])).fault(size_complaint(int(file_sizes[row]))))
    return there[sound], total


def _parts_of(manifest: ReducedManifest, root: Path, labels: LabelFolder) -> DriveParts:
    """Return the parts of a reduced drive; nothing outside its folder is looked at."""

    def inside(name: str | None) -> Path | None:
        return None if name is None else root / name

    files = manifest.files
    return DriveParts(
        layout=manifest.layout,
        root=root,
        scans=root / GROUND_FOLDER / labels,
        poses=inside(files.poses),
        times=inside(files.times),
        calibration=tuple(root / name for name in files.calibration),
        oxts=inside(files.oxts),
        geo=inside(files.geo),
        name=manifest.name,
        pose_frame=(manifest.pose_frame, manifest.pose_frame_reason),
    )
