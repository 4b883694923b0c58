"""Scans of a crossing of two streets with kerbs, sidewalks and grass, by a spinning sensor."""

from dataclasses import dataclass

import numpy as np

from interloc.arrays import Float32Array, FloatArray
from interloc.geometry import rotation_from_rpy

ROAD_M, SIDEWALK_M = 4.0, 2.5
"""Half the width of a street; width of a sidewalk."""


@dataclass(frozen=True)
class Street:
    """How high the kerbs are, the remission of road, sidewalk and grass, where the sensor is (tilt: roll, pitch)."""

    kerb_m: float = 0.12
    shades: tuple[float, float, float] = (0.2, 0.3, 0.5)
    height_m: float = 1.8
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    beams: int = 32

    def poses(self, x: FloatArray, *, heading_rad: float = 0.0) -> FloatArray:
        """Return the poses of the sensor along the street, (N, 4, 4), in the world of the first."""
        poses = np.tile(np.eye(4), (len(x), 1, 1))
        poses[:, 0, 3], poses[:, 2, 3] = x, self.height_m
        poses[:, :3, :3] = rotation_from_rpy(0.0, 0.0, heading_rad) @ rotation_from_rpy(*self.tilt_rad, 0.0)
        return poses

    def scan(self, pose: FloatArray, seed: int = 0) -> tuple[Float32Array, FloatArray]:
        """Return the (N, 4) points of a scan, and the (N,) distances from the middle of the nearer street."""
        generator = np.random.default_rng(seed)
        elevation = np.radians(np.linspace(-25.0, 5.0, self.beams))
        azimuth = np.radians(np.arange(0.0, 360.0, 0.6))
        e, a = (each.ravel() for each in np.meshgrid(elevation, azimuth, indexing="ij"))
        rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1) @ pose[:3, :3].T
        rays = rays[rays[:, 2] < -0.02]
        range_m = -pose[2, 3] / rays[:, 2]
        xy = pose[:2, 3] + range_m[:, None] * rays[:, :2]
        aside = np.abs(xy).min(axis=1)
        kind = (aside > ROAD_M).astype(np.int64) + (aside > ROAD_M + SIDEWALK_M)  # road, sidewalk, grass
        raised = (kind > 0) & (self.kerb_m > 0)
        range_m[raised] = (self.kerb_m - pose[2, 3]) / rays[raised, 2]
        range_m += generator.normal(0.0, np.array([0.01, 0.01, 0.04])[kind])
        shade = np.array(self.shades)[kind] * generator.uniform(0.8, 1.2, len(kind))
        points = np.column_stack([(range_m[:, None] * rays) @ pose[:3, :3], shade])
        near = range_m < 60.0
        return points[near].astype(np.float32), aside[near]
