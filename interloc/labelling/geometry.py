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

import cv2
import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray, UInt8Array, UInt32Array
from interloc.kernels.ground import BEAMS
from interloc.kernels.surface import (
    BRIGHTNESS,
    FEATURES,
    HEIGHT,
    ROUGH,
    ROUGH_WEIGHT,
    STEEP,
    WEIGHT,
    add_brightness,
    add_features,
    label_points,
)
from interloc.labelling.surface import (
    CELL_M,
    PLANE_TIMES,
    RANGE_M,
    STRIP_M,
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

# Road on the grid of a window: what looks like the driven strip, as far as it is connected with it.

# What a cell as good as the strip scores, and what each excess over the strip takes from that.
_SCORE = 4.7
_BRIGHT, _BRIGHT_AROUND = 0.4, 0.7
_ROUGH, _ROUGH_AROUND, _STEEP_AROUND, _RIDGE = 0.1, 0.3, 0.2, 1.2
_HIGHER, _OFF = 1.6, 0.1
_MAX_EXCESS, _MAX_RIDGE = 4.0, 5.0
_SIDES_M = (0.2, 0.6, 1.4)  # of the squares that features are averaged over, until there is any
_RIDGE_SIDE_M = 3.8
_SURE_WEIGHT = 4.0  # of a square of 0.6 m; a cell that a ring touched once looks rough by chance

_HEIGHT_UNIT_M = 0.03
_PLANE_M, _PLANE_STIFFNESS_M = 2.4, 2.0
_SMOOTHNESS = 1.5
_STEP_M, _ROUNDS = 1.6, 36
_NEAR_STRIP_M = 8.0


@dataclass(frozen=True)
class Features:
    """What is known of the ground in every cell of a window."""

    score: Float32Array
    """(H, W): how much a cell looks like the driven strip, but for its height."""
    height: Float32Array
    """(H, W): NaN where no ground was seen."""


@dataclass(frozen=True)
class Road:
    """The road of a window: two images of (H, W) cells."""

    cells: BoolArray
    score: Float32Array
    """How much each cell looks like the driven strip and continues the road; NaN where no ground was seen."""


def score_cells(sums: Float32Array, strip: BoolArray) -> Features:
    """Compare the (H, W, 6) sums of `interloc.kernels.surface.add_features` with those of the cells driven over."""

    def mean(feature: int, weight: int, sides_m: tuple[float, ...]) -> Float32Array:
        return _mean(sums[..., feature].copy(), sums[..., weight].copy(), sides_m)

    def excess(feature: Float32Array) -> Float32Array:
        return np.clip(_excess(feature, strip), 0, _MAX_EXCESS)

    rough = mean(ROUGH, ROUGH_WEIGHT, _SIDES_M)
    ridge = _excess(rough - mean(ROUGH, ROUGH_WEIGHT, (_RIDGE_SIDE_M,)), strip) - 1  # a kerb, not a rough place
    seen = 9 * cv2.blur(sums[..., ROUGH_WEIGHT].copy(), (3, 3))
    sure: Float32Array = seen / (seen + np.float32(_SURE_WEIGHT))
    score = (
        _SCORE
        - _BRIGHT * excess(mean(BRIGHTNESS, WEIGHT, _SIDES_M))
        - _BRIGHT_AROUND * excess(mean(BRIGHTNESS, WEIGHT, _SIDES_M[-1:]))
        - sure * _ROUGH * excess(rough)
        - _ROUGH_AROUND * excess(mean(ROUGH, ROUGH_WEIGHT, _SIDES_M[-1:]))
        - _STEEP_AROUND * excess(mean(STEEP, ROUGH_WEIGHT, _SIDES_M[-1:]))
        - sure * _RIDGE * np.clip(ridge, 0, _MAX_RIDGE)
    )
    return Features(score, mean(HEIGHT, WEIGHT, _SIDES_M))


def grow_road(features: Features, strip: BoolArray) -> Road:
    """Grow road from the strip over ground that looks like it and continues its plane."""
    height, known = features.height, ~np.isnan(features.height)
    road = strip
    for _ in range(_ROUNDS):
        off = (height - _plane(height, road & known)) / _HEIGHT_UNIT_M
        score = features.score - _HIGHER * np.clip(off, 0, _MAX_EXCESS) - _OFF * np.clip(np.abs(off), 0, _MAX_EXCESS)
        share = cv2.boxFilter(road.astype(np.float32), -1, (_cells(_SIDES_M[1]),) * 2)
        is_like = (score + _SMOOTHNESS * (2 * share - 1) > 0) & _widened(road, _REACH)
        passable = _opened(_closed(is_like | strip, _GAPS), _VEHICLE)
        grown = _connected(passable | strip, strip)
        if (grown == road).all():
            break
        road = grown
    return Road(_closed(_widened(road, _TO_KERB), _HOLES), score)


def classes_of(road: BoolArray, road_id: int, beside_id: int, other_id: int) -> UInt8Array:
    """Return the label ids of the cells: road, what lies within some metres of it, the rest.

    The border of the road is not sure to half a metre: what is closer counts as the rest, which speaks neither for road
    nor, as ground beside it does, against it.
    """
    classes = np.full(road.shape, other_id, np.uint8)
    classes[_widened(road, _BESIDE)] = beside_id
    classes[_widened(road, _UNSURE)] = other_id
    classes[road] = road_id
    return classes


def measure_road(road: Road, strip: BoolArray) -> tuple[float, float, float]:
    """Return contrast, width in metres and evenness of a road, as `WindowQuality` has them; 0 where not seen."""
    seen = ~np.isnan(road.score)
    near = cv2.distanceTransform((~strip).view(np.uint8), cv2.DIST_L2, 5) < _NEAR_STRIP_M / CELL_M
    width_m = 2 * STRIP_M * int(np.count_nonzero(road.cells & seen & near)) / max(1, int(np.count_nonzero(strip)))
    scores = road.score[strip & seen]
    if not len(scores):
        return 0.0, width_m, 0.0
    border = _widened(road.cells, _BORDER[1]) & ~_widened(road.cells, _BORDER[0]) & seen
    contrast = float(np.median(scores) - np.median(road.score[border])) if border.any() else 0.0
    return contrast, width_m, float(np.percentile(scores, 20))


def _mean(total: Float32Array, weight: Float32Array, sides_m: tuple[float, ...]) -> Float32Array:
    """Return the weighted mean in squares around every cell: the smallest of some sides that has anything."""
    found = np.full_like(total, np.nan)
    for side in map(_cells, sides_m):
        here, value = (
            cv2.boxFilter(each, -1, (side, side), borderType=cv2.BORDER_CONSTANT) for each in (weight, total)
        )
        np.divide(value, here, out=found, where=np.isnan(found) & (here > 1e-4))
    return found


def _excess(feature: Float32Array, strip: BoolArray) -> Float32Array:
    """Return how much larger a feature is than the median of the strip, in spreads of the strip; 0 where unknown."""
    there = feature[strip & ~np.isnan(feature)]
    low, middle, high = np.percentile(there, [16, 50, 84]).astype(np.float32).tolist() if len(there) else (0, 0, 0)
    if high <= low:
        return np.zeros_like(feature)
    excess: Float32Array = np.nan_to_num((feature - middle) / ((high - low) / 2))
    return excess


def _plane(height: Float32Array, road: BoolArray) -> Float32Array:
    """Continue the road to every cell: the plane through the road near it, NaN where there is none."""
    rows, columns = (side // PLANE_TIMES for side in road.shape)
    cell_m = PLANE_TIMES * CELL_M
    n, total = (
        cv2.resize(image.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
        for image in (road, np.where(road, height, 0))
    )
    y, x = np.meshgrid(np.arange(rows) * cell_m, np.arange(columns) * cell_m, indexing="ij")
    sums = np.stack([n, x * n, y * n, x * x * n, x * y * n, y * y * n, total, x * total, y * total], axis=-1)
    near = np.moveaxis(cv2.GaussianBlur(sums, (0, 0), _PLANE_M / cell_m, borderType=cv2.BORDER_CONSTANT), -1, 0)
    n = np.where(near[0] > 1e-5, near[0], np.nan)
    mx, my, xx, xy, yy, mz, xz, yz = near[1:] / n
    xx, xy, yy = xx - mx * mx + _PLANE_STIFFNESS_M**2, xy - mx * my, yy - my * my + _PLANE_STIFFNESS_M**2
    xz, yz = xz - mx * mz, yz - my * mz
    determinant = xx * yy - xy * xy
    a, b = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    plane = (mz + a * (x - mx) + b * (y - my)).astype(np.float32)
    return np.asarray(cv2.resize(plane, road.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def _connected(shape: BoolArray, strip: BoolArray) -> BoolArray:
    """Keep the pieces that touch the strip."""
    _, pieces = cv2.connectedComponents(shape.view(np.uint8), connectivity=4)
    kept: BoolArray = np.isin(np.arange(pieces.max() + 1), np.unique(pieces[strip]))
    return np.asarray(kept[pieces], np.bool_)


def _cells(metres: float) -> int:
    """Return an odd number of cells, about some metres long."""
    return 2 * round((metres / CELL_M - 1) / 2) + 1


def _disc(radius_m: float) -> UInt8Array:
    side = 2 * round(radius_m / CELL_M) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)


def _widened(shape: BoolArray, kernel: UInt8Array) -> BoolArray:
    return cv2.dilate(shape.view(np.uint8), kernel).view(np.bool_)


def _closed(shape: BoolArray, kernel: UInt8Array) -> BoolArray:
    return cv2.morphologyEx(shape.view(np.uint8), cv2.MORPH_CLOSE, kernel).view(np.bool_)


def _opened(shape: BoolArray, kernel: UInt8Array) -> BoolArray:
    return cv2.morphologyEx(shape.view(np.uint8), cv2.MORPH_OPEN, kernel).view(np.bool_)


_GAPS, _VEHICLE, _HOLES = _disc(0.6), _disc(0.8), _disc(0.6)
_TO_KERB, _UNSURE, _BESIDE, _BORDER = _disc(0.3), _disc(1.0), _disc(3.0), (_disc(0.6), _disc(2.5))
_REACH = np.ones((2 * round(_STEP_M / CELL_M) + 1,) * 2, np.uint8)


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
        return Window(grid, surface, classes_of(road.cells, ROAD, BESIDE, OTHER_GROUND))

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

    def __getstate__(self) -> dict[str, object]:
        return {"track": self.track, "_read": self._read}

    def __setstate__(self, state: dict[str, object]) -> None:
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
