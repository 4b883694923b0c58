"""The contents of a reduced drive, read instead of scans and labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import IntArray
from interloc.drive import GroundPoints
from interloc.drives.files import list_numbered, listed, missing_numbers, os_reason, shown
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.found import Survey
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions, LabelFolder
from interloc.drives.scans.labels import LabelJudgement, check_labels, named_scheme
from interloc.drives.scans.reduced_format import (
    GROUND_FOLDER,
    MANIFEST,
    MAX_BYTES,
    MIN_BYTES,
    ReducedLabels,
    ReducedManifest,
    Thinning,
    decode_ground,
    ground_path,
    read_manifest,
    size_complaint,
)


@dataclass(frozen=True)
class GroundFiles:
    """The ground points of the scans that were kept; a `GroundSource`.

    Attributes
    ----------
    root : Path
        Folder of the reduced drive.
    folder : {"labels", "predictions"}
        By which labels the points were chosen.
    kept : (K,) int64
        Numbers of the scans that are here, ascending.
    keyframes : Thinning or None
        By which they were chosen.
    """

    root: Path
    folder: LabelFolder
    kept: IntArray
    keyframes: Thinning | None

    def name(self, frame: int) -> str:
        """Name the file of a scan in messages."""
        return ground_path(self.folder, frame)

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan.

        Raises
        ------
        DriveError
            The scan was not kept, or its file is missing or damaged.
        """
        name = self.name(frame)
        row = int(np.searchsorted(self.kept, frame))
        if row == len(self.kept) or self.kept[row] != frame:
            raise DriveFileError(MANIFEST, self._not_kept(frame))
        try:
            with (self.root / name).open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except OSError as error:
            raise DriveFileError(name, f"cannot be read: {os_reason(error)}.") from error
        return decode_ground(data, name)

    def _not_kept(self, frame: int) -> str:
        by = f"thinned to {self.keyframes}" if self.keyframes is not None else "thinned"
        return (
            f"the drive was {by} when it was reduced, and scan {frame} was not kept. Usual cause: other settings "
            "keyframes.distance_m or keyframes.angle_deg. Use those, or reduce the drive again from its scans with "
            "--all-scans."
        )


