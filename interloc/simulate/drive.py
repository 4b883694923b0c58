"""Writing a simulated drive to disk, scan by scan."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

from interloc.files import atomic_folder
from interloc.simulate.config import LidarConfig
from interloc.simulate.lidar import Lidar
from interloc.simulate.oxts import IMU_TO_VELO_TEXT, format_oxts, parse_tr
from interloc.simulate.scene import Scene
from interloc.simulate.tracks import Track, camera_poses, keyframe_indices, lidar_poses

Progress = Callable[[int, int], None]

MARKER = "simulation.json"
GROUND_LABELS = (40, 60, 48, 44, 49)
"""Road, lane marking, sidewalk, parking, other ground: all that the method, and its noise model, look at."""


def simulate_drive(
    scene: Scene,
    track: Track,
    out: Path,
    *,
    seed: int = 0,
    sensor: LidarConfig | None = None,
    keyframes_only: bool = False,
    ground_only: bool = False,
    max_scans: int | None = None,
    extra_files: dict[str, bytes] | None = None,
    about: dict[str, object] | None = None,
    progress: Progress | None = None,
) -> int:
    """Write a drive in SemanticKITTI format, with OXTS.

    Parameters
    ----------
    scene, track
        The world and the poses in it, one for each scan, as `build_scene(track, ...)` made it.
    out
        Folder to be made; complete or not at all. An older simulated drive is replaced.
    seed
        Scan k depends on (seed, k of the track) alone: any order and any selection gives the same scans.
    sensor
    keyframes_only
        Simulate only the scans that the method would use (moved > 2 m or turned > 5 degrees), renumbered from 0.
    ground_only
        Write only the points that the method can use: about half the size.
    max_scans
        Stop after so many.
    extra_files
        More files to put into the folder: name and content.
    about
        Facts to keep in `simulation.json`.
    progress
        Called with the scans written and the number of scans.

    Returns
    -------
    int
        Scans written.

    Raises
    ------
    OutputError
        The folder holds something else, or could not be written.
    """
    sensor = sensor or LidarConfig()
    tr = parse_tr(track.calib_text)
    poses_camera = camera_poses(scene.T_map_lidar, tr) if track.poses_camera is None else track.poses_camera
    chosen = np.arange(len(track))
    if keyframes_only:
        chosen = keyframe_indices(lidar_poses(poses_camera, tr))
    chosen = chosen[:max_scans]
    lidar = Lidar(sensor)
    with atomic_folder(Path(out), marker=MARKER) as folder:
        for name in ("velodyne", "labels", "oxts/data"):
            (folder / name).mkdir(parents=True)
        for number, k in enumerate(map(int, chosen)):
            rng = np.random.default_rng([seed, k])
            scan = lidar.scan(scene, scene.T_map_lidar[k], rng, level=int(scene.level[k]))
            points, labels = scan.points, scan.labels
            if ground_only:
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
            "seed": seed,
            "scans": len(chosen),
            "keyframes_only": keyframes_only,
            "ground_only": ground_only,
            "track_frames": chosen.tolist(),
            "sensor": sensor.model_dump(),
            **(about or {}),
        }
        (folder / MARKER).write_text(json.dumps(facts, indent=1) + "\n")
    return len(chosen)
