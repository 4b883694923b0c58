"""Upright walls that occlude: of buildings, cars, hedges."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from interloc.arrays import FloatArray, UInt8Array
from interloc.simulate.heights import HeightField
from interloc.simulate.surfaces import Surface

MAX_WALL_M = 24.0
_CELL_M = 24.0


@dataclass
class WallList:
    """Walls while a scene is being built; heights above the ground."""

    walls: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)
    surfaces: list[int] = field(default_factory=list)

    def add_line(self, xy: FloatArray, bottom_m: float, top_m: float, surface: Surface) -> None:
        """Add a wall along (N, 2) points; long pieces are divided, so that each follows the ground."""
        for a, b in pairwise(xy):
            pieces = max(int(np.ceil(float(np.hypot(*(b - a))) / MAX_WALL_M)), 1)
            ends = np.linspace(a, b, pieces + 1)
            for p, q in pairwise(ends):
                self.walls.append((float(p[0]), float(p[1]), float(q[0]), float(q[1]), bottom_m, top_m))
                self.surfaces.append(int(surface))

    def add_box(
        self,
        centre: FloatArray,
        heading_rad: float,
        size: tuple[float, float],
        bottom_m: float,
        top_m: float,
        surface: Surface,
    ) -> None:
        """Add the four sides of a box of a length and a width."""
        c, s = np.cos(heading_rad), np.sin(heading_rad)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * np.array(size) / 2
        self.add_line(corners @ np.array([[c, s], [-s, c]]) + centre, bottom_m, top_m, surface)


class Obstacles:
    """All walls of a scene, found by place.

    Parameters
    ----------
    walls : WallList
    fields : sequence of HeightField
        The ground on which they stand, one for each level from which the scene is seen.
    """

    def __init__(self, walls: WallList, fields: list[HeightField]) -> None:
        flat = np.array(walls.walls, dtype=np.float64).reshape(-1, 6)
        middle = (flat[:, :2] + flat[:, 2:4]) / 2
        self._cells = np.floor(middle / _CELL_M).astype(np.int64)
        order = np.lexsort((self._cells[:, 0], self._cells[:, 1]))
        flat, middle, self._cells = flat[order], middle[order], self._cells[order]
        self._surfaces = np.array(walls.surfaces, dtype=np.uint8)[order]
        self._walls = []
        for heights in fields:
            placed = flat.copy()
            placed[:, 4:] += np.array([heights.at(x, y) for x, y in middle]).reshape(-1, 1)
            self._walls.append(placed)

    def __len__(self) -> int:
        return len(self._surfaces)

    def near(self, x: float, y: float, reach_m: float, *, level: int = 0) -> tuple[FloatArray, UInt8Array]:
        """Return the (S, 6) float64 walls (ends, bottom, top in M) and (S,) uint8 surfaces around a place."""
        span = int(np.ceil((reach_m + MAX_WALL_M / 2) / _CELL_M))
        column, row = int(np.floor(x / _CELL_M)), int(np.floor(y / _CELL_M))
        rows = self._cells[:, 1]
        pieces = []
        for r in range(row - span, row + span + 1):
            a, b = np.searchsorted(rows, [r, r + 1])
            if a < b:
                c, d = np.searchsorted(self._cells[a:b, 0], [column - span, column + span + 1])
                pieces.append(slice(int(a + c), int(a + d)))
        if not pieces:
            return np.zeros((0, 6)), np.zeros(0, np.uint8)
        walls = self._walls[level]
        return np.concatenate([walls[p] for p in pieces]), np.concatenate([self._surfaces[p] for p in pieces])
