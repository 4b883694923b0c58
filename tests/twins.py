"""The worlds of KITTI twins."""

from pathlib import Path

from interloc.lab.cases import twin_files
from interloc.lab.config import SceneConfig
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import read_map
from interloc.lab.tracks import LidarTrack


def twin_scene(
    kitti_dir: Path, sequence: str, track: LidarTrack, *, config: SceneConfig | None = None, seed: int = 0
) -> Scene:
    """Return the world of a sequence: streets of `osm/NN.osm.gz`, buildings of `osm_buildings/NN.osm.gz`."""
    files = twin_files(kitti_dir, sequence)
    return build_scene(track, read_map(files["osm"], files.get("buildings")), config=config, seed=seed)
