"""Scans with a label a point, in .bin and .label files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, UInt8Array, UInt32Array
from interloc.drive import GroundPoints
from interloc.drives.faults import DriveFileError
from interloc.drives.files import NumberedFiles, os_reason, shown
from interloc.drives.labels import LabelScheme
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
