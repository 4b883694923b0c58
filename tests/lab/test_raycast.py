"""The compiled ray caster against a plain loop over all walls."""

import numpy as np

from interloc.lab.ground import MATERIAL_TABLE
from interloc.lab.raycast import cast_rays, height_at, surface_at

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
