"""One turn of a LiDAR in a scene."""

import numpy as np

from interloc.arrays import Float32Array, FloatArray, UInt32Array
from interloc.lab.config import LidarConfig
from interloc.lab.ground import MATERIAL_TABLE
from interloc.lab.raycast import cast_rays
from interloc.lab.scene import Scene

_LABELS = MATERIAL_TABLE[:, 0].astype(np.uint32)


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
        self, scene: Scene, T_map_lidar: FloatArray, rng: np.random.Generator, *, level: int = 0
    ) -> tuple[Float32Array, UInt32Array]:
        """Measure one turn, which takes no time, at a pose (4, 4), as seen from a level of the scene (`Scene.level`).

        Returns (N, 4) float32 x, y, z in L (metres) and remission, ring by ring from the top, and (N,) uint32
        SemanticKITTI ids. `rng` decides noise and dropout; the same state gives the same scan.
        """
        x, y = float(T_map_lidar[0, 3]), float(T_map_lidar[1, 3])
        reach = self.config.max_range_m
        scene.ground.show(x, y, reach, plan=level)
        walls, surfaces = scene.obstacles.near(x, y, reach, level=level)
        shape = (len(self.elevations), len(self.azimuths))
        normal, uniform = rng.standard_normal((2, *shape), dtype=np.float32), rng.random(shape, dtype=np.float32)
        points, codes, hit = cast_rays(
            np.ascontiguousarray(T_map_lidar[:3, 3]),
            np.ascontiguousarray(T_map_lidar[:3, :3]),
            self.elevations,
            self.azimuths,
            scene.ground.tiles,
            scene.ground.index,
            scene.ground.frame,
            scene.heights[level].grid,
            scene.heights[level].frame,
            walls,
            surfaces,
            MATERIAL_TABLE,
            self._limits,
            normal,
            uniform,
        )
        seen = np.nonzero(hit)
        return points[seen], _LABELS[codes[seen]]
