"""Scans as they were recorded, with one label per point: .bin and .label files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, IntArray, UInt8Array, UInt32Array
from interloc.drive import GroundPoints
from interloc.drives.files import NumberedFiles, SourceFile, list_numbered, listed, missing_numbers
from interloc.drives.findings import Findings
from interloc.drives.folder import ScanFacts
from interloc.drives.labels import LabelJudgement, LabelScheme, judge_labels
from interloc.drives.layouts import DriveParts, find_layout
from interloc.drives.options import DriveOptions
from interloc.kernels.points import select_points

POINT_BYTES = 16
"""float32 x y z remission."""

LABEL_BYTES = 4
"""uint32, the label id in the lower half."""


@dataclass(frozen=True)
class RawScans:
    """Scans and labels as they were recorded; a `GroundSource`.

    Attributes
    ----------
    scan_files, label_files : NumberedFiles
    scheme : LabelScheme
        Which label ids are road.
    """

    scan_files: NumberedFiles
    label_files: NumberedFiles
    scheme: LabelScheme

    def __getstate__(self) -> dict[str, object]:
        """Leave the selection table behind: it is made anew from the scheme."""
        return {name: value for name, value in self.__dict__.items() if name != "_groups"}

    @cached_property
    def _groups(self) -> UInt8Array:
        return self.scheme.groups()

    def name(self, frame: int) -> str:
        """Return the name of the file of a scan, for messages."""
        return self.scan_files.file(frame).name

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan.

        Raises
        ------
        DriveError
            A file is missing or cut short, labels and points differ in number, or a point that is kept is not finite.
        """
        scan, label = self.scan_files.file(frame), self.label_files.file(frame)
        points, labels = read_points(scan), read_labels(label)
        if len(points) != len(labels):
            raise label.fault(_label_count_complaint(len(labels), len(points), scan.name))
        xyz, road_count, bad_point = select_points(points, labels, self._groups)
        if bad_point >= 0:
            x, y, z, _ = points[bad_point]
            raise scan.fault(
                f"point {bad_point:,} of {len(points):,} is not finite ({x:g}, {y:g}, {z:g}). "
                "Expected x y z in metres. Usual cause: points without a return that were written as NaN; "
                "leave them out, with their labels."
            )
        return GroundPoints(xyz, road_count)


@dataclass(frozen=True)
class RawStore:
    """Scans and labels of a drive as it was recorded; a `ScanStore`.

    Attributes
    ----------
    parts : DriveParts
    scans, labels : NumberedFiles or None
        None where they could not be listed.
    usable : (M,) int64
        Positions of the scans that have labels, of the size that fits.
    """

    parts: DriveParts
    scans: NumberedFiles | None
    labels: NumberedFiles | None
    usable: IntArray

    @classmethod
    def open(cls, root: Path, options: DriveOptions, findings: Findings) -> RawStore:
        """Find the layout of a folder, list its scans and labels, and check their sizes.

        Raises
        ------
        DriveError
            The folder is not a drive; or it is damaged, and `findings` stops at that.
        """
        parts = find_layout(root, options)
        scans = labels = None
        with findings.stage():
            scans = list_numbered(parts.file(parts.scans), ".bin")
        with findings.stage():
            labels = _list_labels(parts)
        usable = np.empty(0, dtype=np.int64)
        if scans is not None and labels is not None:
            usable = _check_files(scans, labels, findings, sizes=options.check)
        return cls(parts, scans, labels, usable)

    @property
    def frames(self) -> IntArray | None:
        """(N,) int64 scan numbers."""
        return None if self.scans is None else self.scans.numbers

    def judge_labels(self, sample: list[int], options: DriveOptions, findings: Findings) -> LabelJudgement:
        """Count the ids of some scans, and find out what they mean."""
        counts: dict[int, int] = {}
        if self.labels is None or self.scans is None:
            return LabelJudgement()
        for index in sample:
            with findings.stage():
                for label, count in read_label_ids(self.labels.file(int(self.scans.numbers[index]))):
                    counts[label] = counts.get(label, 0) + count
        return judge_labels(
            self.labels.folder.name,
            counts,
            options.label_scheme,
            kitti360=self.parts.layout == "kitti360",
            check=options.check,
            findings=findings,
        )

    def ground(self, scheme: LabelScheme) -> RawScans | None:
        """Return the scans."""
        return None if self.scans is None or self.labels is None else RawScans(self.scans, self.labels, scheme)

    @property
    def facts(self) -> ScanFacts:
        """Count and size of the files."""
        facts = ScanFacts()
        if self.scans is not None:
            points = self.scans.sizes // POINT_BYTES
            facts = ScanFacts(
                scans=len(points),
                first_frame=int(self.scans.numbers[0]),
                last_frame=int(self.scans.numbers[-1]),
                scan_bytes=int(self.scans.sizes.sum()),
                points_per_scan=int(np.median(points)),
                least_points=int(points.min()),
                most_points=int(points.max()),
            )
        if self.labels is not None:
            labels = {"label_folder": self.parts.labels.name, "label_bytes": int(self.labels.sizes.sum())}
            facts = facts.model_copy(update=labels)
        return facts


