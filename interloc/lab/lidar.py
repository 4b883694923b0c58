"""One turn of a LiDAR in a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from interloc.arrays import BoolArray, Float32Array, FloatArray, IntArray, UInt8Array, UInt32Array
from interloc.lab.config import LidarConfig
from interloc.lab.ground import GROUND, MATERIAL_TABLE, worn
from interloc.lab.raycast import cast_rays
from interloc.lab.scene import Scene
from interloc.odometry import Velocity

_SECTORS = 90  # in which the sensor stands still: 4 degrees, 1.5 cm at 50 km/h
_BRIGHTEST = 0.99
_LABELS = MATERIAL_TABLE[:, 0].astype(np.uint32)


@dataclass(frozen=True)
class SimulatedScan:
    """What one turn sees."""

    points: Float32Array
    """(N, 4) float32: x, y, z in L (metres) and remission, ring by ring from the top."""
    labels: UInt32Array
    """(N,) uint32: semanticKITTI ids."""
    times_s: Float32Array | None = None
    """(N,) float32 or None: when each was measured, seconds after the beginning of the turn; None where it takes no
    time."""

    def of(self, kept: BoolArray) -> SimulatedScan:
        """Return some of the points, by a (N,) mask."""
        return SimulatedScan(self.points[kept], self.labels[kept], None if self.times_s is None else self.times_s[kept])


class Lidar:
    """A LiDAR by its configuration.

    An HDL-64E is two blocks of lasers: the upper half of the rings a third of a degree apart, the lower half a half.
    The chance of a return falls with reflectance * cos(incidence) / range^2.
    """

    def __init__(self, config: LidarConfig | None = None) -> None:
        config = config or LidarConfig()
        self.config = config
        upper = (config.rings + 1) // 2
        lower = config.rings - upper
        gap = (config.middle_deg - config.bottom_deg) / max(lower, 1)
        self.elevations = np.radians(
            np.concatenate(
                [
                    np.linspace(config.top_deg, config.middle_deg, upper),
                    np.linspace(config.middle_deg - gap, config.bottom_deg, lower),
                ]
            )
        )
        self.azimuths = 2 * np.pi * (np.arange(config.columns) + 0.5) / config.columns
        half = config.road_half_range_m
        self._limits = np.array(
            [
                config.min_range_m,
                config.max_range_m,
                config.range_noise_m,
                config.surface_noise,
                config.dropout,
                -np.inf if half is None else np.log(config.height_m / half**3),
            ]
        )

    def scan(
        self,
        scene: Scene,
        T_map_lidar: FloatArray,
        rng: np.random.Generator,
        *,
        level: int = 0,
        velocity: Velocity | None = None,
    ) -> SimulatedScan:
        """Measure one turn that begins at a pose (4, 4) in the scene, as seen from a level of it (`Scene.level`).

        `rng` decides noise and dropout; the same state gives the same scan. `velocity` is how the sensor moves
        meanwhile; None: a turn takes no time.
        """
        x, y = float(T_map_lidar[0, 3]), float(T_map_lidar[1, 3])
        reach = self.config.max_range_m
        scene.ground.show(x, y, reach, plan=level)
        walls, surfaces = scene.obstacles.near(x, y, reach, level=level)
        shape = (len(self.elevations), len(self.azimuths))
        normal, uniform = rng.standard_normal((2, *shape), dtype=np.float32), rng.random(shape, dtype=np.float32)
        times = self.config.turn_s * np.arange(shape[1]) / shape[1]
        pieces = []
        for sector in np.array_split(np.arange(shape[1]), 1 if velocity is None else _SECTORS):
            pose = T_map_lidar if velocity is None else T_map_lidar @ velocity.after(float(times[sector].mean()))
            pieces.append(
                cast_rays(
                    np.ascontiguousarray(pose[:3, 3]),
                    np.ascontiguousarray(pose[:3, :3]),
                    self.elevations,
                    self.azimuths[sector],
                    scene.ground.tiles,
                    scene.ground.index,
                    scene.ground.frame,
                    scene.heights[level].grid,
                    scene.heights[level].frame,
                    walls,
                    surfaces,
                    MATERIAL_TABLE,
                    self._limits,
                    np.ascontiguousarray(normal[:, :, sector]),
                    np.ascontiguousarray(uniform[:, sector]),
                )
            )
        points, codes, hit = (np.concatenate(parts, axis=1) for parts in zip(*pieces, strict=True))
        lasers, columns = np.nonzero(hit)
        points, codes = points[lasers, columns], codes[lasers, columns]
        self._shade(points, codes, lasers, scene, T_map_lidar)
        return SimulatedScan(points, _LABELS[codes], None if velocity is None else times[columns].astype(np.float32))

    def _shade(
        self, points: Float32Array, codes: UInt8Array, lasers: IntArray, scene: Scene, T_map_lidar: FloatArray
    ) -> None:
        """Change the brightness of points: lasers of unequal gain, worn ground."""
        if self.config.gain:
            gains = 1 + self.config.gain * np.random.default_rng(0).standard_normal(len(self.elevations))
            points[:, 3] *= gains[lasers]
        if scene.wear:
            ground = GROUND[codes]
            xy = points[ground, :2] @ T_map_lidar[:2, :2].T + T_map_lidar[:2, 3]
            points[ground, 3] *= 1 + scene.wear * worn(xy)
        if self.config.gain or scene.wear:
            np.clip(points[:, 3], 0, _BRIGHTEST, out=points[:, 3])
