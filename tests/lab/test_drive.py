"""The files of a simulated drive, tracks from lines and from OXTS, and twins of drives of KITTI."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString

from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.errors import DriveError
from interloc.geometry import enu_from_lonlat, lonlat_from_enu, yaw_of
from interloc.lab.cases import twin_trip
from interloc.lab.config import LidarConfig, RoadsideConfig, SceneConfig, SimulationOptions, TrackConfig
from interloc.lab.drive import Trip, simulate, simulate_drive
from interloc.lab.scene import Scene, build_scene
from interloc.lab.streets import read_map, street_map_of
from interloc.lab.tracks import LidarTrack, track_from_line, track_from_oxts
from tests.lab.conftest import FRAME, SMALL_LIDAR


@pytest.fixture(scope="module")
def folder(street_scene: Scene, straight_track: LidarTrack, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("drive") / "street"
    simulate_drive(street_scene, straight_track, out, SimulationOptions(seed=5, sensor=SMALL_LIDAR, max_scans=12))
    return out


def test_the_drive_reader_finds_nothing_wrong(folder: Path) -> None:
    report = inspect_drive(folder, thorough=True)
    assert not report.problems
    assert report.pose_frame == "camera"


def test_the_pieces_agree_on_where_the_lidar_was(folder: Path, street_scene: Scene) -> None:
    drive = open_drive(folder)
    fix = drive.georeference
    lonlat = street_scene.frame.lonlat(street_scene.T_map_lidar[:12, :2, 3])
    off = enu_from_lonlat(fix.lat_deg, fix.lon_deg, lonlat)
    assert np.abs(off).max() < 1e-3
    assert np.allclose(np.diff(drive.T_world_lidar[:, 0, 3]), 2.0, atol=1e-6)


def test_a_selection_gives_the_same_scans(
    folder: Path, street_scene: Scene, straight_track: LidarTrack, tmp_path: Path
) -> None:
    out = tmp_path / "keyframes"
    options = SimulationOptions(seed=5, sensor=SMALL_LIDAR, keyframes_only=True, max_scans=3)
    simulate_drive(street_scene, straight_track, out, replace(options, max_scans=5))
    count = simulate_drive(street_scene, straight_track, out, options)
    assert count == 3
    assert len(list((out / "velodyne").iterdir())) == 3  # of the older drive nothing is left
    chosen = json.loads((out / "simulation.json").read_text())["track_frames"]
    assert chosen[0] == 0
    for number, k in enumerate(chosen):
        for name in ("velodyne/{:06d}.bin", "labels/{:06d}.label"):
            assert (out / name.format(number)).read_bytes() == (folder / name.format(k)).read_bytes()


def test_ground_only_keeps_what_the_method_reads(
    street_scene: Scene, straight_track: LidarTrack, tmp_path: Path
) -> None:
    seen: list[tuple[int, int]] = []
    simulate_drive(
        street_scene,
        straight_track,
        tmp_path / "ground",
        SimulationOptions(sensor=SMALL_LIDAR, ground_only=True, max_scans=2),
        progress=lambda done, of: seen.append((done, of)),
    )
    assert set(np.unique(np.fromfile(tmp_path / "ground/labels/000000.label", np.uint32))) == {40, 48}
    assert seen == [(1, 2), (2, 2)]


def test_a_line_over_a_map(write_map: Callable[..., Path], tmp_path: Path) -> None:
    roads = write_map(
        ([(-90.0, 0.0), (0.0, 0.0), (90.0, 0.0)], {"highway": "residential"}),
        ([(0.0, 0.0), (20.0, 80.0)], {"highway": "residential"}),
    )
    lonlat = FRAME.lonlat([[-30, 0], [0, 0], [10, 40]])
    trip = Trip(track_from_line(lonlat, None, TrackConfig(speed_mps=10, rate_hz=4)), read_map(roads))
    count = simulate(trip, tmp_path / "drive", SimulationOptions(sensor=LidarConfig(columns=120)))
    drive = open_drive(tmp_path / "drive")
    assert count == len(drive.frames)
    assert 26 <= count <= 29  # 71 m at 2.5 m a scan, less what rounding the corner saves
    assert np.linalg.norm(drive.T_world_lidar[-1, :3, 3] - drive.T_world_lidar[0, :3, 3]) > 50
    labels = np.fromfile(tmp_path / "drive/labels/000010.label", np.uint32)
    assert 50 in labels  # houses are made up where the map has none


def test_a_line_is_driven_at_constant_speed() -> None:
    track = track_from_line(FRAME.lonlat([[0, 0], [0, 50], [50, 50]]), None, TrackConfig(speed_mps=5, rate_hz=10))
    xy = FRAME.xy(np.column_stack([track.lon_deg, track.lat_deg]))
    steps = np.hypot(*np.diff(xy, axis=0).T)
    assert np.allclose(steps, 0.5, atol=0.02)
    yaw = yaw_of(track.R_enu_lidar)
    assert yaw[0] == pytest.approx(np.pi / 2, abs=0.01)
    assert yaw[-1] == pytest.approx(0.0, abs=0.01)
    assert np.abs(np.diff(yaw)).max() < 0.25  # no jump at the corner


def test_an_offset_is_to_the_right() -> None:
    track = track_from_line(FRAME.lonlat([[0, 0], [0, 50]]), None, TrackConfig(offset_m=1.6))
    assert np.allclose(FRAME.xy(np.column_stack([track.lon_deg, track.lat_deg]))[:, 0], 1.6, atol=0.01)


def test_oxts_rows_and_lidar_fixes_undo_each_other() -> None:
    track = track_from_line(FRAME.lonlat([[0, 0], [30, 20], [60, 20]]), np.array([100.0, 101, 103]))
    again = track_from_oxts(track.oxts, track.times_s)
    metres = [111_000, 73_000, 1]
    for a, b, scale in zip(
        (track.lat_deg, track.lon_deg, track.alt_m), (again.lat_deg, again.lon_deg, again.alt_m), metres, strict=True
    ):
        assert np.abs(a - b).max() * scale < 1e-4
    assert np.allclose(track.R_enu_lidar, again.R_enu_lidar, atol=1e-6)  # the calibration has 7 digits


def test_lines_that_cannot_be_driven() -> None:
    with pytest.raises(DriveError, match="1 point"):
        track_from_line(FRAME.lonlat([[0, 0]]))


def test_road_points_lie_on_the_streets_of_the_map(kitti: Path, tmp_path: Path) -> None:
    """From the written files alone: scan, OXTS and lever arm give longitudes and latitudes on the road surface."""
    trip = twin_trip(kitti, "07")
    bare = SceneConfig(roadside=RoadsideConfig(buildings="none", parked_car_density=0), track_half_width_m=0)
    scene = build_scene(trip.track, trip.map, config=bare)
    lines = shapely.STRtree([profile.line for profile in scene.profiles])
    _, aside = lines.query_nearest(shapely.points(scene.T_map_lidar[:, :2, 3]), return_distance=True, all_matches=False)
    assert 0.3 < np.median(aside) < 1.1
    exact = LidarConfig(columns=180, range_noise_m=0, surface_noise=0, road_half_range_m=None)
    options = SimulationOptions(sensor=exact, keyframes_only=True, max_scans=40)
    simulate_drive(scene, trip.track, tmp_path / "07", options)
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
    trip = twin_trip(kitti, "07")
    poses_camera = trip.track.poses_camera
    np.testing.assert_array_equal(poses_camera.reshape(-1, 12), suma[: len(poses_camera)])
    options = SimulationOptions(keyframes_only=True, max_scans=5, sensor=LidarConfig(columns=36))
    simulate(trip, tmp_path / "07", options)
    written = np.loadtxt(tmp_path / "07/poses.txt")
    assert all((np.abs(suma - row).max(axis=1) < 1e-6).any() for row in written)
    assert (tmp_path / "07/calib.txt").read_text() == (kitti / "calib" / "07.txt").read_text()
