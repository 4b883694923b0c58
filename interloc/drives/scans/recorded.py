"""Scans as they were recorded, in any format: what the reader of a format provides.

A format of scans is one module beside this one with a function ``open_...(root, options, findings)``. It returns a
`Recording`, or None where the folder or file is of another format, and has its line in `interloc.drives.formats`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from interloc.arrays import Float32Array, IntArray, UInt32Array
from interloc.drives.findings import Findings
from interloc.drives.layouts import DriveParts
from interloc.drives.options import DriveOptions
from interloc.drives.scans.facts import Topic
from interloc.drives.trajectory import Trajectory

_SAMPLED = 3  # scans


@dataclass(frozen=True)
class ScanPoints:
    """The points of one scan.

    Attributes
    ----------
    values : (N, 4) float32
        x y z in L, metres, and the remission, in the unit of the format; 0 where it has none.
    labels : (N,) uint32 or None
        Label ids, where the points carry them themselves.
    """

    values: Float32Array
    labels: UInt32Array | None = None


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
        """Read the points of a scan; those without a return are left out, with their labels.

        Raises
        ------
        DriveError
            The scan is missing or damaged.
        """
        ...


@dataclass(frozen=True)
class Recording:
    """The scans of a drive in one format.

    Attributes
    ----------
    parts : DriveParts
        Layout, root and name of the drive, and the small files that there are.
    points : PointSource or None
        None where the scans could not be listed.
    frames : (N,) int64 or None
        Scan numbers, ascending; None where they could not be listed.
    scan_bytes : int
        Size of all scans as they are stored.
    usable : (M,) int64 or None
        Positions of the scans that nothing is wrong with so far; None: all.
    point_counts : (N,) int64 or None
        Points of every scan; None where they are not known before it is read.
    carries_labels : bool
        The points have labels of their own.
    scheme : str or None
        Name of the scheme of these labels, where the format defines it.
    has_remission : bool
    read_trajectory : callable or None
        Reads poses, times and georeference where these are not files of `parts`.
    topics : tuple of Topic
        What else a bag holds.
    """

    parts: DriveParts
    points: PointSource | None
    frames: IntArray | None
    scan_bytes: int = 0
    usable: IntArray | None = None
    point_counts: IntArray | None = None
    carries_labels: bool = False
    scheme: str | None = None
    has_remission: bool = True
    read_trajectory: Callable[[DriveOptions, Findings], Trajectory] | None = None
    topics: tuple[Topic, ...] = ()

    def sampled_remission(self) -> Float32Array:
        """Return the remission of the points of some scans; empty where the format has none.

        Raises
        ------
        DriveError
            One of them is damaged.
        """
        if self.points is None or self.frames is None or not self.has_remission:
            return np.empty(0, np.float32)
        rows = np.unique(np.linspace(0, len(self.frames) - 1, _SAMPLED).round().astype(int))
        return np.concatenate([self.points.read(int(self.frames[row])).values[:, 3] for row in rows])
