"""Roads in a raster and in buckets, against their plain twins."""

import numpy as np

from interloc.kernels.roads import bucket_segments, draw_roads, nearest_ways, score_poses

RNG = np.random.default_rng(5)
SEGMENTS = RNG.uniform(0.0, 200.0, (12, 4))
ORIGIN = np.array([-30.0, -30.0])


def from_segment(x: float, y: float, segment: np.ndarray) -> tuple[float, np.ndarray]:
    a, b = segment[:2], segment[2:]
    t = np.clip((np.array([x, y]) - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    foot = a + t * (b - a)
    return float(np.hypot(*(foot - [x, y]))), foot


def drawn() -> tuple[np.ndarray, np.ndarray]:
    distance, directions = np.full((130, 130), 255, np.uint8), np.zeros((130, 130), np.uint16)
    draw_roads(distance, directions, SEGMENTS, ORIGIN, 2.0, 20.0, 12.0)
    return distance, directions


def test_each_cell_holds_the_distance_and_the_directions_of_the_roads() -> None:
    distance, directions = drawn()
    for row, column in RNG.integers(0, 130, (200, 2)):
        x, y = ORIGIN + 2.0 * (np.array([column, row]) + 0.5)
        apart = np.array([from_segment(x, y, segment)[0] for segment in SEGMENTS])
        expected = 255 if apart.min() > 20.0 else int(apart.min() * 10.0)
        assert abs(int(distance[row, column]) - expected) <= 1
        sectors = set()
        for segment, away in zip(SEGMENTS, apart, strict=True):
            if away <= 12.0:
                angle = np.arctan2(segment[3] - segment[1], segment[2] - segment[0]) % np.pi
                middle = int(angle / np.pi * 16) % 16
                sectors |= {middle, (middle + 1) % 16, (middle + 15) % 16}
        assert {bit for bit in range(16) if directions[row, column] >> bit & 1} == sectors


def test_a_track_counts_where_roads_run_its_way() -> None:
    distance, directions = np.full((50, 50), 255, np.uint8), np.zeros((50, 50), np.uint16)
    draw_roads(distance, directions, np.array([[0.0, 50.0, 100.0, 50.0]]), np.zeros(2), 2.0, 20.0, 12.0)
    weight = np.where(np.arange(256) < 20, 1.0, 0.0)
    track = np.column_stack([np.arange(-20.0, 21.0, 5.0), np.zeros(9), np.zeros(9)])
    poses = np.array([[50.0, 50.0, 0.0], [50.0, 50.0, np.pi], [50.0, 90.0, 0.0], [50.0, 50.0, np.pi / 2]])
    score = score_poses(distance, directions, np.zeros(2), 2.0, track, poses, weight, 0.25, 0.0)
    assert np.allclose(score, [1.0, 1.0, 0.0, 0.25 / 9])
    given_up = score_poses(distance, directions, np.zeros(2), 2.0, np.tile(track, (4, 1)), poses, weight, 0.25, 0.9)
    assert np.allclose(given_up, [1.0, 1.0, -1.0, -1.0])


def test_the_nearest_way_that_runs_along_is_found() -> None:
    starts, items = bucket_segments(SEGMENTS, ORIGIN, 32.0, 9, 9, 25.0)
    points = np.column_stack([RNG.uniform(-25.0, 225.0, (100, 2)), RNG.uniform(-4.0, 4.0, 100)])
    found, foot = nearest_ways(points, SEGMENTS, ORIGIN, 32.0, starts, items, 25.0, 20.0)
    for (x, y, heading), segment, (fx, fy, dx, dy) in zip(points, found, foot, strict=True):
        costs = []
        for each in SEGMENTS:
            away, _ = from_segment(x, y, each)
            angle = np.arctan2(each[3] - each[1], each[2] - each[0])
            costs.append(away + 20.0 * np.sin(angle - heading) ** 2 if away <= 25.0 else np.inf)
        if np.isinf(min(costs)):
            assert segment == -1
            continue
        assert segment == int(np.argmin(costs))
        assert np.allclose([fx, fy], from_segment(x, y, SEGMENTS[segment])[1])
        assert dx * np.cos(heading) + dy * np.sin(heading) >= 0.0
