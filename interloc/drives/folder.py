"""A drive in a folder: poses in memory, points read scan by scan."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from interloc.arrays import FloatArray, IntArray
from interloc.drive import Georeference, GroundPoints
from interloc.drives.findings import DriveFileError
from interloc.drives.labels import LabelScheme
from interloc.drives.scans.raw import RawScans
from interloc.drives.scans.reduced_format import ReducedScans
from interloc.geometry import travelled
from interloc.labelling.track import joined

if TYPE_CHECKING:
    from interloc.results import Dropped

DROPPED = "dropped.csv"
"""Scans that were lost before they came into the drive: `after_frame,scans`, with -1 for those before the first."""

_MAX_DROPPED_BYTES = 16 * 1024**2

Scans = RawScans | ReducedScans
"""The scans of a drive by one of its label folders."""


@dataclass(frozen=True, eq=False)
class FolderDrive:
    """A drive on disk; a `Drive`. It holds arrays and paths only, so it is cheap to send to another process."""

    root: Path
    name: str
    """Of the folder, or of the one that a reduced drive was made of."""
    layout: str
    """A name of `interloc.drives.formats`."""
    frames: IntArray
    """(N,) int64: scan numbers, ascending."""
    T_world_lidar: FloatArray
    """(N, 4, 4) float64: pose of the LiDAR at each scan; W is the LiDAR at the first scan."""
    times_s: FloatArray | None
    """(N,) float64 or None."""
    georeference: Georeference | None
    scans: Scans
    pose_frame: str
    pose_frame_reason: str
    """Whose poses the pose file holds ("camera", "lidar", "imu", "oxts"), and why that is thought."""
    pose_file: str
    """Where the poses came from, in words where that is no file."""

    def __repr__(self) -> str:
        length_m = float(np.linalg.norm(np.diff(self.T_world_lidar[:, :3, 3], axis=0), axis=1).sum())
        return (
            f"<FolderDrive {self.name}: {len(self.frames):,} scans, {length_m:,.0f} m, {self.layout}, "
            f"{'without' if self.georeference is None else 'with'} georeference>"
        )

    @property
    def is_slow(self) -> bool:
        """Whether several scans should be read at once."""
        return self.scans.is_slow

    @property
    def label_source(self) -> str:
        """Where the labels come from, in words."""
        return self.scans.label_source

    @property
    def scheme(self) -> LabelScheme:
        """Which label ids are road."""
        return self.scans.scheme

    @property
    def dropped(self) -> "Dropped | None":
        """How many scans were lost before they came into the drive, and where; None: it says of none."""
        after, count = read_dropped(self.root, self.frames).T
        if not len(after):
            return None
        along = travelled(self.T_world_lidar[:, :2, 3]).round()
        rows = np.searchsorted(self.frames, after, side="right") - 1
        rows = rows[(rows >= 0) & (rows < len(along) - 1)]
        stretches = joined(zip(along[rows].tolist(), along[rows + 1].tolist(), strict=True))
        scans = int(count.sum())
        return {"scans": scans, "of": scans + len(self.frames), "stretches_m": stretches}

    def without_georeference(self) -> Self:
        """Return the drive as if it had no GNSS."""
        return replace(self, georeference=None)

    def ground_points(self, index: int) -> GroundPoints:
        """Read the road points, and the points most often confused with them, of the scan at a position 0..N-1."""
        return self.scans.read(int(self.frames[index]))


def read_dropped(root: Path, frames: IntArray) -> IntArray:
    """Return (D, 2) after which scans of a drive others were lost, and how many: at a part of it."""
    path = root / DROPPED
    if not path.is_file():
        return np.empty((0, 2), np.int64)
    try:
        with path.open("rb") as file:
            head, *lines = file.read(_MAX_DROPPED_BYTES).split()
        rows = np.array([line.split(b",") for line in lines], np.int64).reshape(-1, 2)
    except (OSError, ValueError, OverflowError) as error:
        head, rows, reason = b"", np.zeros((0, 2), np.int64), str(error)
    else:
        reason = "another header, a count below 1, or frames that do not rise"
    if head != b"after_frame,scans" or (rows < (-1, 1)).any() or (np.diff(rows[:, 0]) <= 0).any():
        raise DriveFileError(DROPPED, f"cannot be read ({reason}). Expected lines of after_frame,scans.")
    among: IntArray = rows[(rows[:, 0] >= frames[0] - 1) & (rows[:, 0] <= frames[-1])]
    return among


def dropped_in_words(dropped: "Dropped") -> str:
    """Return the warning of scans that were lost."""
    places = ", ".join(f"{start:,.0f} to {stop:,.0f} m" for start, stop in dropped["stretches_m"][:5])
    more = ", ..." if len(dropped["stretches_m"]) > 5 else ""
    where = f" ({places}{more} of the track)" if places else ""
    return (
        f"{dropped['scans']:,} of {dropped['of']:,} scans were lost before they came into the drive{where}: "
        "intersections may be missing there, and a map does not count it as a full pass."
    )
