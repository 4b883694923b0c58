"""The vote of neighbours, against a plain twin."""

import math
from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from interloc.arrays import Float32Array, Int32Array, UInt8Array
from interloc.kernels.neighbours import spread_extremes, vote_of_neighbours
from interloc.kernels.projection import project_points
from interloc.labelling.rangenet.labeller import Projection, by_pixel, vote, window_weights
from interloc.labelling.rangenet.model import KnnSettings

HEIGHT, WIDTH = 8, 24
UP, DOWN = math.radians(3.0), math.radians(25.0)
CAR, ROAD, WALL = 1, 9, 13


def plain_vote(
    classes: UInt8Array, index: Int32Array, pixel: Int32Array, depth: Float32Array, settings: KnnSettings
) -> list[int]:
    """Loop over points and windows."""
    height, width = index.shape
    weights = window_weights(settings.search, settings.sigma)
    reach = settings.search // 2
    found = []
    for at, own_depth in zip(pixel, depth, strict=True):
        if at < 0:
            found.append(0)
            continue
        row, column = divmod(int(at), width)
        candidates = []
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                weight = weights[dy + reach, dx + reach]
                y, x, own = row + dy, (column + dx) % width, dy == dx == 0
                if own or (0 <= y < height and index[y, x] >= 0):
                    their_depth = own_depth if own else depth[index[y, x]]
                    distance = np.float32(abs(their_depth - own_depth)) * weight
                    candidates.append((float(distance), not own, dy, dx, int(classes[y, x])))
        nearest = sorted(candidates)[: settings.neighbours]
        if settings.cutoff > 0:
            nearest = [each for each in nearest if each[0] <= np.float32(settings.cutoff)]
        votes = Counter(each[-1] for each in nearest if each[-1] >= 1)
        winner = min(votes, key=lambda class_: (-votes[class_], class_), default=classes[row, column])
        found.append(int(winner))
    return found


def random_scene(seed: int, kinds: int = 4) -> tuple[UInt8Array, Int32Array, Int32Array, Float32Array]:
    """Some 150 points on walls at a few distances, so that many are equally near, and classes of the pixels."""
    generator = np.random.default_rng(seed)
    azimuth, pitch = generator.uniform(-np.pi, np.pi, 200), generator.uniform(-0.5, 0.1, 200)
    distance = generator.choice([2.0, 5.0, 5.25, 6.0, 20.0], 200)
    xyz = np.column_stack([np.cos(azimuth) * np.cos(pitch), np.sin(azimuth) * np.cos(pitch), np.sin(pitch)])
    points = np.column_stack([xyz * distance[:, None], np.zeros(200)]).astype(np.float32)
    points[::19] = np.nan
    classes = generator.integers(0, kinds, (HEIGHT, WIDTH)).astype(np.uint8)
    return classes, *project_points(points, HEIGHT, WIDTH, UP, DOWN)


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 3, 5, 7]),
    st.integers(1, 9),
    st.sampled_from([0.0, 0.25, 1.0]),
    st.sampled_from([0.5, 1.0, 3.0]),
    st.sampled_from([1, 2, 4]),
)
def test_equals_the_plain_twin(seed: int, search: int, knn: int, cutoff: float, sigma: float, kinds: int) -> None:
    scene = random_scene(seed, kinds)
    settings = KnnSettings(min(knn, search * search), search, sigma, cutoff)
    found = vote(scene[0], Projection(*scene[1:]), settings)
    assert found.tolist() == plain_vote(*scene, settings)


def scene_of(ranges: list[list[float]], classes: list[list[int]]) -> tuple[UInt8Array, Projection]:
    """One point per pixel; no point where the range is 0."""
    depth = np.array(ranges, np.float32)
    pixel = np.flatnonzero(depth.ravel()).astype(np.int32)
    index = np.full(depth.size, -1, np.int32)
    index[pixel] = np.arange(len(pixel))
    return np.array(classes, np.uint8), Projection(index.reshape(depth.shape), pixel, depth.ravel()[pixel])


def with_point(projection: Projection, pixel: int, depth_m: float) -> Projection:
    return Projection(
        projection.index, np.append(projection.pixel, np.int32(pixel)), np.append(projection.depth, np.float32(depth_m))
    )


def test_wall_behind_a_pole_is_wall() -> None:
    ranges = [[20.0] * 9 for _ in range(5)]
    classes = [[WALL] * 9 for _ in range(5)]
    for row in range(5):
        ranges[row][4], classes[row][4] = 5.0, 18
    image, projection = scene_of(ranges, classes)
    projection = with_point(projection, 2 * 9 + 4, 20.0)
    found = vote(image, projection, KnnSettings())
    assert found[-1] == WALL
    assert by_pixel(image, projection)[-1] == 18
    np.testing.assert_array_equal(found[:-1], image.ravel())  # nobody else changes


def test_neighbours_are_found_across_the_seam() -> None:
    ranges = [[0.0] * 24 for _ in range(3)]
    classes = [[0] * 24 for _ in range(3)]
    for row in range(3):
        for column in (22, 23):
            ranges[row][column], classes[row][column] = 10.0, ROAD
    ranges[1][0], classes[1][0] = 10.0, CAR  # one wrong pixel, on the seam
    image, projection = scene_of(ranges, classes)
    where = projection.pixel.tolist().index(24)
    assert vote(image, projection, KnnSettings(7, 3, 1.0, 1.0))[where] == ROAD


def test_class_0_votes_where_it_is_a_class() -> None:
    image, projection = scene_of([[10, 10, 10, 0, 0]], [[0, CAR, 0, 0, 0]])
    settings = KnnSettings(3, 3, 1.0, 1.0)
    assert vote(image, projection, settings)[1] == CAR
    assert vote(image, projection, settings, first_class=0)[1] == 0


def test_points_without_a_pixel_get_class_0() -> None:
    image, projection = scene_of([[10, 10, 10]], [[ROAD] * 3])
    projection = with_point(projection, -1, -1.0)
    assert vote(image, projection, KnnSettings(3, 3, 1.0, 1.0)).tolist() == [ROAD] * 3 + [0]
    assert by_pixel(image, projection).tolist() == [ROAD] * 3 + [0]


def test_window_weights_are_those_published() -> None:
    weights = window_weights(3, 1.0)
    bell = [[math.exp(-(x * x + y * y) / 2) for x in (-1, 0, 1)] for y in (-1, 0, 1)]
    np.testing.assert_allclose(weights, 1 - np.array(bell) / np.sum(bell), atol=1e-7)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 7]))
def test_extremes_of_windows_equal_the_plain_twin(seed: int, side: int) -> None:
    classes, index, *_ = random_scene(seed)
    lowest, highest = spread_extremes(classes, index, side)
    reach = side // 2
    for row in range(HEIGHT):
        for column in range(WIDTH):
            window = [
                int(classes[y, x % WIDTH])
                for y in range(max(row - reach, 0), min(row + reach + 1, HEIGHT))
                for x in range(column - reach, column + reach + 1)
                if index[y, x % WIDTH] >= 0
            ]
            assert lowest[row, column] == min(window, default=255)
            assert highest[row, column] == max(window, default=0)


def test_window_as_wide_as_the_image() -> None:
    image, projection = scene_of([[10, 10, 10]], [[ROAD, ROAD, CAR]])
    weights = window_weights(3, 1.0)
    found = vote_of_neighbours(image, projection.index, projection.pixel, projection.depth, weights, 3, 1.0, 1)
    assert found.tolist() == [ROAD] * 3
