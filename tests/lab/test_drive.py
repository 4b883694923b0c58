"""The files of a simulated drive, and a drive from a map and a track in one call."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from interloc.drives.inspect import inspect_drive
from interloc.drives.open import open_drive
from interloc.errors import OutputError
from interloc.geometry import enu_from_lonlat
from interloc.lab.config import LidarConfig, SimulationOptions, TrackConfig
from interloc.lab.drive import Trip, simulate, simulate_drive
from interloc.lab.scene import Scene
from interloc.lab.streets import read_map
from interloc.lab.tracks import LidarTrack, LocalFrame, track_from_line


@pytest.fixture(scope="module")
def folder(
    street_scene: Scene, straight_track: LidarTrack, small_sensor: LidarConfig, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    out = tmp_path_factory.mktemp("drive") / "street"
    simulate_drive(street_scene, straight_track, out, SimulationOptions(seed=5, sensor=small_sensor, max_scans=12))
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
    folder: Path, street_scene: Scene, straight_track: LidarTrack, small_sensor: LidarConfig, tmp_path: Path
) -> None:
    out = tmp_path / "keyframes"
    options = SimulationOptions(seed=5, sensor=small_sensor, keyframes_only=True, max_scans=3)
    count = simulate_drive(street_scene, straight_track, out, options)
    assert count == 3
    chosen = json.loads((out / "simulation.json").read_text())["track_frames"]
    assert chosen[0] == 0
    for number, k in enumerate(chosen):
        for name in ("velodyne/{:06d}.bin", "labels/{:06d}.label"):
            assert (out / name.format(number)).read_bytes() == (folder / name.format(k)).read_bytes()


def test_ground_only_keeps_what_the_method_reads(
    street_scene: Scene, straight_track: LidarTrack, small_sensor: LidarConfig, tmp_path: Path
) -> None:
    seen: list[tuple[int, int]] = []
    simulate_drive(
        street_scene,
        straight_track,
        tmp_path / "ground",
        SimulationOptions(sensor=small_sensor, ground_only=True, max_scans=2),
        progress=lambda done, of: seen.append((done, of)),
    )
    assert set(np.unique(np.fromfile(tmp_path / "ground/labels/000000.label", np.uint32))) == {40, 48}
    assert seen == [(1, 2), (2, 2)]


def test_a_run_that_stops_leaves_nothing(street_scene: Scene, straight_track: LidarTrack, tmp_path: Path) -> None:
    def stop(_: int, __: int) -> None:
        raise KeyboardInterrupt

    options = SimulationOptions(sensor=LidarConfig(columns=36))
    with pytest.raises(KeyboardInterrupt):
        simulate_drive(street_scene, straight_track, tmp_path / "out", options, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_something_else_stays(street_scene: Scene, straight_track: LidarTrack, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(OutputError, match="thesis"):
        simulate_drive(street_scene, straight_track, tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_a_line_over_a_map(frame: LocalFrame, write_map: Callable[..., Path], tmp_path: Path) -> None:
    roads = write_map(
        ([(-90.0, 0.0), (0.0, 0.0), (90.0, 0.0)], {"highway": "residential"}),
        ([(0.0, 0.0), (20.0, 80.0)], {"highway": "residential"}),
    )
    lonlat = frame.lonlat([[-30, 0], [0, 0], [10, 40]])
    trip = Trip(track_from_line(lonlat, None, TrackConfig(speed_mps=10, rate_hz=4)), read_map(roads))
    count = simulate(trip, tmp_path / "drive", SimulationOptions(sensor=LidarConfig(columns=120)))
    drive = open_drive(tmp_path / "drive")
    assert count == len(drive.frames)
    assert 26 <= count <= 29  # 71 m at 2.5 m a scan, less what rounding the corner saves
    assert np.linalg.norm(drive.T_world_lidar[-1, :3, 3] - drive.T_world_lidar[0, :3, 3]) > 50
    labels = np.fromfile(tmp_path / "drive/labels/000010.label", np.uint32)
    assert 50 in labels  # houses are made up where the map has none