@dataclass
class ReducedContents:
    """A reduced drive; `Contents`.

    Attributes
    ----------
    manifest : ReducedManifest
    parts : DriveParts
    labels : ReducedLabels or None
        Of the label folder that was chosen; None where the drive has none of it.
    ground_bytes : int or None
        Size of its ground files, once they were listed.
    """

    manifest: ReducedManifest
    parts: DriveParts
    labels: ReducedLabels | None = None
    ground_bytes: int | None = None

    @classmethod
    def find(cls, root: Path, options: DriveOptions) -> ReducedContents:
        """Read the manifest, and find the parts that it names.

        Raises
        ------
        DriveError
            The manifest is damaged, or the drive was made of another layout than the one asked for.
        """
        manifest = read_manifest(root)
        if options.layout not in {"auto", manifest.layout}:
            raise DriveFileError(
                MANIFEST, f"is a drive of layout {manifest.layout}, not {options.layout}. Give layout 'auto'."
            )
        return cls(manifest, parts_of(manifest, root, options.labels))

    @property
    def name(self) -> str:
        """Name of the drive that it was made of."""
        return self.manifest.name

    def list_scans(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """Take the scan numbers from the manifest, and see whether all that were kept are there."""
        found.frames = self.manifest.frames
        with findings.stage():
            self.labels = self._choose_labels(options)
            found.usable = np.searchsorted(found.frames, self._list_ground(findings, sizes=options.check))

    def _choose_labels(self, options: DriveOptions) -> ReducedLabels:
        """Return the labels asked for."""
        chosen = next((labels for labels in self.manifest.labels if labels.folder == options.labels), None)
        if chosen is None:
            others = [labels.folder for labels in self.manifest.labels]
            hint = f"There is {others[0]}/: choose it as the label folder." if others else "It has none at all."
            raise DriveFileError(
                f"{GROUND_FOLDER}/{options.labels}",
                f"is missing: the drive was reduced without {options.labels}. {hint}",
            )
        asked = named_scheme(options.label_scheme)
        if asked is not None and not asked.means_the_same(chosen.label_scheme):
            raise DriveFileError(
                MANIFEST,
                f"its points were chosen by label scheme {chosen.scheme} (road {listed(np.array(chosen.road), 12)}), "
                f"which label scheme {options.label_scheme!r} contradicts. Other points are not here: give label "
                "scheme 'auto', or reduce the drive again with that scheme.",
            )
        return chosen

    def _list_ground(self, findings: Findings, *, sizes: bool) -> IntArray:
        """Return the numbers of the kept scans whose files are there."""
        kept, folder = self.manifest.kept_frames, self.parts.scans
        files = list_numbered(folder, ".ground", self.parts.root)
        missing = missing_numbers(files.numbers, kept)
        if len(missing):
            findings.error(
                DriveFileError(
                    shown(files.path(int(missing[0])), self.parts.root),
                    f"is missing: {len(missing):,} of {len(kept):,} scans that were kept are not there "
                    f"({listed(missing)}). Usual cause: an upload or copy that did not finish.",
                )
            )
        there, _, at_file = np.intersect1d(kept, files.numbers, assume_unique=True, return_indices=True)
        file_sizes = files.sizes[at_file]
        self.ground_bytes = int(file_sizes.sum())
        if not sizes:
            return there
        sound = (file_sizes >= MIN_BYTES) & (file_sizes <= MAX_BYTES)
        for row in np.flatnonzero(~sound):
            name = shown(files.path(int(there[row])), self.parts.root)
            findings.error(DriveFileError(name, size_complaint(int(file_sizes[row]))))
        return there[sound]

    def look_into_labels(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """Take what the labels were from the manifest."""
        if self.labels is None:
            return
        found.labels = LabelJudgement(self.labels.label_scheme, dict(self.labels.counts))
        if options.check:
            with findings.stage():
                check_labels(self.labels.folder, found.labels, findings)

    def ground(self, found: Survey) -> GroundFiles | None:  # noqa: ARG002 - of `Contents`
        """Return the files of the ground points."""
        if self.labels is None:
            return None
        return GroundFiles(self.parts.root, self.labels.folder, self.manifest.kept_frames, self.manifest.keyframes)

    def report(self, found: Survey) -> dict[str, Any]:  # noqa: ARG002 - of `Contents`
        """Report what the scans were, and what is left of them."""
        frames, by = self.manifest.frames, self.manifest.keyframes
        report: dict[str, Any] = {
            "scans": len(frames),
            "first_frame": int(frames[0]),
            "last_frame": int(frames[-1]),
            "reduced": {
                "kept_scans": len(self.manifest.kept_frames),
                "ground_bytes": self.ground_bytes,
                "distance_m": None if by is None else by.distance_m,
                "angle_deg": None if by is None else by.angle_deg,
            },
        }
        if self.manifest.source is not None:
            report |= self.manifest.source.model_dump()
        if self.labels is not None:
            report |= {"label_folder": self.labels.folder, "label_bytes": self.labels.label_bytes or 0}
        return report


def parts_of(manifest: ReducedManifest, root: Path, labels: LabelFolder) -> DriveParts:
    """Return the parts of a reduced drive; nothing outside its folder is looked at."""

    def inside(name: str | None) -> Path | None:
        return None if name is None else root / name

    files, ground = manifest.files, root / GROUND_FOLDER / labels
    return DriveParts(
        layout=manifest.layout,
        root=root,
        scans=ground,
        labels=ground,
        poses=inside(files.poses),
        times=inside(files.times),
        calibration=tuple(root / name for name in files.calibration),
        oxts=inside(files.oxts),
        geo=inside(files.geo),
        name=manifest.name,
        pose_frame=(manifest.pose_frame, manifest.pose_frame_reason),
    )
