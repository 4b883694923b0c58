"""Range images, against their plain twins and by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from interloc.arrays import Float32Array, Int32Array
from interloc.kernels.projection import best_classes, fill_image, normalise_image, project_points

HEIGHT, WIDTH = 16, 128
UP, DOWN = math.radians(3.0), math.radians(25.0)


def scan(*rows: tuple[float, float, float]) -> Float32Array:
    return np.array([[*row, 0.5] for row in rows], np.float32).reshape(-1, 4)


def project(points: Float32Array) -> tuple[Int32Array, Int32Array, Float32Array]:
    return project_points(points, HEIGHT, WIDTH, UP, DOWN)


def pixels(points: Float32Array) -> list[tuple[int, int]]:
    """Return (row, column) of every point."""
    return [divmod(int(at), WIDTH) for at in project(points)[1]]


def plain_pixel(x: float, y: float, z: float) -> tuple[int, int]:
    """The formula as published, in double precision."""
    depth = math.sqrt(x * x + y * y + z * z)
    yaw, pitch = -math.atan2(y, x), math.asin(z / depth)
    column = math.floor(0.5 * (yaw / math.pi + 1.0) * WIDTH)
    row = math.floor((1.0 - (pitch + DOWN) / (UP + DOWN)) * HEIGHT)
    return min(max(row, 0), HEIGHT - 1), min(max(column, 0), WIDTH - 1)


def plain_project(points: Float32Array) -> tuple[Int32Array, list[tuple[int, int] | None]]:
    """Every pixel takes the nearest of its points, the first of equally near ones."""
    found: list[tuple[int, int] | None] = []
    members: dict[tuple[int, int], list[tuple[np.float32, int]]] = {}
    for i, (x, y, z) in enumerate(points[:, :3].astype(float)):
        depth = np.float32(math.sqrt(x * x + y * y + z * z))
        if not np.isfinite(depth) or depth == 0:
            found.append(None)
            continue
        found.append(plain_pixel(x, y, z))
        members.setdefault(plain_pixel(x, y, z), []).append((depth, i))
    index = np.full((HEIGHT, WIDTH), -1, np.int32)
    for place, each in members.items():
        index[place] = min(each)[1]
    return index, found


def random_scan(seed: int, count: int) -> Float32Array:
    """Points all around, also outside of the field of view, many in the same pixels, some at equal depths."""
    generator = np.random.default_rng(seed)
    points = generator.normal(size=(count, 4)).astype(np.float32) * np.array([20, 20, 4, 1], np.float32)
    points[count // 2 :: 3] *= 0.5  # the same directions and others
    points[1::7, :3] = points[0:-1:7, :3][: len(points[1::7])] * 2
    points[2::7, :3] = points[0:-2:7, :3][: len(points[2::7])]
    points[3::11, 2] = np.nan
    points[4::11, :3] = 0
    points[5::11, 0] = np.inf
    return points


@given(st.integers(0, 2**32 - 1), st.integers(0, 200))
def test_equals_the_plain_twin(seed: int, count: int) -> None:
    points = random_scan(seed, count)
    index, pixel, depth = project(points)
    expected, places = plain_project(points)
    np.testing.assert_array_equal(index, expected)
    assert [None if at < 0 else divmod(int(at), WIDTH) for at in pixel] == places
    with np.errstate(invalid="ignore"):
        lengths = np.linalg.norm(points[:, :3].astype(float), axis=1)
    kept = pixel >= 0
    np.testing.assert_allclose(depth[kept], lengths[kept], rtol=1e-6)
    assert (depth[~kept] == -1).all()


def test_left_is_left_up_is_up_and_the_edges_are_behind_the_vehicle() -> None:
    (_, ahead), (_, left), (_, right) = pixels(scan((10, 0, 0), (0, 10, 0), (0, -10, 0)))
    assert (left, ahead, right) == (WIDTH // 4, WIDTH // 2, 3 * WIDTH // 4)
    above, level, below = (row for row, _ in pixels(scan((10, 0, 0.3), (10, 0, -1), (10, 0, -3))))
    assert above < level < below
    columns = [column for _, column in pixels(scan((-10, 0.01, 0), (-10, -0.01, 0), (-10, 0.0, 0), (-10, -0.0, 0)))]
    assert columns == [0, WIDTH - 1, 0, WIDTH - 1]


@pytest.mark.parametrize("bad", [(np.nan, 1, 1), (1, np.inf, 1), (1, 1, -np.inf), (0, 0, 0), (3e38, 3e38, 0)])
def test_points_that_are_nowhere_get_no_pixel(bad: tuple[float, float, float]) -> None:
    index, pixel, depth = project(scan((5, 0, 0), bad))
    assert pixel[1] == -1
    assert depth[1] == -1
    assert np.count_nonzero(index >= 0) == 1


@given(st.integers(0, 2**32 - 1))
def test_image_and_its_normalisation_equal_the_plain_twins(seed: int) -> None:
    points = random_scan(seed, 150)
    points[::13, 3] = np.nan
    index, _, depth = project(points)
    seen = index >= 0
    measured = np.column_stack([depth, points[:, :3], np.nan_to_num(points[:, 3])])
    plain = np.where(seen, measured[index].transpose(2, 0, 1), np.float32(-1))
    np.testing.assert_array_equal(fill_image(points, index, depth), plain)
    means, stds = np.arange(5, dtype=np.float32), np.arange(1, 6, dtype=np.float32)
    normal = np.where(seen, (plain - means[:, None, None]) / stds[:, None, None], np.float32(0))
    order = np.array([3, 1, 0, 4, 2], np.int32)
    np.testing.assert_array_equal(normalise_image(plain, index, order, means[order], stds[order]), normal[order])


@given(st.integers(0, 2**32 - 1))
def test_best_class_is_the_first_of_the_highest_scores(seed: int) -> None:
    scores = np.random.default_rng(seed).integers(0, 4, (20, 60)).astype(np.float32)
    classes, bad = best_classes(scores)
    np.testing.assert_array_equal(classes, scores.argmax(axis=0))
    assert bad == 0


def test_scores_that_are_no_numbers_are_counted() -> None:
    scores = np.zeros((3, 4), np.float32)
    scores[1, 2] = np.nan
    scores[:, 0] = -np.inf
    assert best_classes(scores)[1] == 2
