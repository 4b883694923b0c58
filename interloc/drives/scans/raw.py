"""Scans with one label per point, in .bin and .label files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from interloc.arrays import Float32Array, IntArray, UInt8Array, UInt32Array
from interloc.drive import GroundPoints
from interloc.drives.files import NumberedFiles, list_numbered, listed, missing_numbers, os_reason, shown
from interloc.drives.findings import DriveFileError, Findings
from interloc.drives.found import Survey
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.labels import SEMANTICKITTI, LabelScheme, judge_labels
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
    root : Path
        Folder of the drive.
    scan_files, label_files : NumberedFiles
    scheme : LabelScheme
        Which label ids are road.
    """

    root: Path
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
        """Name the file of a scan in messages."""
        return shown(self.scan_files.path(frame), self.root)

    def read(self, frame: int) -> GroundPoints:
        """Read the ground points of a scan."""
        return select_ground(self.scan_files.path(frame), self.label_files.path(frame), self.root, self._groups)


def select_ground(scan: Path, label: Path, root: Path, groups: UInt8Array) -> GroundPoints:
    """Read the ground points of a scan with its labels.

    Parameters
    ----------
    scan, label : Path
        Its .bin and its .label file.
    root : Path
        Folder of the drive, for messages.
    groups : (65536,) uint8
        Table of a `LabelScheme`.

    Raises
    ------
    DriveError
        A file is missing or cut short, labels and points differ in number, or a point that is kept is not finite.
    """
    points, labels = read_points(scan, root), read_labels(label, root)
    if len(points) != len(labels):
        raise DriveFileError(shown(label, root), label_count_complaint(len(labels), len(points), shown(scan, root)))
    xyz, road_count, bad_point = select_points(points, labels, groups)
    if bad_point >= 0:
        x, y, z, _ = points[bad_point]
        raise DriveFileError(
            shown(scan, root),
            f"point {bad_point:,} of {len(points):,} is not finite ({x:g}, {y:g}, {z:g}). "
            "Expected x y z in metres. Usual cause: points without a return that were written as NaN; "
            "leave them out, with their labels.",
        )
    return GroundPoints(xyz, road_count)


def read_points(path: Path, root: Path) -> Float32Array:
    """Read the (N, 4) float32 points of a file: x y z in L, metres, and remission.

    Raises
    ------
    DriveError
        It cannot be read, or was cut short.
    """
    try:
        size = path.stat().st_size
        values = np.fromfile(path, dtype="<f4")
    except OSError as error:
        raise DriveFileError(shown(path, root), f"cannot be read: {os_reason(error)}.") from error
    if size % POINT_BYTES or not size:
        raise DriveFileError(shown(path, root), scan_size_complaint(size))
    points: Float32Array = values.reshape(-1, 4)
    return points


def read_labels(path: Path, root: Path) -> UInt32Array:
    """Read the (N,) uint32 labels of a file.

    Raises
    ------
    DriveError
        It cannot be read.
    """
    try:
        return np.fromfile(path, dtype="<u4")
    except OSError as error:
        raise DriveFileError(shown(path, root), f"cannot be read: {os_reason(error)}.") from error


def read_label_ids(path: Path, root: Path) -> list[tuple[int, int]]:
    """Return the distinct label ids of a file, each with the number of points that carry it."""
    counts = np.bincount(read_labels(path, root) & 0xFFFF)
    return [(int(label), int(counts[label])) for label in np.flatnonzero(counts)]


def scan_size_complaint(size: int) -> str:
    """Say what is wrong with the size of a scan."""
    if size == 0:
        return "is empty. Usual cause: a copy or download that did not finish."
    return (
        f"{size:,} bytes, which is no multiple of 16. Expected four float32 a point (x y z remission). "
        "Usual cause: a file cut short while it was copied, or points with another number of values."
    )


def label_count_complaint(labels: int, points: int, scan: str) -> str:
    """Say that labels and points differ in number."""
    return (
        f"{labels:,} labels for {points:,} points in {scan}. Every point needs one 4-byte label. "
        "Usual cause: labels of another sequence, or an archive that was not unpacked to the end."
    )


def list_labels(parts: DriveParts) -> NumberedFiles:
    """List the label files."""
    folder = parts.labels
    if not folder.is_dir():
        other = parts.root / ("predictions" if folder.name == "labels" else "labels")
        hint = (
            f"There is {other.name}/: choose it as the label folder."
            if other.is_dir()
            else "Any semantic segmentation that writes SemanticKITTI .label files will do."
        )
        raise DriveFileError(
            shown(folder, parts.root), f"is missing. Expected one .label file a scan: uint32 a point. {hint}"
        )
    return list_numbered(folder, ".label", parts.root)


