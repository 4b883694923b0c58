"""Mobile mapping: a cloud that was recorded on the way, cut into scans by time."""

from __future__ import annotations

import threading
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from interloc.arrays import BoolArray, FloatArray, IntArray
from interloc.drives.files import SourceFile
from interloc.drives.findings import Findings
from interloc.drives.poses.motion import rows_apart
from interloc.drives.scans.las.clouds import BLOCK_POINTS, ROAD_SURFACE, Block, CloudFile, Field, in_words
from interloc.drives.scans.recorded import ScanPoints

SLICE_M = 2.1
"""Distance driven from scan to scan. A little more than that of keyframes (2 m), so that each scan is one, and no point
is left out."""

MAX_GAP_M = 100.0
"""Where two poses of the trajectory lie further apart than this, nothing in between is used."""

MAX_SCAN_POINTS = 4_000_000
"""Of a scan with more, as where the vehicle waited, every second (third, ...) point is read."""

_MARGIN_S = 0.5  # points measured a little before the first pose, or after the last, are used; at most half a slice
_KEPT_BLOCKS = 4
_MAX_PIECES = 20_000_000
_WORTH_SAYING, _HOPELESS, _HOPELESS_POINTS = 8, 100, 5e9
_FIELDS: frozenset[Field] = frozenset({"xyz", "labels", "intensity", "time"})
_INDEX_FIELDS: frozenset[Field] = frozenset({"labels", "time"})


@dataclass(frozen=True)
class Slices:
    """The scans that a drive is cut into: intervals of time, and where the vehicle was in each."""

    times_s: FloatArray
    """(S,) float64: of the poses, in the clock of the cloud, ascending."""
    start_s: FloatArray
    end_s: FloatArray
    """(S,) float64: points from the start on and before the end belong to it; the intervals do not overlap."""

    def of(self, times_s: FloatArray) -> IntArray:
        """Return the slice of (N,) times, -1 where there is none."""
        at = np.searchsorted(self.start_s, times_s, side="right") - 1
        inside = (at >= 0) & (times_s < self.end_s[at])
        slices: IntArray = np.where(inside, at, -1)
        return slices

    def take(self, rows: IntArray) -> Slices:
        """Return some of them."""
        return Slices(self.times_s[rows], self.start_s[rows], self.end_s[rows])


