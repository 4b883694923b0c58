"""Concatenation of the keyframes around the current one, and its projection to a BEV image (paper, III-B.2 and 3)."""

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, Int32Array, IntArray, UInt64Array
from interloc.config import BevConfig, KeyframeConfig
from interloc.detection.image import BinaryImage, Roi
from interloc.detection.keyframes import Keyframe
from interloc.errors import DriveError
from interloc.kernels import grid

_GROW = 16  # tiles that the pool grows by at least
_POOLED_SHARE = 0.5  # share of a full window below which votes are pooled: the ends of a dense drive have more
_RIGHT_LONE, _WRONG_LONE = 0.022, 0.033  # shares of lone road cells: what real labels have: docs/accuracy-steps.md
_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_RIGHT_WEIGHT = 0.25  # of a neighbour's vote, where labels err no more than along borders


class TileGrid:
    """Votes per cell of W, stored where there are points only: memory follows what it holds, not the drive.

    Beside the counts stand packed images of the tiles, which change with the few counts that pass a limit: cells that
    have enough votes to be road, and cells that have less than none.
    """

    def __init__(self, minimum: int) -> None:
        self.pool, self.road, self.other = _empty_tiles(0)
        self._minimum = minimum  # votes that are enough
        self._slots: dict[tuple[int, int], int] = {}  # (tile row, tile column) -> slot of the pool
        self._users: dict[tuple[int, int], int] = {}  # how many keyframes have cells in the tile
        self._free: list[int] = []

    def bytes_with(self, ranges: Iterable[IntArray]) -> int:
        """Return the memory that the use of all tiles of some ranges takes, the copy while it grows included."""
        new = {key for tiles in ranges for key in _keys(tiles)} - self._slots.keys()
        slots = old = len(self.pool)
        while slots < old + len(new) - len(self._free):
            slots += max(_GROW, slots // 2)
        bytes_each: int = sum(each.itemsize * each.shape[1] for each in (self.pool, self.road, self.other))
        return (slots if slots == old else slots + old) * bytes_each

    def acquire(self, tiles: IntArray) -> list[tuple[int, int]]:
        """Take into use all tiles of a range (first and last column, first and last row)."""
        keys = _keys(tiles)
        for key in keys:
            if key not in self._slots:
                if not self._free:
                    self._grow()
                self._slots[key] = self._free.pop()
                self._users[key] = 0
            self._users[key] += 1
        return keys

    def release(self, keys: list[tuple[int, int]]) -> None:
        """Give back tiles of `acquire`, their cells already taken back."""
        for key in keys:
            self._users[key] -= 1
            if self._users[key] == 0:
                del self._users[key]
                self._free.append(self._slots.pop(key))

    def table(self, tiles: IntArray) -> Int32Array:
        """Return the slots of a range of tiles, (rows, columns) int32, -1 where there is none."""
        slots = np.array([self._slots.get(key, -1) for key in _keys(tiles)], np.int32)
        return slots.reshape(-1, tiles[1] + 1 - tiles[0])

    def _grow(self) -> None:
        old = len(self.pool)
        new = old + max(_GROW, old // 2)
        if new * grid.TILE**2 >= 2**31:  # more than places of cells can tell
            raise DriveError("the keyframes of a window have points too far apart: lower bev.max_range_m.")
        before = self.pool, self.road, self.other
        self.pool, self.road, self.other = _empty_tiles(new)
        self.pool[:old], self.road[:old], self.other[:old] = before
        self._free.extend(range(new - 1, old - 1, -1))

    def vote(self, places: Int32Array, vote: int) -> None:
        """Add a vote of 1 or -1 for each point at some places of the pool; one of the other sign takes it back."""
        grid.cast_votes(self.pool, self.road, self.other, places, vote, self._minimum)

    def require(self, minimum: int) -> None:
        """Let another number of votes be enough."""
        if minimum != self._minimum:
            self._minimum = minimum
            grid.mark_road(self.pool, self.road, minimum)


def _empty_tiles(count: int) -> tuple[Int32Array, UInt64Array, UInt64Array]:
    cells = grid.TILE * grid.TILE
    road, other = (np.zeros((count, cells // 64), np.uint64) for _ in range(2))
    return np.zeros((count, cells), np.int32), road, other


def _keys(tiles: IntArray) -> list[tuple[int, int]]:
    left, right, low, high = tiles.tolist()
    return [(y, x) for y in range(low, high + 1) for x in range(left, right + 1)]


@dataclass(frozen=True)
class BevImage:
    """The binary image of the region of interest (paper, section III-B.3)."""

    image: BinaryImage
    """Set where enough road points fell into the cell."""
    roi: Roi
    """Where it lies in W."""
    min_points: int
    """How many are enough."""
    share: float = 1.0
    """Keyframes that lie in it, as a share of a full window."""
    against: BinaryImage | None = None
    """Set where votes against road outnumber those for it: there other ground was seen. None where nobody votes."""


@dataclass(frozen=True)
class _Entry:
    keyframe: Keyframe
    x: float
    y: float
    votes: list[tuple[Int32Array, list[tuple[int, int]], int]]  # `places_of`, in which tiles, for or against road


class RoadAccumulator:
    """The road points of the keyframes k-n .. k+n, as counts per cell of a grid anchored in W.

    A keyframe adds its cells when it enters the window and takes them back when it leaves: counts are whole numbers, so
    the sum is the same as if all scans were concatenated anew. `room` is told ahead of each keyframe how many bytes it
    all takes with it; what it raises leaves everything as it was. `first` is the number that its first keyframe has in
    the drive.
    """

    def __init__(
        self, keyframes: KeyframeConfig, bev: BevConfig, room: Callable[[int], None] | None = None, first: int = 0
    ) -> None:
        self._room, self._offset = room, first
        self._kept_bytes = 0  # of where the keyframes of the window have their votes
        self._before, self._after = keyframes.window, keyframes.after
        self._config = bev
        self._grid = TileGrid(bev.min_points)
        self._window: deque[_Entry] = deque()
        self._first = 0  # number of the first keyframe in the window
        self._next = 0  # number of the next keyframe to complete

    def add(
        self, keyframe: Keyframe, road_points: Float32Array, other_points: Float32Array | None = None
    ) -> Keyframe | None:
        """Add a keyframe; return the one that has all its successors now, if any.

        Parameters
        ----------
        keyframe
        road_points : (N, 3) float32
            Road points in L, metres.
        other_points : (M, 3) float32 or None
            Points of what road is most often confused with, in L, metres: each takes one road point of its cell back.
        """
        found = [(1, *self._cells(keyframe, road_points))]
        if other_points is not None:
            found.append((-1, *self._cells(keyframe, other_points)))
        if self._room is not None:
            maximum_bytes = self._kept_bytes + sum(8 * len(cells) for _, cells, _ in found)
            self._room(maximum_bytes + self._grid.bytes_with(tiles for _, _, tiles in found))
        x, y = keyframe.T_world_lidar[:2, 3].tolist()
        self._window.append(_Entry(keyframe, x, y, [self._cast(*each) for each in found]))
        if self._first + len(self._window) <= self._next + self._after:
            return None
        return self._complete()

    def _cells(self, keyframe: Keyframe, points: Float32Array) -> tuple[Int32Array, IntArray]:
        return grid.cells_of(
            np.ascontiguousarray(points, np.float32),
            np.ascontiguousarray(keyframe.T_world_lidar, np.float64),
            self._config.resolution_m,
            self._config.max_range_m,
        )

    def _cast(self, vote: int, cells: Int32Array, tiles: IntArray) -> tuple[Int32Array, list[tuple[int, int]], int]:
        if not len(cells):
            return np.empty((0, 2), np.int32), [], vote
        keys = self._grid.acquire(tiles)
        places = grid.places_of(self._grid.table(tiles), int(tiles[0]), int(tiles[2]), cells)
        self._grid.vote(places, vote)
        self._kept_bytes += places.nbytes
        return places, keys, vote

    def finish(self) -> Keyframe | None:
        """Complete the next keyframe although not all its successors came; None when there is none left."""
        return None if self._next >= self._first + len(self._window) else self._complete()

    def _complete(self) -> Keyframe:
        while self._first < self._next - self._before:
            entry = self._window.popleft()
            for places, tiles, vote in entry.votes:
                self._grid.vote(places, -vote)
                self._kept_bytes -= places.nbytes
                self._grid.release(tiles)
            self._first += 1
        keyframe = self._window[self._next - self._first].keyframe
        self._next += 1
        return keyframe

    @property
    def tiles(self) -> int:
        """Number of tiles that memory was taken for."""
        return len(self._grid.pool)

    def bev(self) -> BevImage:
        """Project what is accumulated to the binary image around the keyframe completed last (paper, eq. 3)."""
        keyframe = self._window[self._next - 1 - self._first].keyframe
        roi = roi_around(keyframe, self._config, self._offset + self._next - 1)
        angle = abs(roi.turn_rad)
        margin = math.ceil((math.cos(angle) + math.sin(angle) - 1.0) / 2 * roi.size)  # the corners of what is turned
        left, top, size = roi.left - margin, roi.top + margin, roi.size + 2 * margin
        table = self._grid.table(np.array([left, left + size - 1, top - size + 1, top]) // grid.TILE)

        def cut(tiles: UInt64Array) -> BinaryImage:
            image = BinaryImage.empty(size, size, roi.resolution_m)
            grid.cut_window(tiles, table, left, top, size, image.words)
            return image

        share = self._share(keyframe)
        m = self._config.min_points
        min_points = max(1, round(m * share)) if self._config.adaptive else m
        self._grid.require(min_points)
        image = cut(self._grid.road)
        if not self._config.vote:
            return BevImage(image.turned(roi.size, roi.turn_rad), roi, min_points, share)
        weight = self._neighbour_weight(share, table, left, top, size)
        if weight > 0.0:
            grid.drop_outvoted(self._grid.pool, table, left, top, weight, image.words)
        image, other = (each.turned(roi.size, roi.turn_rad) for each in (image, cut(self._grid.other)))
        return BevImage(image, roi, min_points, share, other if other.words.any() else None)

    def _neighbour_weight(self, share: float, table: Int32Array, left: int, top: int, size: int) -> float:
        """Return how much the votes of the cells around a cell count beside its own, 0..1.

        Few scans give a cell one vote, and a wrong one decides. Votes of neighbours are mostly of the same ground, and
        add up like the log odds of an occupancy grid (Elfes, "Using occupancy grids", IEEE Computer, 1989). The more
        labels err from point to point, the less a vote of its own says, and the more those around it; where they err
        along borders only, full weight would mend nothing and shorten branches.
        """
        if share >= _POOLED_SHARE:
            return 0.0
        lone = grid.lone_road_share(self._grid.pool, table, left, top, size)
        return float(np.interp(lone, [_RIGHT_LONE, _WRONG_LONE], [_RIGHT_WEIGHT, 1.0]))

    def _share(self, keyframe: Keyframe) -> float:
        """Return how many of a full window's keyframes lie in the region of interest, as a share."""
        (x, y), reach_m = keyframe.T_world_lidar[:2, 3].tolist(), self._config.size_m / 2
        along = [entry for entry in self._window if -reach_m < entry.x - x < reach_m]
        near = [entry for entry in along if -reach_m < entry.y - y < reach_m]
        return len(near) / (self._before + 1 + self._after)


def roi_around(keyframe: Keyframe, config: BevConfig, number: int = 0) -> Roi:
    """Return the square of cells around a keyframe, by its number in the drive turned by -pi/4 to pi/4, if at all.

    The golden ratio spreads the angles of keyframes that follow each other.
    """
    r, size = config.resolution_m, config.cells
    x, y = keyframe.T_world_lidar[0, 3], keyframe.T_world_lidar[1, 3]
    left, top = math.floor(x / r) - size // 2, math.floor(y / r) - size // 2 + size - 1
    return Roi(left, top, size, r, math.pi / 2 * ((number * _GOLDEN + 0.5) % 1.0 - 0.5) if config.turn else 0.0)
