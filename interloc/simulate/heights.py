"""The height of the ground around a track, known only where the vehicle drove."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.kernels.raycast import height_at

_CELL_M = 4.0
_SMOOTH_M = 6.0  # width of the Gaussian that smooths the heights along a track
_SLOPE_M, _AHEAD_M = 10.0, 40.0
_PIECE_M, _OFF_PITCH = 5.0, 0.1


@dataclass(frozen=True)
class HeightField:
    """Heights on a coarse grid."""

    grid: Float32Array
    """(rows, columns) float32: height in M, metres; sample (r, c) lies at (x0_m + c * cell_m, y0_m + r * cell_m)."""
    x0_m: float
    y0_m: float
    cell_m: float

    @property
    def frame(self) -> FloatArray:
        """(3,) float64: x0, y0, cell, as the kernel takes them."""
        return np.array([self.x0_m, self.y0_m, self.cell_m])

    def at(self, x: float, y: float) -> float:
        """Return the height of a place."""
        return float(height_at(self.grid, self.x0_m, self.y0_m, self.cell_m, float(x), float(y)))


def flat_field() -> HeightField:
    """Return the plane z = 0."""
    return HeightField(np.zeros((2, 2), np.float32), 0.0, 0.0, 1.0)


def fit_heights(xyz: FloatArray, *, margin_m: float) -> HeightField:
    """Spread heights known along a track over its neighbourhood.

    Parameters
    ----------
    xyz : (N, 3) float64
        Ground points under the vehicle in M. Where the track passes a place again at another height (drift of
        satellite heights), the mean counts.
    margin_m
        How far around the track the field reaches.

    Notes
    -----
    Push-pull interpolation: cell means are averaged into ever coarser grids, and empty cells take the value of the
    finest coarser grid that knows one. Then one blur.
    """
    low = xyz[:, :2].min(axis=0) - margin_m
    size = np.ceil((xyz[:, :2].max(axis=0) + margin_m - low) / _CELL_M).astype(int) + 2
    base = float(np.mean(xyz[:, 2]))
    column, row = np.rint((xyz[:, :2] - low) / _CELL_M).astype(int).T
    weight = np.zeros((size[1], size[0]), np.float32)
    total = np.zeros_like(weight)
    np.add.at(weight, (row, column), 1.0)
    np.add.at(total, (row, column), xyz[:, 2] - base)
    mean = np.divide(total, weight, out=total, where=weight > 0)
    filled = _push_pull(mean, (weight > 0).astype(np.float32))
    blurred = cv2.GaussianBlur(filled, (0, 0), _SMOOTH_M / _CELL_M, borderType=cv2.BORDER_REPLICATE)
    return HeightField((blurred + base).astype(np.float32), float(low[0]), float(low[1]), _CELL_M)


def beyond_ends(xyz: FloatArray) -> FloatArray:
    """Lead a track on for 40 m beyond both ends, as it rises there: else the ground ahead has heights of elsewhere.

    Parameters
    ----------
    xyz : (N, 3) float64
        Ground points under the vehicle in M.

    Returns
    -------
    (M, 3) float64
        Points before the first and after the last; none of a track that is hardly longer than a vehicle.
    """
    found = [np.empty((0, 3))]
    for track in (xyz, xyz[::-1]):
        away = np.linalg.norm(track - track[0], axis=1)
        if (away > _SLOPE_M).any():
            row = int(np.argmax(away > _SLOPE_M))
            found.append(
                track[0] + np.arange(_CELL_M, _AHEAD_M, _CELL_M)[:, None] * (track[0] - track[row]) / away[row]
            )
    return np.concatenate(found)


def without_drift(xyz: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """Take out of a track what it rises and the vehicle does not: satellite heights that settle fall by many metres.

    Parameters
    ----------
    xyz : (N, 3) float64
        Ground points under the vehicle in M.
    pitch_rad : (N,) float64
        Of the vehicle, upwards.

    Returns
    -------
    (N, 3) float64
        The same points, but that pieces of 5 m that rise by 10 % more, or less, than the vehicle is pitched rise as it
        is pitched.
    """
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xyz[:, :2], axis=0), axis=1))])
    at = np.arange(0.0, driven[-1] + 2 * _PIECE_M, _PIECE_M)
    heights = np.interp(at, driven, xyz[:, 2])
    climbed = _PIECE_M * np.tan(np.interp(at[:-1], driven, pitch_rad))
    more = np.diff(heights) - climbed
    more[np.abs(more) < _OFF_PITCH * _PIECE_M] = 0.0
    drift = np.append(np.cumsum(more[::-1])[::-1], 0.0)  # the heights of the end count
    found = xyz.copy()
    found[:, 2] += np.interp(driven, at, drift)
    drifts = more[np.minimum(driven / _PIECE_M, len(more) - 1).astype(np.int64)] != 0.0
    found[drifts, 2] = np.interp(driven[drifts], at, heights + drift)
    return found


def _push_pull(mean: Float32Array, weight: Float32Array) -> Float32Array:
    if weight.all() or max(weight.shape) == 1:
        return mean
    rows, columns = mean.shape
    padded = ((0, rows % 2), (0, columns % 2))
    sums = np.pad(mean * weight, padded).reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).sum(axis=(1, 3))
    weights = np.pad(weight, padded).reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).sum(axis=(1, 3))
    coarse_mean = np.divide(sums, weights, out=np.zeros_like(sums), where=weights > 0)
    coarse = _push_pull(coarse_mean, np.minimum(weights, 1.0))
    fine = cv2.resize(coarse, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)[:rows, :columns]
    return np.where(weight > 0, mean, fine).astype(np.float32)
