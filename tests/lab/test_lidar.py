"""What one turn of the LiDAR must show of a flat street with one house."""

from dataclasses import replace

import numpy as np
import pytest

from interloc.lab.config import LidarConfig
from interloc.lab.drive import Lidar
from interloc.lab.ground import KERB_M
from interloc.lab.scene import Scene

Seen = tuple[np.ndarray, np.ndarray]
MIDDLE = 30  # the pose of the track nearest to x = 0


def about_the_vehicle(scan: Seen, pose: np.ndarray) -> np.ndarray:
    """Points in the axes of the map; the origin on the ground under the sensor."""
    shift = pose[:3, 3] * [0, 0, 1]
    return scan[0][:, :3].astype(float) @ pose[:3, :3].T + shift


@pytest.fixture(scope="module")
def exact(street_scene: Scene, exact_lidar: Lidar) -> tuple[Seen, np.ndarray]:
    pose = street_scene.T_map_lidar[MIDDLE]
    scan = exact_lidar.scan(street_scene, pose, np.random.default_rng(0))
    return scan, about_the_vehicle(scan, pose)


def test_road_points_lie_on_the_plane(exact: tuple[Seen, np.ndarray]) -> None:
    scan, xyz = exact
    road = xyz[scan[1] == 40]
    assert len(road) > 5000
    assert np.abs(road[:, 2]).max() < 1e-4
    assert np.abs(road[:, 1]).max() < 3.25 + 0.15  # 6.5 m wide; half a cell on either side


def test_sidewalk_points_lie_a_kerb_higher(exact: tuple[Seen, np.ndarray]) -> None:
    scan, xyz = exact
    walk = xyz[scan[1] == 48]
    assert walk[:, 2].max() < KERB_M + 1e-4
    assert walk[:, 2].min() > -1e-4
    assert np.median(walk[:, 2]) == pytest.approx(KERB_M, abs=1e-4)
    assert np.abs(walk[:, 1]).min() > 3.25 - 0.15
    assert np.abs(walk[:, 1]).max() < 3.25 + 1.9 + 0.15


def test_the_kerb_is_seen_as_sidewalk(exact: tuple[Seen, np.ndarray]) -> None:
    scan, xyz = exact
    face = (scan[1] == 48) & (xyz[:, 2] > 0.01) & (xyz[:, 2] < KERB_M - 0.01)
    assert face.sum() > 200
    assert np.abs(np.abs(xyz[face, 1]) - 3.25).max() < 0.15


def test_nothing_is_seen_behind_the_house_below_its_shadow(exact: tuple[Seen, np.ndarray]) -> None:
    scan, xyz = exact
    house = xyz[scan[1] == 50]
    assert len(house) > 500
    assert house[:, 1].min() > 7.99
    bearing = np.arctan2(xyz[:, 1], xyz[:, 0])
    shadow = (xyz[:, 1] > 16.5) & (bearing > np.arctan2(9, 20)) & (bearing < np.arctan2(15, 10))
    assert not shadow.any()


def test_noise_is_as_configured(street_scene: Scene, exact_lidar: Lidar) -> None:
    pose = street_scene.T_map_lidar[MIDDLE]
    noisy = Lidar(replace(exact_lidar.config, range_noise_m=0.02))
    a = exact_lidar.scan(street_scene, pose, np.random.default_rng(0))
    b = noisy.scan(street_scene, pose, np.random.default_rng(0))
    assert len(a[0]) == len(b[0])
    ranges = [np.linalg.norm(s[0][:, :3], axis=1) for s in (a, b)]
    assert float(np.std(ranges[1] - ranges[0])) == pytest.approx(0.02, rel=0.05)


def test_returns_get_fewer_with_the_range(street_scene: Scene) -> None:
    pose = street_scene.T_map_lidar[MIDDLE]
    every = Lidar(LidarConfig(dropout=0, road_half_range_m=None)).scan(street_scene, pose, np.random.default_rng(0))
    some = Lidar(LidarConfig(dropout=0)).scan(street_scene, pose, np.random.default_rng(0))
    share = []
    for low, high in ((5, 15), (50, 70)):
        counts = []
        for scan in (some, every):
            r = np.hypot(scan[0][:, 0], scan[0][:, 1])
            counts.append(int(((r > low) & (r < high) & (scan[1] == 40)).sum()))
        share.append(counts[0] / counts[1])
    assert share[0] > 0.95
    assert 0.2 < share[1] < 0.8


def test_rings_are_those_of_an_hdl64() -> None:
    lidar = Lidar()
    assert len(lidar.elevations) == 64
    assert np.degrees(lidar.elevations[[0, 31, 63]]) == pytest.approx([2.0, -8.33, -24.9])
    assert (np.diff(lidar.elevations) < 0).all()
    assert np.degrees(lidar.azimuths[1] - lidar.azimuths[0]) == pytest.approx(0.173, abs=0.001)
