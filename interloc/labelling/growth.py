"""Road on the grid of a window: what looks like the driven strip, as far as it is connected with it."""

from dataclasses import dataclass

import cv2
import numpy as np

from interloc.arrays import BoolArray, Float32Array, UInt8Array
from interloc.kernels.surface import BRIGHTNESS, HEIGHT, ROUGH, ROUGH_WEIGHT, STEEP, WEIGHT
from interloc.labelling.surface import CELL_M, PLANE_TIMES, STRIP_M

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
