"""What the ground and the obstacles are made of: labels, heights, reflectance.

A surface code is what the raster of the ground holds; several may carry one label (a kerbside parking bay is flush
with the road, the ground between carriageways is raised by a kerb).
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

from interloc.arrays import FloatArray
from interloc.kernels.raycast import STEP_M

KERB_M = 2 * STEP_M
_PATCH_M = 2.5
_PATCHES = np.random.default_rng(0).standard_normal((64, 64))


class Surface(IntEnum):
    """Code of a piece of ground or of an obstacle."""

    TERRAIN = 0
    ROAD = 1
    MARKING = 2
    SIDEWALK = 3
    PARKING = 4
    OTHER_GROUND = 5
    BUILDING = 6
    CAR = 7
    VEGETATION = 8
    FENCE = 9
    STRUCTURE = 10
    FLUSH_SIDEWALK = 11


class Material(NamedTuple):
    """Properties of a surface."""

    label: int
    """SemanticKITTI id."""
    raise_m: float
    """Height above the road."""
    roughness_m: float
    """Standard deviation of the height (ground) or of the range (obstacles)."""
    remission: float
    remission_std: float
    """Mean and spread, as measured on sequence 07 of SemanticKITTI."""
    reflectance: float
    """How well it is seen from afar, relative to a wall."""


MATERIALS: dict[Surface, Material] = {
    Surface.TERRAIN: Material(72, STEP_M, 0.030, 0.35, 0.115, 1.2),
    Surface.ROAD: Material(40, 0.0, 0.005, 0.265, 0.085, 1.0),
    Surface.MARKING: Material(60, 0.0, 0.005, 0.48, 0.12, 1.6),
    Surface.SIDEWALK: Material(48, KERB_M, 0.006, 0.295, 0.088, 1.1),
    Surface.PARKING: Material(44, 0.0, 0.008, 0.28, 0.09, 1.0),
    Surface.OTHER_GROUND: Material(49, KERB_M, 0.012, 0.31, 0.10, 1.1),
    Surface.BUILDING: Material(50, 0.0, 0.03, 0.327, 0.15, 1.0),
    Surface.CAR: Material(10, 0.0, 0.02, 0.12, 0.20, 0.8),
    Surface.VEGETATION: Material(70, 0.0, 0.15, 0.35, 0.12, 0.9),
    Surface.FENCE: Material(51, 0.0, 0.04, 0.30, 0.13, 0.7),
    Surface.STRUCTURE: Material(52, 0.0, 0.02, 0.33, 0.12, 1.0),
    Surface.FLUSH_SIDEWALK: Material(48, 0.0, 0.006, 0.295, 0.088, 1.1),
}

MATERIAL_TABLE = np.array([MATERIALS[code] for code in Surface], dtype=np.float64)
"""(surfaces, 6) float64: the columns of `Material`, one row per code; the kernel reads it."""

GROUND = np.array([code <= Surface.OTHER_GROUND or code == Surface.FLUSH_SIDEWALK for code in Surface])
"""(surfaces,) bool: what is ground."""


def worn(xy: FloatArray) -> FloatArray:
    """Return how much (N, 2) places in M are brighter than usual, in standard deviations: patches of some metres."""
    shades: FloatArray = map_coordinates(_PATCHES, xy.T / _PATCH_M, order=1, mode="grid-wrap")
    return shades
