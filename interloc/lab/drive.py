"""Simulating a drive along a track over a map, and writing it to disk scan by scan."""

import json
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from interloc.config import DEFAULT
from interloc.detection.keyframes import select_keyframes
from interloc.files import atomic_folder
from interloc.lab.config import DEFAULT_OPTIONS, SimulationOptions
from interloc.lab.lidar import Lidar
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import MapData
from interloc.lab.tracks import IMU_TO_VELO_TEXT, LidarTrack, camera_poses, format_oxts, lidar_poses, parse_tr
from interloc.processes import Progress

MARKER = "simulation.json"
GROUND_LABELS = (40, 60, 48, 44, 49)
"""Road, lane marking, sidewalk, parking, other ground: all that the method, and its noise model, look at."""


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
    with atomic_folder(Path(out), marker=MARKER) as folder:
        for name in ("velodyne", "labels", "oxts/data"):
            (folder / name).mkdir(parents=True)
        for number, k in enumerate(map(int, chosen)):
            rng = np.random.default_rng([options.seed, k])
            points, labels = lidar.scan(scene, scene.T_map_lidar[k], rng, level=int(scene.level[k]))
            if options.ground_only:
                kept = np.isin(labels, GROUND_LABELS)
                points, labels = points[kept], labels[kept]
            points.tofile(folder / f"velodyne/{number:06d}.bin")
            labels.tofile(folder / f"labels/{number:06d}.label")
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
            "sensor": options.sensor.model_dump(),
            **(about or {}),
        }
        (folder / MARKER).write_text(json.dumps(facts, indent=1) + "\n")
    return len(chosen)


@dataclass(frozen=True)
class Trip:
    """Where to drive."""

    track: LidarTrack
    """From `open_track` (GPX, CSV, OXTS), `track_from_line` or `track_from_oxts`."""
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
    facts = {"map": trip.map.path.name, "scene": options.scene.model_dump(), **trip.about}
    return simulate_drive(scene, trip.track, out, options, extra_files=trip.extra_files, about=facts, progress=progress)
