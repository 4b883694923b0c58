"""Scans as they were recorded, in any format: what the reader of a format provides.

A format of scans is one module beside this one with a function ``open_...(root, options, findings)``. It returns a
`Recording`, or None where the folder or file is of another format, and has its line in `interloc.drives.formats`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from pydantic import BaseModel

from interloc.arrays import Float32Array, FloatArray, IntArray, UInt32Array
from interloc.drives.findings import Findings
from interloc.drives.layouts import NUMBERED_ANYHOW, DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.trajectory import Trajectory

_SAMPLED = 3  # scans

REMISSION_FIELDS = ("intensity", "intensities", "remission", "reflectivity", "reflectance", "i")
_SEMANTIC = ("semantic", "semantic_label", "semantic_id")
LABEL_FIELDS = (*_SEMANTIC, "label", "labels", "classification", "class", "class_id", "seg_label", "category")
"""Names, in lower case, under which drivers, tools and segmentations write the remission and the label of a point."""

CARLA_FIELD = "objtag"
CARLA_WORDS = (
    "the points have the field ObjTag, the labels of CARLA's semantic LiDAR, which is not read. Write it as a field "
    "label, and give the ids of road: --label-scheme 7,6 (road and its lines; from CARLA 0.9.14 on 1,24)."
)
"""Field, in lower case, and what is said of it."""


@dataclass(frozen=True)
class ScanPoints:
    """The points of one scan."""

    values: Float32Array
    """(N, 4) float32: x y z in L, metres, and the remission, in the unit of the format; 0 where it has none."""
    labels: UInt32Array | None = None
    """(N,) uint32: label ids, where the points carry them themselves."""
    times_s: Float32Array | None = None
    """(N,) float32: when each was measured, seconds after the time of the scan, where the points carry that."""

    @property
    def nbytes(self) -> int:
        """What it takes of memory."""
        return sum(each.nbytes for each in (self.values, self.labels, self.times_s) if each is not None)


SECTOR_DEG = 10
WIDE_VIEW_DEG = 200.0
"""A sensor that turns sees more around it."""


def sectors_seen(points: ScanPoints) -> set[int]:
    """Return in which sectors of 10 degrees around the sensor a scan has points."""
    x, y = points.values[np.isfinite(points.values[:, :2]).all(axis=1), :2].T
    return set(np.unique(np.floor(np.degrees(np.arctan2(y, x)) / SECTOR_DEG).astype(int) % 36).tolist())


class PointSource(Protocol):
    """Where the points of the scans are read from.

    It is cheap to send to another process: it holds paths, arrays and numbers, and opens its files where it reads.
    """

    def name(self, frame: int) -> str:
        """Return how messages call a scan: its file, or the bag and the place in it."""
        ...

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the files that a scan is read from."""
        ...

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan; those without a return are left out, with their labels."""
        ...


@dataclass(frozen=True)
class ChangedScans:
    """Scans whose points are changed as they are read; what changes them adds `read` to make a `PointSource`."""

    source: PointSource
    """The scans as they were recorded."""

    def name(self, frame: int) -> str:
        """Return how messages call a scan."""
        return self.source.name(frame)

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the files that a scan is read from."""
        return self.source.files(frame)


class Topic(BaseModel, frozen=True, defer_build=True):
    """A topic of a bag.

    Attributes
    ----------
    name, type : str
    messages : int
    role : {"points", "poses", "fix", "extrinsics"} or None
        What it is read as; None where it is not read.
    """

    name: str
    type: str
    messages: int
    role: Literal["points", "poses", "fix", "extrinsics"] | None = None