def cut(times_s: FloatArray, position: FloatArray) -> Slices:
    """Cut a drive into slices of about `SLICE_M` driven.

    The poses are those of the trajectory; where these lie further apart, more are put evenly between.

    Parameters
    ----------
    times_s : (P,) float64
        Of the trajectory, strictly ascending.
    position : (P, 3) float64
    """
    rows = np.array(rows_apart(position, SLICE_M))
    step = np.linalg.norm(np.diff(position[rows], axis=0), axis=1)
    pieces = np.where(step < MAX_GAP_M, np.maximum(step // SLICE_M, 1), 1).astype(np.int64)
    time = times_s[rows]
    inner = [
        np.linspace(start, end, count, endpoint=False)
        for start, end, count in zip(time[:-1], time[1:], pieces, strict=True)
    ]
    centres = np.concatenate([*inner, time[-1:]])
    middle = (centres[:-1] + centres[1:]) / 2
    margin = np.minimum(np.diff(centres) / 2, _MARGIN_S) if len(centres) > 1 else np.full(1, _MARGIN_S)
    start, end = np.r_[times_s[0] - margin[0], middle], np.r_[middle, times_s[-1] + margin[-1]]
    for gap in np.searchsorted(centres, time[:-1][step >= MAX_GAP_M]):  # nothing in there
        end[gap], start[gap + 1] = np.nextafter(centres[gap], np.inf), centres[gap + 1]
    return Slices(centres, start, end)


@dataclass(frozen=True)
class SliceIndex:
    """Which blocks of which files hold the points of every slice."""

    counts: IntArray
    """(S,) int64: points of every slice."""
    first: IntArray
    """(S + 1,) int64: where the blocks of every slice begin in `blocks`."""
    blocks: IntArray
    """(P,) int64: numbers of blocks, those of all files one after the other; ascending in every slice."""
    classes: IntArray
    """(256,) int64: points of every classification."""
    outside: int
    """Points that belong to no slice."""

    @property
    def steps(self) -> IntArray:
        """(S,) int64: 1 where all points of a slice are read, 2 where every second is, ..., to `MAX_SCAN_POINTS`."""
        return np.maximum(-(-self.counts // MAX_SCAN_POINTS), 1)

    @property
    def has_road(self) -> bool:
        """Whether any point is classified as road surface."""
        return bool(self.classes[ROAD_SURFACE])


def index_clouds(clouds: tuple[CloudFile, ...], slices: Slices, folder: SourceFile, findings: Findings) -> SliceIndex:
    """Go through all points once, and note which blocks hold points of which slice.

    Raises
    ------
    DriveError
        A file is damaged, or the points are in such an order that every scan would be all over the files.
    """
    owner, block, count = array("q"), array("q"), array("q")
    classes, outside, number = np.zeros(256, np.int64), 0, 0
    for cloud in clouds:
        for points in cloud.read(fields=_INDEX_FIELDS):
            found = slices.of(points.times_s)[~points.withheld]
            outside += int(np.count_nonzero(found < 0))
            found = found[found >= 0]
            if len(found):
                lowest = int(found.min())
                counts = np.bincount(found - lowest)
                held = np.flatnonzero(counts)
                owner.frombytes((held + lowest).astype(np.int64).tobytes())
                block.frombytes(np.full(len(held), number, np.int64).tobytes())
                count.frombytes(counts[held].astype(np.int64).tobytes())
                classes += np.bincount(points.labels, minlength=256)
            number += 1
            if len(owner) > _MAX_PIECES:
                raise folder.fault(_order_complaint(len(owner), len(slices.times_s)))
    owners = np.frombuffer(owner, np.int64) if owner else np.empty(0, np.int64)
    order = np.argsort(owners, kind="stable")
    per_slice = np.bincount(owners, minlength=len(slices.times_s))
    weights = np.frombuffer(count, np.int64) if count else np.empty(0, np.int64)
    index = SliceIndex(
        counts=np.bincount(owners, weights, minlength=len(slices.times_s)).astype(np.int64),
        first=np.concatenate([[0], np.cumsum(per_slice)]),
        blocks=(np.frombuffer(block, np.int64) if block else np.empty(0, np.int64))[order],
        classes=classes,
        outside=outside,
    )
    _judge_order(index, number, len(slices.times_s), folder, findings)
    return index


def _judge_order(index: SliceIndex, blocks: int, slices: int, folder: SourceFile, findings: Findings) -> None:
    """Say so where the points are not in the order of their times, and refuse what would take for ever."""
    reads = len(index.blocks) / max(blocks + slices, 1)  # in order, a slice begins in the block where the last one ends
    if reads > _HOPELESS and len(index.blocks) * BLOCK_POINTS > _HOPELESS_POINTS:
        raise folder.fault(_order_complaint(len(index.blocks), slices))
    if reads > _WORTH_SAYING:
        findings.warning(
            folder.name,
            f"the points are not in the order of their times: every block of {BLOCK_POINTS:,} points is read for "
            f"{len(index.blocks) / max(blocks, 1):,.0f} scans, which takes long. Sort them by gps_time, with lassort "
            "-gps_time or pdal translate IN OUT sort --filters.sort.dimension=GpsTime.",
        )


def _order_complaint(pieces: int, slices: int) -> str:
    return (
        f"the points are not in the order of their times: the {slices:,} scans lie in {pieces:,} pieces all over the "
        "files. Expected points in the order in which they were measured. Sort them by gps_time, with lassort "
        "-gps_time or pdal translate IN OUT sort --filters.sort.dimension=GpsTime. Usual cause: a cloud that was cut "
        "into tiles, or sorted by place."
    )


@dataclass(frozen=True)
class SlicedClouds:
    """The scans of a cloud; a `PointSource`. The scans are numbered from 0."""

    clouds: tuple[CloudFile, ...]
    slices: Slices
    index: SliceIndex
    origin: FloatArray
    """(S, 3) float64: where the vehicle was, in the coordinates of the cloud."""
    to_lidar: FloatArray
    """(S, 2, 2) float64: ``xy in L = to_lidar @ (easting, northing from the origin)``."""
    carries_labels: bool

    def name(self, frame: int) -> str:
        """Return how messages call a scan: its files, and its time."""
        names = [self.clouds[at].file.name for at, _, _ in self._runs(frame)]
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        return f"{names[0]}{more}, {self.slices.start_s[frame]:.3f} s to {self.slices.end_s[frame]:.3f} s"

    def files(self, frame: int) -> tuple[Path, ...]:
        """Return the files that a scan is read from."""
        return tuple(dict.fromkeys(self.clouds[at].file.path for at, _, _ in self._runs(frame)))

    def read(self, frame: int) -> ScanPoints:
        """Read the points of a scan.

        Raises
        ------
        DriveError
            A file is missing or damaged.
        """
        step = int(self.index.steps[frame])
        values, labels, seen = [], [], 0
        for block in self._blocks(frame):
            rows = np.flatnonzero(self._mine(block, frame))
            rows, seen = rows[(-seen) % step :: step], seen + len(rows)
            away = block.xyz[rows] - self.origin[frame]
            points = np.empty((len(rows), 4), np.float32)
            points[:, :2] = away[:, :2] @ self.to_lidar[frame].T
            points[:, 2] = away[:, 2]
            points[:, 3] = block.intensity[rows]
            values.append(points)
            labels.append(block.labels[rows])
        all_labels = np.concatenate(labels).astype(np.uint32) if self.carries_labels else None
        return ScanPoints(np.concatenate(values), all_labels)

    def _mine(self, block: Block, frame: int) -> BoolArray:
        times = block.times_s
        mine: BoolArray = (times >= self.slices.start_s[frame]) & (times < self.slices.end_s[frame]) & ~block.withheld
        return mine

    def _blocks(self, frame: int) -> Iterator[Block]:
        """Yield the blocks of a scan; the first is often the last of the scan before, and is at hand."""
        for at, start, count in self._runs(frame):
            cloud, number, end = self.clouds[at], start, start + count
            state = _state(cloud)
            while number < end and (known := _recent.blocks.get((state, number))) is not None:
                yield known
                number += 1
            if number < end:
                for block in cloud.read(number, end - number, _FIELDS):
                    _recent.keep((state, number), block)
                    yield block
                    number += 1

    def _runs(self, frame: int) -> Iterator[tuple[int, int, int]]:
        """Yield the blocks of a scan: position of the file, first block in it, and how many follow each other."""
        begins = np.concatenate([[0], np.cumsum([cloud.blocks for cloud in self.clouds])])
        blocks = self.index.blocks[self.index.first[frame] : self.index.first[frame + 1]]
        files = np.searchsorted(begins, blocks, side="right") - 1
        breaks = np.flatnonzero((np.diff(blocks) != 1) | (np.diff(files) != 0)) + 1
        for run in np.split(np.arange(len(blocks)), breaks):
            at = int(files[run[0]])
            yield at, int(blocks[run[0]] - begins[at]), len(run)


_State = tuple[Path, int, int]


class _Recent(threading.local):
    """The blocks that a thread read last; scans are mostly read one after the other, and share them."""

    def __init__(self) -> None:
        self.blocks: dict[tuple[_State, int], Block] = {}

    def keep(self, key: tuple[_State, int], block: Block) -> None:
        while len(self.blocks) >= _KEPT_BLOCKS:
            del self.blocks[next(iter(self.blocks))]
        self.blocks[key] = block


_recent = _Recent()


def _state(cloud: CloudFile) -> _State:
    with in_words(cloud.file):
        stat = cloud.file.path.stat()
    return cloud.file.path, stat.st_mtime_ns, stat.st_size


def without_empty(slices: Slices, index: SliceIndex) -> tuple[Slices, SliceIndex, IntArray]:
    """Leave out the slices that hold no points; return also which are left."""
    kept = np.flatnonzero(index.counts)
    per_slice = np.diff(index.first)[kept]
    left = SliceIndex(
        counts=index.counts[kept],
        first=np.concatenate([[0], np.cumsum(per_slice)]),
        blocks=index.blocks,
        classes=index.classes,
        outside=index.outside,
    )
    return slices.take(kept), left, kept