def check_files(
    scans: NumberedFiles, labels: NumberedFiles, root: Path, findings: Findings, *, sizes: bool
) -> IntArray:
    """Check that every scan has its labels, and that their sizes fit, by names and sizes only.

    Returns
    -------
    (M,) int64
        Positions of the scans that can be read.
    """
    missing = missing_numbers(labels.numbers, scans.numbers)
    if len(missing):
        findings.error(
            DriveFileError(
                shown(labels.path(int(missing[0])), root),
                f"is missing: {len(missing):,} of {len(scans.numbers):,} scans have no labels ({listed(missing)}). "
                "Expected one .label file a scan. Usual cause: an archive that was not unpacked to the end.",
            )
        )
    extra = missing_numbers(scans.numbers, labels.numbers)
    if len(extra):
        findings.note(shown(labels.folder, root), f"labels of {len(extra):,} scans that are not there are not used.")
    common, at_scan, at_label = np.intersect1d(scans.numbers, labels.numbers, assume_unique=True, return_indices=True)
    if not sizes:
        return at_scan
    for row in np.flatnonzero((scans.sizes % POINT_BYTES != 0) | (scans.sizes == 0)):
        name = shown(scans.path(int(scans.numbers[row])), root)
        findings.error(DriveFileError(name, scan_size_complaint(int(scans.sizes[row]))))
    scan_sizes, label_sizes = scans.sizes[at_scan], labels.sizes[at_label]
    sound = (scan_sizes % POINT_BYTES == 0) & (scan_sizes > 0)
    fits = label_sizes * (POINT_BYTES // LABEL_BYTES) == scan_sizes
    for row in np.flatnonzero(sound & ~fits):
        scan, label = (shown(files.path(int(common[row])), root) for files in (scans, labels))
        count, left = divmod(int(label_sizes[row]), LABEL_BYTES)
        if left:
            message = f"{label_sizes[row]:,} bytes, which is no multiple of 4. Expected one uint32 a point."
        else:
            message = label_count_complaint(count, int(scan_sizes[row]) // POINT_BYTES, scan)
        findings.error(DriveFileError(label, message))
    usable: IntArray = at_scan[sound & fits]
    return usable


@dataclass
class RawContents:
    """Scans and labels of a drive as it was recorded; `Contents`.

    Attributes
    ----------
    parts : DriveParts
    scans, labels : NumberedFiles or None
        None where they could not be listed.
    """

    parts: DriveParts
    scans: NumberedFiles | None = None
    labels: NumberedFiles | None = None

    @property
    def name(self) -> str:
        """Name of the drive."""
        return self.parts.drive_name

    def list_scans(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """List the files, and check their sizes."""
        root = self.parts.root
        with findings.stage():
            self.scans = list_numbered(self.parts.scans, ".bin", root)
            found.frames = self.scans.numbers
        with findings.stage():
            self.labels = list_labels(self.parts)
        if self.scans is not None and self.labels is not None:
            found.usable = check_files(self.scans, self.labels, root, findings, sizes=options.check)

    def look_into_labels(self, found: Survey, options: DriveOptions, findings: Findings) -> None:
        """Count the ids of the sampled scans."""
        if self.labels is None:
            return
        assert found.frames is not None
        counts: dict[int, int] = {}
        for index in found.sample:
            with findings.stage():
                path = self.labels.path(int(found.frames[index]))
                for label, count in read_label_ids(path, self.parts.root):
                    counts[label] = counts.get(label, 0) + count
        found.labels = judge_labels(
            shown(self.labels.folder, self.parts.root),
            counts,
            options.label_scheme,
            kitti360=self.parts.layout == "kitti360",
            check=options.check,
            findings=findings,
        )

    def ground(self, found: Survey) -> RawScans | None:
        """Return the scans."""
        if self.scans is None or self.labels is None:
            return None
        return RawScans(self.parts.root, self.scans, self.labels, found.labels.scheme or SEMANTICKITTI)

    def report(self, found: Survey) -> dict[str, Any]:  # noqa: ARG002 - of `Contents`
        """Report the files."""
        report: dict[str, Any] = {}
        if self.scans is not None:
            points = self.scans.sizes // POINT_BYTES
            report |= {
                "scans": len(points),
                "first_frame": int(self.scans.numbers[0]),
                "last_frame": int(self.scans.numbers[-1]),
                "scan_bytes": int(self.scans.sizes.sum()),
                "points_per_scan": int(np.median(points)),
                "least_points": int(points.min()),
                "most_points": int(points.max()),
            }
        if self.labels is not None:
            report |= {"label_folder": self.parts.labels.name, "label_bytes": int(self.labels.sizes.sum())}
        return report
