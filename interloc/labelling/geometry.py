"""Labels of scans without a network: road is what looks like the ground under the vehicle, and is connected with it.

The track is cut into windows of 25 m. The ground around one is found from all scans within 45 m of track, in steps of
which each repairs what the one before leaves unsure:

1. `find_ground`: the plane below the sensor of each scan, however it is mounted; what may be ground along it, and how
   rough and steep that is.
2. `find_surface`: the surface that continues the track without a step, on which every scan is laid by a small raise and
   tilt; poses alone are off by more than a kerb some ten metres away.
3. `gather`: brightness, roughness, slope and height in cells of 0.2 m. Brightness is relative to what the same laser
   measures on the driven strip: then neither range, nor angle, nor the gain of a laser is left in it.
4. `score_cells`: how much brighter, rougher and steeper a cell is than the strip, in spreads of the strip.
5. `grow_road`: road grows from the strip over cells that score well and continue its plane, through openings that are
   wide enough for a vehicle, and stops at kerbs.
6. `label`: the points of a scan on the surface are road, beside the road, or other ground, by their cells.

A window depends on the poses of the drive and on its scans only: whoever labels a scan, alone or in any range of scans,
gets the same labels.

Driven strips as examples of road, and growth over ground without steps, go back to the road followers of the DARPA
challenges (Dahlkamp et al., RSS 2006) and to curb detection in accumulated scans. Weights and thresholds were chosen on
the first ten scans of SemanticKITTI 00 and 07.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import RLock
from typing import Any

import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray, UInt8Array, UInt32Array
from interloc.kernels.ground import BEAMS
from interloc.kernels.surface import FEATURES, add_brightness, add_features, label_points
from interloc.labelling.growth import classes_of, grow_road, measure_road, score_cells
from interloc.labelling.surface import (
    CELL_M,
    RANGE_M,
    SURFACE_CELL_M,
    Grid,
    PlacedScan,
    ScanGround,
    find_ground,
    find_surface,
    lay_on,
    place,
    up_of,
)
from interloc.labelling.track import WINDOW_M, Track, WindowQuality

METHOD = "geometry 1"
"""Name and version of the method: another version may give other labels."""

ROAD, BESIDE, OTHER_GROUND = 40, 48, 72
"""Ids of SemanticKITTI: road; sidewalk, for all ground some metres beside the road; terrain."""

_NEAR_M, _LABELLED_M = 0.3, (0.15, 0.3)
_KEPT_GROUNDS, _KEPT_WINDOWS = 80, 32


@dataclass(frozen=True)
class Window:
    """The ground around a piece of the track."""

    grid: Grid
    surface: Float32Array
    """(H, W) heights; NaN where unknown."""
    classes: UInt8Array
    """(H', W') label ids."""
    quality: WindowQuality


class GeometryLabeller:
    """Labels the scans of a drive with (N, 4, 4) poses T_world_lidar by geometry and brightness.

    `read` returns the (N, 4) points (x, y, z in L, metres, and the remission in any unit, or 0) of the scan in a row;
    only the (M,) `usable` rows are read. It is cheap to send to another process, because windows and scans that it
    remembers stay behind. Several threads may label at the same time.
    """

    def __init__(self, T_world_lidar: FloatArray, usable: IntArray, read: Callable[[int], Float32Array]) -> None:
        self.track = Track.of(T_world_lidar, usable)
        self._read = read
        self._forget()

    def label(self, row: int, points: Float32Array) -> UInt32Array:
        """Return the (N,) ids of SemanticKITTI of the (N, 4) points, in L with their remission, of the scan in a row.

        They are 40 for road, 48 for ground 1 to 3 m beside it, 72 for other ground, 0 for what is too far away or no
        ground.
        """
        window = self.window(self.track.window_of(row))
        if window is None:
            return np.zeros(len(points), np.uint32)
        grid, surface = window.grid, window.surface
        T = (grid.T_grid_world @ self.track.T_world_lidar[row])[:3]
        some = points[::4, :3]  # enough to lay a scan on the surface
        T = lay_on(some[np.isfinite(some).all(axis=1)], T, surface, grid)
        return label_points(points, T, grid.x0, grid.y0, CELL_M, surface, window.classes, ROAD, _LABELLED_M, RANGE_M)

    def window(self, number: int) -> Window | None:
        """Return a window of the track; None where its scans see no ground."""
        with self._lock:
            if number not in self._windows:
                self._windows[number] = self._make_window(number)
                while len(self._windows) > _KEPT_WINDOWS:
                    self._windows.popitem(last=False)
            return self._windows[number]

    def quality_of(self, row: int) -> WindowQuality:
        """Return how sure the labels of a scan are."""
        number = self.track.window_of(row)
        with self._lock:
            if number not in self._quality:
                self.window(number)
            return self._quality[number]

    def known_quality(self) -> list[WindowQuality]:
        """Return how sure the labels are in the windows that were made so far, along the track."""
        return [self._quality[number] for number in sorted(self._quality)]

    def _make_window(self, number: int) -> Window | None:
        track, start_m = self.track, number * WINDOW_M
        found = [(row, ground) for row in track.context(number).tolist() if (ground := self._ground(row)) is not None]
        self._quality[number] = WindowQuality(start_m, start_m + WINDOW_M, 0.0, 0.0, 0.0)
        if not found:
            return None
        rows, grounds = [row for row, _ in found], [ground for _, ground in found]
        poses, line = track.T_world_lidar, track.line_around(number)[:, :3]
        grid = Grid.around(poses[track.rows_in(number), :3, 3], up_of(grounds, poses[rows, :3, :3]))
        strip = ~np.isnan(grid.draw(line, CELL_M))
        under_track = grid.draw(line, SURFACE_CELL_M) - np.float32(np.median([each.height_m for each in grounds]))
        placed = [place(ground, poses[row], grid) for row, ground in found]
        surface, placed = find_surface(placed, grid, under_track)
        features = score_cells(gather(placed, grid, surface, strip), strip)
        road = grow_road(features, strip)
        self._quality[number] = WindowQuality(start_m, start_m + WINDOW_M, *measure_road(road, strip))
        return Window(grid, surface, classes_of(road.cells, ROAD, BESIDE, OTHER_GROUND), self._quality[number])

    def _ground(self, row: int) -> ScanGround | None:
        if row not in self._grounds:
            self._grounds[row] = find_ground(self._read(row))
            while len(self._grounds) > _KEPT_GROUNDS:
                self._grounds.popitem(last=False)
        return self._grounds[row]

    def _forget(self) -> None:
        self._grounds: OrderedDict[int, ScanGround | None] = OrderedDict()
        self._windows: OrderedDict[int, Window | None] = OrderedDict()
        self._quality: dict[int, WindowQuality] = {}
        self._lock = RLock()

    def __getstate__(self) -> dict[str, Any]:
        return {"track": self.track, "_read": self._read}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()


def gather(scans: Sequence[PlacedScan], grid: Grid, surface: Float32Array, strip: BoolArray) -> Float32Array:
    """Return the (H, W, 6) float32 features of the ground in every cell, given the (H, W) cells that were driven over.

    They are weighted sums: see `interloc.kernels.surface.add_features`.
    """
    table = np.zeros((BEAMS, 3))
    for scan in scans:
        add_brightness(scan.ground.cells, scan.T, grid.x0, grid.y0, CELL_M, strip, table)
    brightness = brightness_of_strip(table)
    sums = np.zeros((grid.rows, grid.columns, FEATURES), np.float32)
    for scan in scans:
        add_features(scan.ground.cells, scan.T, grid.x0, grid.y0, CELL_M, surface, _NEAR_M, brightness, sums)
    return sums


def brightness_of_strip(table: FloatArray) -> FloatArray:
    """Return how to turn the remission of each laser into brightness against the strip: (B, 3) float64.

    These are what to subtract, what to divide by (infinity where all is the same), and what to add. The table holds the
    number, sum, and sum of squares of the remission of the strip per laser. A laser that has seen too little of the
    strip goes with those beside it, or counts as somewhat bright.
    """
    around = table.copy()
    around[1:] += table[:-1]
    around[:-1] += table[1:]
    number, total, squares = np.where(table[:, :1] >= 20, table, around).T
    known = number >= 10
    result = np.tile([0.0, np.inf, 0.7], (len(table), 1))
    if not known.any():
        return result
    mean = total[known] / number[known]
    variance = np.maximum(0.0, squares[known] / number[known] - mean**2)
    spread = float(np.sqrt(np.average(variance, weights=number[known])))
    if spread <= 1e-6 * max(1e-6, float(np.abs(mean).max())):  # no remission at all
        result[:, 2] = 0.0
        return result
    result[known] = np.column_stack([mean, np.full_like(mean, spread), np.zeros_like(mean)])
    return result