@dataclass(frozen=True)
class Recording:
    """The scans of a drive in one format."""

    parts: DriveParts
    points: PointSource
    frames: IntArray
    """(N,) int64: scan numbers, ascending."""
    scan_bytes: int = 0
    usable: IntArray | None = None
    """(M,) int64: positions of the scans that nothing is wrong with so far; None: all."""
    point_counts: IntArray | None = None
    """(N,) int64: points of every scan; None where they are not known before it is read."""
    carries_labels: bool = False
    scheme: str | None = None
    """Name of the scheme of the labels that the points carry, where the format defines it."""
    has_remission: bool = True
    has_times: bool = False
    """The points carry the time at which each was measured."""
    carries_poses: bool = True
    """The recording holds poses itself, damaged or not; False: they are in the files of `parts`, if anywhere."""
    times_s: FloatArray | None = None
    """(N,) float64: of the scans, where they are known without a file of times."""
    read_trajectory: Callable[[IntArray, DriveOptions, Findings], Trajectory] | None = None
    """Reads poses, times and georeference of scans, by their numbers, where these are not files of `parts`."""
    is_cut: bool = False
    """The scans are pieces of one cloud, which lies where the poses say: nothing in them can tell of other poses."""
    topics: tuple[Topic, ...] = ()

    @property
    def has_poses(self) -> bool:
        """Whether there are poses, damaged or not."""
        return self.carries_poses or self.parts.has_poses

    @property
    def has_pose_files(self) -> bool:
        """Whether poses, times and georeference lie in files of the drive's own folder, a line for each number."""
        is_own = not self.parts.in_kitti360_world and self.parts.layout not in NUMBERED_ANYHOW
        return self.read_trajectory is None and is_own

    @property
    def readable(self) -> IntArray:
        """(M,) int64: positions of the scans that nothing is wrong with so far."""
        return np.arange(len(self.frames), dtype=np.int64) if self.usable is None else self.usable

    def within(self, rows: slice | IntArray) -> "Recording":
        """Return a piece of the recording, by its rows from one on up to another, or some of its scans."""
        counts, times_s, readable = self.point_counts, self.times_s, self.readable
        is_in = rows_within(readable, rows) if isinstance(rows, slice) else np.flatnonzero(np.isin(rows, readable))
        return replace(
            self,
            frames=self.frames[rows],
            usable=is_in,
            point_counts=None if counts is None else counts[rows],
            times_s=None if times_s is None else times_s[rows],
        )

    def sampled_remission(self) -> Float32Array:
        """Return the remission of the points of some scans; empty where the format has none."""
        if not self.has_remission:
            return np.empty(0, np.float32)
        rows = np.unique(np.linspace(0, len(self.frames) - 1, _SAMPLED).round().astype(int))
        return np.concatenate([self.points.read(int(self.frames[row])).values[:, 3] for row in rows])


def rows_within(chosen: IntArray, rows: slice) -> IntArray:
    """Return which rows of a piece are those of a choice from the whole, ascending."""
    inside: IntArray = chosen[(chosen >= rows.start) & (chosen < rows.stop)] - rows.start
    return inside


class ReducedReport(BaseModel, frozen=True, defer_build=True):
    """What is left of the scans of a reduced drive.

    Attributes
    ----------
    kept_scans : int
    ground_bytes : int or None
        Size of their ground points, where the label folder has any.
    distance_m, angle_deg : float or None
        Keyframe settings by which they were chosen; None: every scan was kept.
    """

    kept_scans: int
    ground_bytes: int | None
    distance_m: float | None
    angle_deg: float | None


class ScanFacts(BaseModel, frozen=True, defer_build=True):
    """Count and size of the scans and labels of a drive.

    Those of a reduced drive are of the files that it was made of: 0 bytes where that is not known. `points_per_scan` is
    the median.
    """

    scans: int = 0
    first_frame: int | None = None
    last_frame: int | None = None
    scan_bytes: int = 0
    label_bytes: int = 0
    points_per_scan: int | None = None
    least_points: int | None = None
    most_points: int | None = None
    reduced: ReducedReport | None = None
    label_folder: str | None = None
    topics: tuple[Topic, ...] = ()
