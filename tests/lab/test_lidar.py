"""What one turn of the LiDAR must show of a flat street with one house."""

from dataclasses import replace

import numpy as np
import pytest

from interloc.lab.config import LidarConfig
from interloc.lab.drive import Lidar
from interloc.lab.ground import KERB_M, MATERIAL_TABLE
from interloc.lab.raycast import cast_rays, height_at, surface_at
from interloc.lab.scene import Scene

Seen = tuple[np.ndarray, np.ndarray]
EXACT_LIDAR = Lidar(LidarConfig(columns=720, range_noise_m=0, surface_noise=0, dropout=0, road_half_range_m=None))
MIDDLE = 30  # the pose of the track nearest to x = 0


def about_the_vehicle(scan: Seen, pose: np.ndarray) -> np.ndarray:
    """Points in the axes of the map; the origin on the ground under the sensor."""
    shift = pose[:3, 3] * [0, 0, 1]
    return scan[0][:, :3].astype(float) @ pose[:3, :3].T + shift


@pytest.fixture(scope="module")
def exact(street_scene: Scene) -> tuple[Seen, np.ndarray]:
    pose = street_scene.T_map_lidar[MIDDLE]
    scan = EXACT_LIDAR.scan(street_scene, pose, np.random.default_rng(0))
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


def test_noise_is_as_configured(street_scene: Scene) -> None:
    pose = street_scene.T_map_lidar[MIDDLE]
    noisy = Lidar(replace(EXACT_LIDAR.config, range_noise_m=0.02))
    a = EXACT_LIDAR.scan(street_scene, pose, np.random.default_rng(0))
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


LIMITS = np.array([0.5, 100.0, 0.0, 0.0, 0.0, -np.inf])


def plain_range(origin: np.ndarray, direction: np.ndarray, walls: np.ndarray) -> float:
    """Range to the plane z = 0 or the nearest upright wall; infinite if none."""
    best = -origin[2] / direction[2] if direction[2] < 0 else np.inf
    for x1, y1, x2, y2, bottom, top in walls:
        matrix = np.array([[direction[0], x1 - x2], [direction[1], y1 - y2]])
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        t, along = np.linalg.solve(matrix, np.array([x1, y1]) - origin[:2])
        if t > 0 and 0 <= along <= 1 and bottom <= origin[2] + t * direction[2] <= top:
            best = min(best, t)
    return best


def test_ranges_equal_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(3)
    start = rng.uniform(-40, 40, (25, 2))
    walls = np.hstack(
        [start, start + rng.uniform(-15, 15, (25, 2)), rng.uniform(0, 1, (25, 1)), rng.uniform(1, 6, (25, 1))]
    )
    origin = np.array([0.3, -0.2, 1.7])
    elevations = np.radians([2.0, -1.0, -5.0, -20.0])
    azimuths = np.linspace(0, 2 * np.pi, 90, endpoint=False) + 0.01
    shape = (len(elevations), len(azimuths))
    points, _, hit = cast_rays(
        origin,
        np.eye(3),
        elevations,
        azimuths,
        np.full((1, 4, 4), 1, np.uint8),
        np.zeros((1, 1), np.int32),
        np.array([-200.0, -200.0, 400.0]),
        np.zeros((2, 2), np.float32),
        np.array([0.0, 0.0, 1.0]),
        walls,
        np.full(25, 6, np.uint8),
        MATERIAL_TABLE,
        LIMITS,
        np.zeros((2, *shape), np.float32),
        np.zeros(shape, np.float32),
    )
    ranges = np.linalg.norm(points[..., :3], axis=-1)
    for i, e in enumerate(elevations):
        for j, a in enumerate(azimuths):
            direction = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
            expected = plain_range(origin, direction, walls)
            assert bool(hit[i, j]) == (expected <= 100.0)
            if hit[i, j]:
                assert abs(ranges[i, j] - expected) < 1e-3


def test_heights_are_interpolated() -> None:
    grid = np.array([[0, 1], [2, 3]], np.float32)
    assert abs(height_at(grid, 10.0, 20.0, 2.0, 11.0, 21.0) - 1.5) < 1e-6
    assert height_at(grid, 10.0, 20.0, 2.0, 0.0, 0.0) == 0.0


def test_ground_outside_the_tiles_is_terrain() -> None:
    tiles = np.array([[[3, 4], [5, 1]]], np.uint8)
    index = np.array([[-1, 0]], np.int32)
    found = [
        surface_at(tiles, index, 0.0, 0.0, 10.0, x, y) for x, y in ((11, 1), (19, 1), (11, 9), (5, 5), (-1, 0), (25, 5))
    ]
    assert found == [3, 4, 5, 0, 0, 0]
