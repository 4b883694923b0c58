"""Simulating a drive along a track over a map: one turn of a LiDAR after the other, written to disk scan by scan."""

import json
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, FloatArray, UInt32Array
from interloc.config import DEFAULT
from interloc.detection.keyframes import select_keyframes
from interloc.files import atomic_folder
from interloc.lab.config import DEFAULT_OPTIONS, LidarConfig, SimulationOptions
from interloc.lab.ground import MATERIAL_TABLE
from interloc.lab.raycast import cast_rays
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import MapData
from interloc.lab.tracks import IMU_TO_VELO_TEXT, LidarTrack, camera_poses, format_oxts, lidar_poses, parse_tr
from interloc.processes import Progress

_LABELS = MATERIAL_TABLE[:, 0].astype(np.uint32)
MARKER = "simulation.json"
GROUND_LABELS = (40, 60, 48, 44, 49)
"""Road, lane marking, sidewalk, parking, other ground: all that the method, and its noise model, look at."""


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


def simulate_drive(
    scene: Scene,
    track: LidarTrack,
    out: Path,
    options: SimulationOptions = DEFAULT_OPTIONS,
    *,
    extra_files: dict[str, bytes] | None = None,
    about: dict[str, object] | None = None,
    progress: Progress | None = None,
) -> int:
    """Write a drive in SemanticKITTI format, with OXTS.

    `track` has a pose for each scan, in the scene that `build_scene(track, ...)` made. The folder is complete or not
    made at all; an older simulated drive is replaced. Scan k depends on the seed and k alone: any order and any
    selection gives the same scans. `extra_files` are written beside (name and content), `about` is kept in
    `simulation.json`.
    """
    tr = parse_tr(track.calib_text)
    poses_camera = camera_poses(scene.T_map_lidar, tr) if track.poses_camera is None else track.poses_camera
    chosen = np.arange(len(track))
    if options.keyframes_only:
        chosen = select_keyframes(lidar_poses(poses_camera, tr), DEFAULT.keyframes)
    chosen = chosen[: options.max_scans]
    lidar = Lidar(options.sensor)
    with atomic_folder(Path(out), marker=MARKER, names=("velodyne", "labels", "oxts", "map.osm")) as folder:
        for name in ("velodyne", "labels", "oxts/data"):
            (folder / name).mkdir(parents=True)
        for number, k in enumerate(map(int, chosen)):
            rng = np.random.default_rng([options.seed, k])
            points, labels = lidar.scan(scene, scene.T_map_lidar[k], rng, level=int(scene.level[k]))
            if options.ground_only:
                kept = np.isin(labels, GROUND_LABELS)
                points, labels = points[kept], labels[kept]
            (folder / f"velodyne/{number:06d}.bin").write_bytes(points.tobytes())
            (folder / f"labels/{number:06d}.label").write_bytes(labels.tobytes())
            (folder / f"oxts/data/{number:010d}.txt").write_text(format_oxts(track.oxts[k]))
            if progress is not None:
                progress(number + 1, len(chosen))
        np.savetxt(folder / "poses.txt", poses_camera[chosen].reshape(-1, 12), fmt="%.9e")
        np.savetxt(folder / "times.txt", track.times_s[chosen], fmt="%.6e")
        (folder / "calib.txt").write_text(track.calib_text)
        (folder / "calib_imu_to_velo.txt").write_text(IMU_TO_VELO_TEXT)
        for name, content in (extra_files or {}).items():
            (folder / name).write_bytes(content)
        facts = {
            "interloc": version("interloc"),
            "seed": options.seed,
            "scans": len(chosen),
            "keyframes_only": options.keyframes_only,
            "ground_only": options.ground_only,
            "track_frames": chosen.tolist(),
            "sensor": asdict(options.sensor),
            **(about or {}),
        }
        (folder / MARKER).write_text(json.dumps(facts, indent=1) + "\n")
    return len(chosen)


@dataclass(frozen=True)
class Trip:
    """Where to drive."""

    track: LidarTrack
    """From `track_from_line` or `track_from_oxts`."""
    map: MapData
    """From `read_map`."""
    about: dict[str, object] = field(default_factory=dict)
    """Facts to keep in `simulation.json`."""
    extra_files: dict[str, bytes] = field(default_factory=dict)
    """More files to put beside the scans: name and content."""


def simulate(
    trip: Trip, out: Path, options: SimulationOptions = DEFAULT_OPTIONS, *, progress: Progress | None = None
) -> int:
    """Simulate a drive along a track over the streets of a map; one that lies elsewhere is a MapError."""
    scene = build_scene(
        trip.track, trip.map, config=options.scene, sensor_height_m=options.sensor.height_m, seed=options.seed
    )
    facts = {"map": trip.map.path.name, "scene": asdict(options.scene), **trip.about}
    return simulate_drive(scene, trip.track, out, options, extra_files=trip.extra_files, about=facts, progress=progress)
