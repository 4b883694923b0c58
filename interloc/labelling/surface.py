"""The ground that each scan sees, and the surface around a window of the track, from all scans near it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray
from interloc.geometry import invert_transform
from interloc.kernels.ground import best_plane, ground_cells, lowest_points
from interloc.kernels.surface import scan_minima, tilt_against

CELL_M = 0.2
"""Side of the cells that features are gathered in."""

RANGE_M = (2.5, 45.0)
"""Distances between which ground is labelled: nearer is the vehicle, farther its rings are too sparse."""

_PLANE_M, _PLANE_CELL_M, _PLANE_ERROR_M = 20.0, 1.0, 0.1
_MAX_TILT_RAD = np.radians(40.0)
_TRIES = 200
_CONE = (0.3, 0.07)
_ABOVE_M = 0.4
_ROUGH_REACH = 2  # cells to each side: half a metre from the middle
_STIFFNESS_M = 0.15


@dataclass(frozen=True)
class ScanGround:
    """What may be ground in a scan."""

    T_lidar_ground: FloatArray
    """(4, 4) float64: from the frame of its cells, whose z = 0 is the plane of the ground below the sensor."""
    height_m: float
    """Of the sensor over that plane."""
    cells: Float32Array
    """(M, 8) float32: columns as of `interloc.kernels.ground.ground_cells`."""


def find_ground(points: Float32Array) -> ScanGround | None:
    """Find the plane that most low points around the sensor lie on, of (N, 4), and the cells of ground along it.

    It is None where too few points lie on any plane below the sensor.
    """
    low = lowest_points(points, RANGE_M[0], _PLANE_M, _PLANE_CELL_M)
    if len(low) < 10:
        return None
    triples = np.random.default_rng(0).integers(len(low), size=(_TRIES, 3))
    plane = best_plane(low, triples, _PLANE_ERROR_M, float(np.cos(_MAX_TILT_RAD)))
    for _ in range(3):
        near = low[np.abs(low @ plane[:3] + plane[3]) < _PLANE_ERROR_M]
        if len(near) < 10:
            return None
        middle = near.mean(axis=0)
        normal = np.linalg.svd(near - middle, full_matrices=False)[2][2]
        normal *= np.copysign(1.0, normal[2])
        plane = np.append(normal, -normal @ middle)
    T_ground_lidar = np.eye(4)
    T_ground_lidar[:3, :3], T_ground_lidar[2, 3] = _level(plane[:3]), plane[3]
    cells = ground_cells(points, T_ground_lidar[:3], *RANGE_M, _CONE, _ABOVE_M, CELL_M, _ROUGH_REACH, _STIFFNESS_M)
    return ScanGround(invert_transform(T_ground_lidar), float(plane[3]), cells)


def _level(up: FloatArray) -> FloatArray:
    """Return the (3, 3) rotation into the frame whose z is a (3,) direction, turned as little as possible."""
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    return np.stack([ahead, np.cross(up, ahead), up])


# The surface


SURFACE_TIMES = 3
"""Cells of features along one of the surface."""

PLANE_TIMES = 6
"""And along one of the coarsest grid; sides of grids are multiples of it."""

SURFACE_CELL_M = SURFACE_TIMES * CELL_M
STRIP_M = 1.3
"""What lies this close to the track was driven over."""

_MARGIN_M = 1.0
_TRACK_ERROR_M = 0.3
_STEP_M = 0.2
_BRIDGED = (5, 5)  # cells of the surface
_NOISE_M = (0.1, 0.2)
_PRIOR = (0.3, 0.02)  # metres; metres per metre
_FIT_M = np.array([0.3, 0.2, 0.1, 0.1])
_ROUNDS = 2


@dataclass(frozen=True)
class Grid:
    """Cells around the scans of a window, in a level frame of its own."""

    T_grid_world: FloatArray
    """(4, 4) float64: z up from the ground, x as that of W."""
    x0: float
    y0: float
    """Corner of cell (0, 0), metres."""
    rows: int
    columns: int
    """Cells of `CELL_M`."""

    @classmethod
    def around(cls, position: FloatArray, up: FloatArray) -> "Grid":
        """Make the grid around (N, 3) positions in W where a (3,) direction is up."""
        T = np.eye(4)
        T[:3, :3] = _level(up)
        T[:3, 3] = -T[:3, :3] @ position.mean(axis=0)
        xy = position @ T[:2, :3].T + T[:2, 3]
        step = PLANE_TIMES * CELL_M
        low = np.floor((xy.min(axis=0) - RANGE_M[1] - _MARGIN_M) / step)
        count = np.ceil((xy.max(axis=0) + RANGE_M[1] + _MARGIN_M) / step) - low
        columns, rows = (PLANE_TIMES * count).astype(int).tolist()
        return cls(T, float(low[0] * step), float(low[1] * step), rows, columns)

    @property
    def surface_shape(self) -> tuple[int, int]:
        """Rows and columns of the surface."""
        return self.rows // SURFACE_TIMES, self.columns // SURFACE_TIMES

    def draw(self, line: FloatArray, cell_m: float) -> Float32Array:
        """Draw the (P, 3) points of a line in W as wide as the driven strip: their heights, NaN elsewhere."""
        xyz = line @ self.T_grid_world[:3, :3].T + self.T_grid_world[:3, 3]
        times = round(cell_m / CELL_M)
        image = np.full((self.rows // times, self.columns // times), np.nan, np.float32)
        centres = np.round(((xyz[:, :2] - (self.x0, self.y0)) / cell_m - 0.5) * 16).astype(int)
        for centre, height in zip(centres.tolist(), xyz[:, 2].tolist(), strict=True):
            cv2.circle(image, centre, round(STRIP_M / cell_m * 16), height, thickness=-1, shift=4)
        return image


@dataclass(frozen=True)
class PlacedScan:
    """The ground of a scan on a grid."""

    ground: ScanGround
    T: FloatArray
    """(3, 4) float64: from its frame into that of the grid."""


def lay_on(points: Float32Array, T: FloatArray, surface: Float32Array, grid: Grid) -> FloatArray:
    """Return a (3, 4) transform changed so that points lie on a surface: raised and tilted, but not moved."""
    raised, along_x, along_y = tilt_against(points, T, surface, grid.x0, grid.y0, SURFACE_CELL_M, _FIT_M, _PRIOR)
    laid = T.copy()
    laid[2] += along_x * T[0] + along_y * T[1]
    laid[2, 3] += raised - along_x * T[0, 3] - along_y * T[1, 3]
    return laid


def find_surface(scans: Sequence[PlacedScan], grid: Grid, track: Float32Array) -> tuple[Float32Array, list[PlacedScan]]:
    """Find the (H, W) surface of the ground that is connected with the track, and return the scans laid on it, too.

    `track` holds the (H, W) heights of the ground under the track; both are NaN elsewhere. Poses tilt and drift by more
    than a kerb is high from one scan to another tens of metres on: each scan is raised and tilted to lie on what all
    say, which sharpens what they say.
    """
    placed = list(scans)
    for _ in range(_ROUNDS):
        surface = _grow(_heights(placed, grid), track)
        placed = [replace(scan, T=lay_on(scan.ground.cells, scan.T, surface, grid)) for scan in placed]
    surface = _grow(_heights(placed, grid), track)
    known = ~np.isnan(surface)
    return np.where(known, surface, _mean_around(np.nan_to_num(surface), known)), placed


def _heights(scans: Sequence[PlacedScan], grid: Grid) -> Float32Array:
    """Return the mean of the lowest heights of the scans in every cell, but of those far from the second lowest.

    The lowest of all may be an echo from below.
    """
    minima = np.empty((len(scans), *grid.surface_shape), np.float32)
    lowest = np.full(grid.surface_shape, np.inf, np.float32)
    second = lowest.copy()
    for scan, own in zip(scans, minima, strict=True):
        scan_minima(scan.ground.cells, scan.T, grid.x0, grid.y0, SURFACE_CELL_M, own)
        np.minimum(second, np.maximum(lowest, own), out=second)
        np.minimum(lowest, own, out=lowest)
    second[np.isinf(second)] = lowest[np.isinf(second)]
    total, count = np.zeros_like(lowest), np.zeros_like(lowest)
    for own in minima:
        near = (own > second - _NOISE_M[0]) & (own < second + _NOISE_M[1])
        np.add(total, own, out=total, where=near)
        count += near
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0)


def _grow(height: Float32Array, track: Float32Array) -> Float32Array:
    """Keep of the heights those that are connected with the track without a step."""
    is_ground: BoolArray = np.abs(height - track) < _TRACK_ERROR_M
    known = np.nan_to_num(height)
    while True:
        near = _mean_around(known, is_ground)
        grown = is_ground | (np.abs(height - near) < _STEP_M)
        if (grown == is_ground).all():
            return np.where(is_ground, height, np.float32(np.nan))
        is_ground = grown


def _mean_around(height: Float32Array, known: BoolArray) -> Float32Array:
    """Return the mean of the known heights around every cell; NaN where there are none."""
    count, total = (
        cv2.boxFilter(each, -1, _BRIDGED, normalize=False, borderType=cv2.BORDER_CONSTANT)
        for each in (known.astype(np.float32), np.where(known, height, np.float32(0)))
    )
    return np.divide(total, count, out=np.full_like(total, np.nan), where=count > 0.5)


def up_of(scans: Sequence[ScanGround], rotations: FloatArray) -> FloatArray:
    """Return the (3,) mean direction up from the ground of scans, in W, from their (N, 3, 3) rotations."""
    up = sum(rotation @ scan.T_lidar_ground[:3, 2] for scan, rotation in zip(scans, rotations, strict=True))
    unit: FloatArray = up / np.linalg.norm(up)
    return unit


def place(ground: ScanGround, T_world_lidar: FloatArray, grid: Grid) -> PlacedScan:
    """Place the ground of a scan on a grid, by its pose."""
    return PlacedScan(ground, (grid.T_grid_world @ T_world_lidar @ ground.T_lidar_ground)[:3])