def read_points(file: SourceFile) -> Float32Array:
    """Read the (N, 4) float32 points of a file: x y z in L, metres, and remission.

    Raises
    ------
    DriveError
        It cannot be read, or was cut short.
    """
    try:
        size = file.path.stat().st_size
        values = np.fromfile(file.path, dtype="<f4")
    except OSError as error:
        raise file.unreadable(error) from error
    if size % POINT_BYTES or not size:
        raise file.fault(_scan_size_complaint(size))
    points: Float32Array = values.reshape(-1, 4)
    return points


def read_labels(file: SourceFile) -> UInt32Array:
    """Read the (N,) uint32 labels of a file.

    Raises
    ------
    DriveError
        It cannot be read.
    """
    try:
        return np.fromfile(file.path, dtype="<u4")
    except OSError as error:
        raise file.unreadable(error) from error


def read_label_ids(file: SourceFile) -> list[tuple[int, int]]:
    """Return the distinct label ids of a file, each with the number of points that carry it."""
    counts = np.bincount(read_labels(file) & 0xFFFF)
    return [(int(label), int(counts[label])) for label in np.flatnonzero(counts)]


def _list_labels(parts: DriveParts) -> NumberedFiles:
    """List the label files."""
    folder = parts.labels
    if not folder.is_dir():
        other = parts.root / ("predictions" if folder.name == "labels" else "labels")
        hint = (
            f"There is {other.name}/: choose it as the label folder."
            if other.is_dir()
            else "Any semantic segmentation that writes SemanticKITTI .label files will do."
        )
        raise parts.file(folder).fault(
            f"is missing. Expected one .label file per scan, with one uint32 per point. {hint}"
        )
    return list_numbered(parts.file(folder), ".label")


def _check_files(scans: NumberedFiles, labels: NumberedFiles, findings: Findings, *, sizes: bool) -> IntArray:
    """Check that every scan has its labels, and that their sizes fit, by names and sizes only.

    Returns
    -------
    (M,) int64
        Positions of the scans that can be read.
    """
    missing = missing_numbers(labels.numbers, scans.numbers)
    if len(missing):
        findings.error(
            labels.file(int(missing[0])).fault(
                f"is missing: {len(missing):,} of {len(scans.numbers):,} scans have no labels ({listed(missing)}). "
                "Expected one .label file per scan. Usual cause: an archive that was not unpacked to the end."
            )
        )
    extra = missing_numbers(scans.numbers, labels.numbers)
    if len(extra):
        findings.note(labels.folder.name, f"labels of {len(extra):,} scans that are not there are not used.")
    common, at_scan, at_label = np.intersect1d(scans.numbers, labels.numbers, assume_unique=True, return_indices=True)
    if not sizes:
        return at_scan
    for row in np.flatnonzero((scans.sizes % POINT_BYTES != 0) | (scans.sizes == 0)):
        findings.error(scans.file(int(scans.numbers[row])).fault(_scan_size_complaint(int(scans.sizes[row]))))
    scan_sizes, label_sizes = scans.sizes[at_scan], labels.sizes[at_label]
    sound = (scan_sizes % POINT_BYTES == 0) & (scan_sizes > 0)
    fits = label_sizes * (POINT_BYTES // LABEL_BYTES) == scan_sizes
    for row in np.flatnonzero(sound & ~fits):
        number = int(common[row])
        count, left = divmod(int(label_sizes[row]), LABEL_BYTES)
        if left:
            message = f"{label_sizes[row]:,} bytes, which is no multiple of 4. Expected one uint32 per point."
        else:
            points = int(scan_sizes[row]) // POINT_BYTES
            message = _label_count_complaint(count, points, scans.file(number).name)
        findings.error(labels.file(number).fault(message))
    usable: IntArray = at_scan[sound & fits]
    return usable


def _scan_size_complaint(size: int) -> str:
    """Return what is wrong with the size of a scan."""
    if size == 0:
        return "is empty. Usual cause: a copy or download that did not finish."
    return (
        f"{size:,} bytes, which is no multiple of 16. Expected four float32 per point (x y z remission). "
        "Usual cause: a file cut short while it was copied, or points with another number of values."
    )


def _label_count_complaint(labels: int, points: int, scan: str) -> str:
    """Return that labels and points differ in number."""
    return (
        f"{labels:,} labels for {points:,} points in {scan}. Every point needs one 4-byte label. "
        "Usual cause: labels of another sequence, or an archive that was not unpacked to the end."
    )
