"""A drive over any OpenStreetMap file along any track, in one call."""

from __future__ import annotations

from pathlib import Path

from interloc.simulate.config import LidarConfig, SceneConfig
from interloc.simulate.drive import Progress, simulate_drive
from interloc.simulate.scene import build_scene
from interloc.simulate.tracks import Track


def simulate_map(
    track: Track,
    roads: Path,
    out: Path,
    *,
    buildings: Path | None = None,
    seed: int = 0,
    keyframes_only: bool = False,
    ground_only: bool = False,
    max_scans: int | None = None,
    scene: SceneConfig | None = None,
    sensor: LidarConfig | None = None,
    extra_files: dict[str, bytes] | None = None,
    about: dict[str, object] | None = None,
    progress: Progress | None = None,
) -> int:
    """Simulate a drive along a track over the streets of a map.

    Parameters
    ----------
    track
        From `open_track` (GPX, CSV, OXTS), `track_from_line` or `track_from_oxts`.
    roads
        OSM file with the streets (.osm, .osm.gz, .osm.bz2, .osm.pbf).
    buildings
        Another one with the buildings; none: the same file, and houses are made up where it has no building at all.
    out, seed, keyframes_only, ground_only, max_scans, sensor, extra_files, about, progress
        See `simulate_drive`.
    scene
        What the world looks like.

    Returns
    -------
    int
        Scans written.

    Raises
    ------
    MapError
        The map cannot be read or lies elsewhere.
    OutputError
        `out` could not be written.
    """
    scene, sensor = scene or SceneConfig(), sensor or LidarConfig()
    world = build_scene(track, roads, buildings=buildings, config=scene, sensor_height_m=sensor.height_m, seed=seed)
    facts: dict[str, object] = {"map": Path(roads).name, "scene": scene.model_dump()}
    return simulate_drive(
        world,
        track,
        out,
        seed=seed,
        sensor=sensor,
        keyframes_only=keyframes_only,
        ground_only=ground_only,
        max_scans=max_scans,
        extra_files=extra_files,
        about={**facts, **(about or {})},
        progress=progress,
    )
