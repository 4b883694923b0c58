"""The ground that one scan sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.geometry import invert_transform
from interloc.kernels.ground import best_plane, ground_cells, lowest_points

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
    """Find the plane that most of the low points around the sensor lie on, and the cells of ground along it.

    Parameters
    ----------
    points : (N, 4) float32
        x, y, z in L, metres, and the remission.

    Returns
    -------
    ScanGround or None
        None where too few points lie on any plane below the sensor.
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
    T_ground_lidar = _level(plane)
    cells = ground_cells(points, T_ground_lidar[:3], *RANGE_M, _CONE, _ABOVE_M, CELL_M, _ROUGH_REACH, _STIFFNESS_M)
    return ScanGround(invert_transform(T_ground_lidar), float(plane[3]), cells)


def _level(plane: FloatArray) -> FloatArray:
    """Return the (4, 4) transform from L into the frame whose z = 0 is a plane, turned as little as possible."""
    up = plane[:3]
    ahead = np.array([1.0, 0.0, 0.0]) - up[0] * up
    ahead /= np.linalg.norm(ahead)
    T = np.eye(4)
    T[:3, :3] = ahead, np.cross(up, ahead), up
    T[2, 3] = plane[3]
    return T
