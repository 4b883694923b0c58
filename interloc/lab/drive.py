"""Simulating a drive along a track over a map, and writing it to disk scan by scan."""

import json
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from interloc.arrays import Float32Array, FloatArray, UInt32Array
from interloc.config import DEFAULT
from interloc.detection.keyframes import select_keyframes
from interloc.files import atomic_folder
from interloc.geometry import invert_transform
from interloc.lab.config import DEFAULT_OPTIONS, SimulationOptions
from interloc.lab.lidar import Lidar
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import MapData
from interloc.lab.tracks import IMU_TO_VELO_TEXT, LidarTrack, camera_poses, format_oxts, lidar_poses, parse_tr
from interloc.odometry import Velocity
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
    """Write a drive in SemanticKITTI format, with OXTS; scans whose turn takes time as PCD files.

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
        velocities = _velocities(scene.T_map_lidar, track.times_s) if options.sensor.turn_s else None
        for name in (("velodyne", "labels") if velocities is None else ("pcd",)) + ("oxts/data",):
            (folder / name).mkdir(parents=True)
        for number, k in enumerate(map(int, chosen)):
            rng = np.random.default_rng([options.seed, k])
            velocity = None if velocities is None else velocities[k]
            scan = lidar.scan(scene, scene.T_map_lidar[k], rng, level=int(scene.level[k]), velocity=velocity)
            if options.ground_only:
                scan = scan.of(np.isin(scan.labels, GROUND_LABELS))
            if scan.times_s is None:
                scan.points.tofile(folder / f"velodyne/{number:06d}.bin")
                scan.labels.tofile(folder / f"labels/{number:06d}.label")
            else:
                (folder / f"pcd/{number:06d}.pcd").write_bytes(_pcd_bytes(scan.points, scan.labels, scan.times_s))
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


def _velocities(T_map_lidar: FloatArray, times_s: FloatArray) -> list[Velocity]:
    """Return the velocity after each of (N,) poses; after the last one, that before."""
    steps = invert_transform(T_map_lidar[:-1]) @ T_map_lidar[1:]
    found = [Velocity.between(step, passed) for step, passed in zip(steps, np.diff(times_s).tolist(), strict=True)]
    return [*found, found[-1]]


def _pcd_bytes(points: Float32Array, labels: UInt32Array, times_s: Float32Array) -> bytes:
    """Return the scan as a PCD file whose points carry label and time."""
    cells = np.zeros(
        len(points), [(name, "<f4") for name in ("x", "y", "z", "intensity")] + [("label", "<u4"), ("t", "<f4")]
    )
    for column, name in enumerate(("x", "y", "z", "intensity")):
        cells[name] = points[:, column]
    cells["label"], cells["t"] = labels, times_s
    header = (
        "VERSION 0.7\nFIELDS x y z intensity label t\nSIZE 4 4 4 4 4 4\nTYPE F F F F U F\nCOUNT 1 1 1 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    return header.encode() + cells.tobytes()


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
