"""Ground plans of scans, laid onto each other.

What stands upright (house fronts, poles, cars, trunks) makes the plan of a scan; where nothing does, the edges of the
road do. Two plans are correlated over the plane by the fast Fourier transform, so no guess of the motion is needed.
Where one is known, road and other ground tell how well it fits: the one must not come to lie on the other.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from interloc.arrays import Float32Array, FloatArray, Int8Array, UInt8Array
from interloc.drive import GroundPoints

MAX_SHIFT_M = 40.0
MAX_TURN_RAD = np.radians(75.0)
MIN_CELLS = 60
"""Of a plan that can be laid onto another."""

_CELL_M = 1.0
_REACH = int(MAX_SHIFT_M / _CELL_M)
_TURN_STEP_RAD, _NEAR_RAD = np.radians(3.0), np.radians(9.0)
_MOST = 0.55
_PLAN_M, _NEAREST_M = 0.5, 2.5
_UPRIGHT_M = 0.4
_UPRIGHT_RANGE_M, _EDGE_RANGE_M = 55.0, 26.0
_GROUND_RANGE_M, _SHARED_CELLS = 30.0, 150
_FINE_M, _WINDOW_M, _FAR_M = 0.25, 60.0, 2.0


def upright_plan(xyz: Float32Array | FloatArray) -> FloatArray:
    """Return the (M, 2) cells, metres, of (N, 3) points in L in which points stand over each other by 0.4 m or more."""
    x, y, z = (xyz[:, axis] for axis in range(3))  # columns one by one: rows of three are slow to pick
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y
        rows = np.flatnonzero((squared > _NEAREST_M**2) & (squared < _UPRIGHT_RANGE_M**2) & np.isfinite(z))
    x, y, z = (each.take(rows) for each in (x, y, z))
    half = int(_UPRIGHT_RANGE_M / _PLAN_M) + 1
    row, column = (np.floor(each / _PLAN_M).astype(np.int32) + half for each in (x, y))
    cell = row * (2 * half) + column
    lowest = np.full((2 * half, 2 * half), np.inf, dtype=xyz.dtype)
    highest = np.full_like(lowest, -np.inf)
    np.minimum.at(lowest.ravel(), cell, z)
    np.maximum.at(highest.ravel(), cell, z)
    upright = np.argwhere(highest - lowest > _UPRIGHT_M).astype(np.float64)
    return (upright - half + 0.5) * _PLAN_M


def road_plan(road: Float32Array | FloatArray) -> FloatArray:
    """Return the (M, 2) cells, metres, at the edges of the road that (N, 3) points around the sensor show."""
    size = 2 * int((_EDGE_RANGE_M + 6) / _PLAN_M)
    near = road[np.hypot(road[:, 0], road[:, 1]) < _EDGE_RANGE_M + 2]
    image: UInt8Array = np.zeros((size, size), dtype=np.uint8)
    row, column = (np.floor(near[:, :2] / _PLAN_M).astype(np.int64) + size // 2).T
    image[row, column] = 1
    closed = cv2.morphologyEx(image, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    edges = np.argwhere(closed - cv2.erode(closed, np.ones((3, 3), np.uint8))).astype(np.float64)
    edge = (edges - size // 2 + 0.5) * _PLAN_M
    distance = np.hypot(edge[:, 0], edge[:, 1])
    return edge[(distance > _NEAREST_M) & (distance < _EDGE_RANGE_M)]  # beyond, the points end, not the road


@dataclass(frozen=True)
class PlanMatch:
    """A plan laid onto another: by all turns and shifts, of which the best is kept."""

    target: FloatArray
    source: FloatArray
    """(M, 2), (N, 2) float64: cells of the two, metres."""
    share: float
    """The largest share of the cells of the source that lie on cells of the target, or half so beside them."""
    motion: FloatArray
    """(3,) float64: by which motion it is reached, x, y in metres and turn in radians."""

    @classmethod
    def of(cls, target: FloatArray, source: FloatArray, turn_rad: float | None = None) -> "PlanMatch":
        """Lay (M, 2) cells of a source onto those of a target; by turns near one, where that is given."""
        turns = np.arange(-MAX_TURN_RAD, MAX_TURN_RAD + 1e-6, _TURN_STEP_RAD)
        if turn_rad is not None:
            turns = turns[np.abs(turns - turn_rad) < _NEAR_RAD]
        shifts = np.arange(-_REACH, _REACH + 1)
        is_near = np.hypot(shifts[:, None], shifts[None]) <= _REACH
        far, near = sorted(int(np.hypot(*each.T).max(initial=0.0) / _CELL_M) + 1 for each in (target, source))[::-1]
        # images hold both, however they are turned, and no shift wraps around
        size = cv2.getOptimalDFTSize(max(far + near + _REACH, 2 * max(far, _REACH)) + 2)
        (image,) = _drawn(target[None, :, 0], target[None, :, 1], size)
        image = np.maximum(image, np.float32(0.5) * cv2.dilate(image, np.ones((3, 3), np.uint8)))
        spectrum = cv2.dft(np.roll(image, (_REACH, _REACH), axis=(0, 1)))  # the first shift is that of -40 m
        found: list[tuple[float, int, float]] = []
        turned = _drawn(*_turned(source, turns[:, None]), size)
        counts = np.maximum(np.count_nonzero(turned, axis=(1, 2)), 1)
        for turn, each, count in zip(turns.tolist(), turned, counts.tolist(), strict=True):
            product = cv2.mulSpectrums(spectrum, cv2.dft(each), 0, conjB=True)
            laid = cv2.idft(product, flags=cv2.DFT_SCALE)[: len(shifts), : len(shifts)]
            halves = np.rint(2.0 * laid) * is_near  # a sum of halves, which the transform gives nearly exactly
            best = int(np.argmax(halves))
            found.append((float(halves.flat[best]) / (2 * count), best, turn))
        share, best, turn = max(found, key=lambda each: each[0])
        row, column = divmod(best, len(shifts))
        return cls(target, source, share, np.array([shifts[row] * _CELL_M, shifts[column] * _CELL_M, turn]))

    def is_sure(self, motion: FloatArray, off_m: float) -> bool:
        """Return whether (3,) a motion is nearly the best, by which most lies on the other, between turns tried."""
        is_best = self.share > _MOST and abs(self.motion[2] - motion[2]) < _NEAR_RAD - _TURN_STEP_RAD
        return is_best and float(self.off_m(motion[None])[0]) - self.best_off_m < off_m

    @cached_property
    def _distance_m(self) -> Float32Array:
        """How far each place is from the nearest cell of the target, up to 2 m, which it is at the border."""
        half = int((np.abs(self.target).max(initial=0.0) + _FAR_M) / _FINE_M) + 2
        free: UInt8Array = np.ones((2 * half + 1, 2 * half + 1), dtype=np.uint8)
        at = np.rint(self.target / _FINE_M).astype(np.int64) + half
        free[at[:, 0], at[:, 1]] = 0
        distance_m: Float32Array = (_FINE_M * cv2.distanceTransform(free, cv2.DIST_L2, 5)).astype(np.float32)
        distance_m[distance_m > _FAR_M] = _FAR_M
        return distance_m

    def off_m(self, motions: FloatArray) -> FloatArray:
        """Return how far the cells of the source, moved by (K, 3) motions, lie from those of the target.

        (K,) float64: the means, each cell up to 2 m; NaN of a motion that is NaN.
        """
        known = np.isfinite(motions).all(axis=1)
        turns = motions[known, 2:]
        turned = _turned(self.source, turns[:1] if (turns == turns[:1]).all() else turns)
        x, y = (np.rint((turned[k] + motions[known, k, None]) / _FINE_M).astype(np.int32) for k in (0, 1))
        window, half = round(_WINDOW_M / _FINE_M), len(self._distance_m) // 2
        inside = (x >= -window) & (x < window) & (y >= -window) & (y < window)
        place = (np.clip(x, -half, half) + half) * len(self._distance_m) + np.clip(y, -half, half) + half
        sums = np.where(inside, self._distance_m.take(place), 0.0).sum(axis=1)
        counts = np.count_nonzero(inside, axis=1)
        off_m: FloatArray = np.full(len(motions), np.nan)
        off_m[known] = np.where(counts > 0, sums / np.maximum(counts, 1), _FAR_M)
        return off_m

    @cached_property
    def best_off_m(self) -> float:
        """The same for the motion with the largest share."""
        return float(self.off_m(self.motion[None])[0])


def _turned(cells: FloatArray, angles_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn (M, 2) cells by (K, 1) angles: (K, M) x and y, which are quicker to work on than pairs of them."""
    c, s = np.cos(angles_rad), np.sin(angles_rad)
    x, y = cells.T
    return c * x - s * y, s * x + c * y


