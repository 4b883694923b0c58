"""A drive in a folder: poses in memory, points read scan by scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from interloc.drives.drive import Georeference, GroundPoints
from interloc.drives.faults import DriveFileError
from interloc.drives.files import NumberedFiles, os_reason, shown
from interloc.drives.labels import LabelScheme
from interloc.drives.parts import LayoutName
from interloc.kernels.points import select_points

Array = NDArray[np.float64]

POINT_BYTES = 16
"""float32 x y z remission."""

LABEL_BYTES = 4
"""uint32, the label id in the lower half."""


@dataclass(frozen=True)
class FolderDrive:
    """A drive on disk; a `Drive`.

    It holds arrays and paths only, so it is cheap to send to another process.

    Attributes
    ----------
    root : Path
        Folder of the drive.
    layout : {"semantickitti", "kitti_raw", "kitti360"}
    frames : (N,) int64
        Scan numbers, ascending.
    T_world_lidar : (N, 4, 4) float64
        Pose of the LiDAR at each scan; W is the LiDAR at the first scan.
    times_s : (N,) float64 or None
        Seconds.
    georeference : Georeference or None
    scan_files, label_files : NumberedFiles
    scheme : LabelScheme
        Which label ids are road.
    pose_frame, pose_frame_reason : str
        Whose poses the pose file holds ("camera", "lidar", "imu", "oxts"), and why that is thought.
    """

    root: Path
    layout: LayoutName
    frames: NDArray[np.int64]
    T_world_lidar: Array
    times_s: Array | None
    georeference: Georeference | None
    scan_files: NumberedFiles
    label_files: NumberedFiles
    scheme: LabelScheme
    pose_frame: str
    pose_frame_reason: str

    def __getstate__(self) -> dict[str, object]:
        """Leave the selection table behind: it is made anew from the scheme."""
        return {name: value for name, value in self.__dict__.items() if name != "_groups"}

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.root.absolute().name

    @cached_property
    def _groups(self) -> NDArray[np.uint8]:
        return self.scheme.groups()

    def ground_points(self, index: int) -> GroundPoints:
        """Read the road points, and the points most often confused with them, of the scan at a position 0..N-1.

        Raises
        ------
        DriveError
            A file is missing or cut short, labels and points differ in number, or a point that is kept is not finite.
        """
        frame = int(self.frames[index])
        points, labels = self.read_points(frame), self.read_labels(frame)
        if len(points) != len(labels):
            raise DriveFileError(
                self._label_name(frame), label_count_complaint(len(labels), len(points), self._scan_name(frame))
            )
        xyz, road_count, bad_point = select_points(points, labels, self._groups)
        if bad_point >= 0:
            x, y, z, _ = points[bad_point]
            raise DriveFileError(
                self._scan_name(frame),
                f"point {bad_point:,} of {len(points):,} is not finite ({x:g}, {y:g}, {z:g}). "
                "Expected x y z in metres. Usual cause: points without a return that were written as NaN; "
                "leave them out, with their labels.",
            )
        return GroundPoints(xyz, road_count)

    def read_points(self, frame: int) -> NDArray[np.float32]:
        """Return the (N, 4) float32 points of a frame: x y z in L, metres, and remission."""
        path = self.scan_files.path(frame)
        try:
            size = path.stat().st_size
            values = np.fromfile(path, dtype="<f4")
        except OSError as error:
            raise DriveFileError(self._scan_name(frame), f"cannot be read: {os_reason(error)}.") from error
        if size % POINT_BYTES or not size:
            raise DriveFileError(self._scan_name(frame), scan_size_complaint(size))
        points: NDArray[np.float32] = values.reshape(-1, 4)
        return points

    def read_labels(self, frame: int) -> NDArray[np.uint32]:
        """Return the (N,) uint32 labels of a frame as they stand in the file."""
        return read_labels(self.label_files.path(frame), self.root)

    def _scan_name(self, frame: int) -> str:
        return shown(self.scan_files.path(frame), self.root)

    def _label_name(self, frame: int) -> str:
        return shown(self.label_files.path(frame), self.root)


def read_labels(path: Path, root: Path) -> NDArray[np.uint32]:
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
