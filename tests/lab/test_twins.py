"""KITTI twins, where the real tracks and maps are at hand."""

from pathlib import Path

import numpy as np
import shapely
from shapely.geometry import LineString

from interloc.drives.open import open_drive
from interloc.geometry import lonlat_from_enu
from interloc.lab.cases import twin_files, twin_track, twin_trip
from interloc.lab.config import LidarConfig, RoadsideConfig, SceneConfig, SimulationOptions
from interloc.lab.drive import simulate, simulate_drive
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import read_map, street_map_of
from interloc.lab.tracks import LidarTrack


def twin_scene(
    kitti_dir: Path, sequence: str, track: LidarTrack, *, config: SceneConfig | None = None, seed: int = 0
) -> Scene:
    """Return the world of a sequence: streets of `osm/NN.osm.gz`, buildings of `osm_buildings/NN.osm.gz`."""
    files = twin_files(kitti_dir, sequence)
    return build_scene(track, read_map(files["osm"], files.get("buildings")), config=config, seed=seed)


def test_road_points_lie_on_the_streets_of_the_map(kitti: Path, tmp_path: Path) -> None:
    """From the written files alone: scan, OXTS and lever arm give longitudes and latitudes on the road surface."""
    track = twin_track(kitti, "07")
    bare = SceneConfig(roadside=RoadsideConfig(buildings="none", parked_car_density=0), track_half_width_m=0)
    scene = twin_scene(kitti, "07", track, config=bare)
    lines = shapely.STRtree([profile.line for profile in scene.profiles])
    _, aside = lines.query_nearest(shapely.points(scene.T_map_lidar[:, :2, 3]), return_distance=True, all_matches=False)
    assert 0.3 < np.median(aside) < 1.1
    exact = LidarConfig(columns=180, range_noise_m=0, surface_noise=0, road_half_range_m=None)
    options = SimulationOptions(sensor=exact, keyframes_only=True, max_scans=40)
    simulate_drive(scene, track, tmp_path / "07", options)
    drive = open_drive(tmp_path / "07")
    fix = drive.georeference
    streets = street_map_of(read_map(kitti / "osm" / "07.osm.gz"), scene.frame).streets
    tree = shapely.STRtree([LineString(s.xy) for s in streets])
    worst = []
    for k in range(0, 40, 8):
        points = drive.ground_points(k).road[::50].astype(np.float64)
        points = points[np.hypot(points[:, 0], points[:, 1]) < 25]
        enu = points @ fix.R_enu_lidar[k].T
        xy = scene.frame.xy(lonlat_from_enu(fix.lat_deg[k], fix.lon_deg[k], enu[:, :2]))
        # The edge of the road is where the class width puts it: 8.5 m for the widest street here.
        _, distance = tree.query_nearest(shapely.points(xy), return_distance=True, all_matches=False)
        worst.append(float(np.percentile(distance, 95)))
    assert max(worst) < 8.5 / 2 + 0.15


def test_the_poses_written_are_the_given_ones(kitti: Path, tmp_path: Path) -> None:
    suma = np.loadtxt(kitti / "poses_suma" / "07.txt")
    poses_camera = twin_track(kitti, "07").poses_camera
    np.testing.assert_array_equal(poses_camera.reshape(-1, 12), suma[: len(poses_camera)])
    options = SimulationOptions(keyframes_only=True, max_scans=5, sensor=LidarConfig(columns=36))
    simulate(twin_trip(kitti, "07"), tmp_path / "07", options)
    written = np.loadtxt(tmp_path / "07/poses.txt")
    assert all((np.abs(suma - row).max(axis=1) < 1e-6).any() for row in written)
    assert (tmp_path / "07/calib.txt").read_text() == (kitti / "calib" / "07.txt").read_text()
