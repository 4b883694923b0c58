"""Tiles of the ground raster, painted when first needed and forgotten when no longer: constant memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from interloc.arrays import FloatArray, Int32Array, UInt8Array
from interloc.simulate.ground import Layer, paint


class GroundRaster:
    """The ground around the sensor as surface codes.

    Parameters
    ----------
    plans : sequence of list of Layer
        The ground as seen from the usual level, and (optional) from a street that it hides.
    differences : BaseGeometry
        Where the plans differ; elsewhere they share tiles.
    box : (4,) float
        Least x, least y, greatest x, greatest y of the world in M, metres.
    tile_m, cell_m : float
        Side of a tile (a whole number of cells is made) and of a cell.
    capacity : int
        Tiles kept in memory; grows if one scan needs more.
    """

    def __init__(
        self,
        plans: Sequence[list[Layer]],
        differences: BaseGeometry,
        box: Sequence[float],
        *,
        tile_m: float,
        cell_m: float,
        capacity: int,
    ) -> None:
        self._plans = plans
        self._differences = differences
        self._tile_m = tile_m
        self._cells = max(round(tile_m / cell_m), 1)
        self._x0, self._y0 = float(box[0]), float(box[1])
        columns, rows = (int(np.ceil((box[i + 2] - box[i]) / tile_m)) + 1 for i in (0, 1))
        self.index: Int32Array = np.full((rows, columns), -1, np.int32)
        self.tiles: UInt8Array = np.zeros((capacity, self._cells, self._cells), np.uint8)
        self._slots: OrderedDict[tuple[int, int, int], int] = OrderedDict()
        self._shown: list[tuple[int, int]] = []

    @property
    def frame(self) -> FloatArray:
        """(3,) float64: x0, y0, side of a tile, as the kernel takes them."""
        return np.array([self._x0, self._y0, self._tile_m])

    def show(self, x: float, y: float, reach_m: float, *, plan: int = 0) -> None:
        """Make `index` and `tiles` hold everything within `reach_m` of a place."""
        for row, column in self._shown:
            self.index[row, column] = -1
        low = np.floor((np.array([x, y]) - reach_m - [self._x0, self._y0]) / self._tile_m).astype(int)
        high = np.floor((np.array([x, y]) + reach_m - [self._x0, self._y0]) / self._tile_m).astype(int)
        rows = range(max(low[1], 0), min(high[1], self.index.shape[0] - 1) + 1)
        columns = range(max(low[0], 0), min(high[0], self.index.shape[1] - 1) + 1)
        self._shown = [(row, column) for row in rows for column in columns]
        if len(self._shown) > len(self.tiles):
            self.tiles = np.concatenate([self.tiles, np.zeros((len(self._shown), *self.tiles.shape[1:]), np.uint8)])
        for row, column in self._shown:
            self.index[row, column] = self._slot(row, column, plan)

    def _slot(self, row: int, column: int, plan: int) -> int:
        left, bottom = self._x0 + column * self._tile_m, self._y0 + row * self._tile_m
        if plan:
            tile = shapely.box(left, bottom, left + self._tile_m, bottom + self._tile_m)
            plan = plan if self._differences.intersects(tile) else 0
        key = (row, column, plan)
        if key in self._slots:
            self._slots.move_to_end(key)
            return self._slots[key]
        full = len(self._slots) == len(self.tiles)
        slot = self._slots.popitem(last=False)[1] if full else len(self._slots)
        self.tiles[slot] = paint(self._plans[plan], left, bottom, self._tile_m, self._cells)
        self._slots[key] = slot
        return slot