def _drawn(x: FloatArray, y: FloatArray, size: int) -> Float32Array:
    """Draw (K, M) cells, metres, each M around the middle of an image of so many cells: (K, size, size)."""
    images: Float32Array = np.zeros((len(x), size, size), dtype=np.float32)
    row, column = (np.floor(each / _CELL_M).astype(np.int64) + size // 2 for each in (x, y))
    images.ravel()[(np.arange(len(x))[:, None] * size + row) * size + column] = 1.0
    return images


@dataclass(frozen=True)
class GroundPlan:
    """Where around a scan is road and where other ground, in cells of half a metre."""

    signs: Int8Array
    """(S, S) int8: 1 where more points are road, -1 where more are not, 0 where there are none or as many."""

    @classmethod
    def of(cls, points: GroundPoints) -> "GroundPlan":
        """Draw the ground of a scan."""
        half = int(_GROUND_RANGE_M / _PLAN_M)
        near = np.hypot(points.xyz[:, 0], points.xyz[:, 1]) < _GROUND_RANGE_M - _PLAN_M
        row, column = (np.floor(points.xyz[near, :2] / _PLAN_M).astype(np.int64) + half).T
        weights = np.where(points.is_road[near], 1.0, -1.0)
        counts = np.bincount(row * 2 * half + column, weights=weights, minlength=(2 * half) ** 2)
        return cls(np.sign(counts).astype(np.int8).reshape(2 * half, 2 * half))

    def contradiction(self, source: "GroundPlan", motion: FloatArray, scales: FloatArray) -> FloatArray:
        """Return which share of the cells that both know is road in one alone, the source moved by (3,) a motion.

        (K,) float64: with the shift of the motion so many times as far; NaN where they share too few cells.
        """
        half, shares = len(self.signs) // 2, np.full(len(scales), np.nan)
        shifts = scales[:, None] * motion[:2]
        near = (np.abs(shifts) < 2 * _GROUND_RANGE_M).all(axis=1)  # else they share hardly any
        at = np.argwhere(source.signs)
        middles: FloatArray = (at.astype(np.float64) - half + 0.5) * _PLAN_M
        turned = _turned(middles, motion[2:, None])
        row, column = (
            np.floor((axis + shift[:, None]) / _PLAN_M).astype(np.int32)
            for axis, shift in zip(turned, shifts[near].T, strict=True)
        )
        signs = np.pad(self.signs, 3 * half)  # as far as they reach
        products = signs.take((row + 4 * half) * len(signs) + column + 4 * half) * source.signs[*at.T]
        shared = np.count_nonzero(products, axis=1)
        opposed = np.count_nonzero(products < 0, axis=1)
        shares[near] = np.where(shared >= _SHARED_CELLS, opposed / np.maximum(shared, 1), np.nan)
        return shares
