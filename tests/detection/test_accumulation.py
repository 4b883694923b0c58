"""Adding and taking back keyframes against concatenating the scans of each window anew."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import BoolArray, Float32Array
from interloc.config import BevConfig, KeyframeConfig
from interloc.detection.accumulation import BevImage, RoadAccumulator, roi_around
from interloc.detection.image import Roi
from interloc.detection.keyframes import Keyframe
from interloc.errors import DriveError
from interloc.geometry import rotation_from_rpy
from tests.small_drives import level_poses

Scans = list[tuple[Keyframe, Float32Array]]

BEV = BevConfig(size_m=40, resolution_m=0.5, min_points=3, adaptive=False, max_range_m=30)


def random_walk(seed: int, count: int, step_m: float) -> Scans:
    """Return keyframes that turn, tilt and now and then jump back to where one has been before."""
    generator = np.random.default_rng(seed)
    scans: Scans = []
    position, yaw = np.zeros(3), 0.0
    for frame in range(count):
        tilt = generator.normal(0, 0.02)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation_from_rpy(0.0, tilt, yaw), position
        points = generator.uniform(-35, 35, (generator.integers(0, 3000), 3)).astype(np.float32)
        points[:, 2] = -1.7
        scans.append((Keyframe(frame, T, None), points))
        position = position + step_m * np.array([np.cos(yaw), np.sin(yaw), 0.01])
        yaw += generator.normal(0, 0.5)
        if generator.random() < 0.1:
            position = scans[generator.integers(len(scans))][0].T_world_lidar[:3, 3]
    return scans


def literal_bev(scans: Scans, k: int, before: int, after: int, bev: BevConfig, min_points: int) -> BoolArray:
    """Concatenate the scans k - before .. k + after in W and count the points of each cell of the window."""
    world = []
    for keyframe, points in scans[max(0, k - before) : k + after + 1]:
        near = points[(np.abs(points[:, :2]) <= bev.max_range_m).all(axis=1)].astype(np.float64)
        world.append(near @ keyframe.T_world_lidar[:3, :3].T + keyframe.T_world_lidar[:3, 3])
    x, y = np.concatenate(world)[:, :2].T
    centre = np.floor(scans[k][0].T_world_lidar[:2, 3] / bev.resolution_m)
    edges = [(c - bev.cells // 2 + np.arange(bev.cells + 1)) * bev.resolution_m for c in centre]
    counts = np.histogram2d(y, x, [edges[1], edges[0]])[0]
    return counts[::-1] >= min_points  # rows go down


def bev_of_one_scan(config: BevConfig, road: Float32Array, other: Float32Array | None = None) -> BevImage:
    accumulator = RoadAccumulator(KeyframeConfig(window=0, lookahead=0), config)
    accumulator.add(Keyframe(0, np.eye(4), None), road, other)
    return accumulator.bev()


def run(accumulator: RoadAccumulator, scans: Scans) -> Iterator[tuple[Keyframe, BevImage]]:
    for keyframe, points in scans:
        completed = accumulator.add(keyframe, points)
        if completed is not None:
            yield completed, accumulator.bev()
    while (completed := accumulator.finish()) is not None:
        yield completed, accumulator.bev()


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 6),
    st.none() | st.integers(0, 8),
    st.integers(1, 40),
    st.sampled_from([2.0, 5.0, 25.0]),
)
@settings(deadline=None, max_examples=15)
def test_every_image_of_any_walk_is_that_of_the_concatenated_scans(
    seed: int, window: int, lookahead: int | None, count: int, step_m: float
) -> None:
    scans = random_walk(seed, count, step_m)
    config = KeyframeConfig(window=window, lookahead=lookahead)
    for k, (_, bev_image) in enumerate(run(RoadAccumulator(config, BEV), scans)):
        if sum(len(points) for _, points in scans[max(0, k - window) : k + config.after + 1]):
            np.testing.assert_array_equal(
                bev_image.image.to_array(), literal_bev(scans, k, window, config.after, BEV, 3)
            )


def test_nothing_added_nothing_completes() -> None:
    assert RoadAccumulator(KeyframeConfig(), BEV).finish() is None


def test_window_lies_around_the_keyframe_on_whole_cells() -> None:
    roi = roi_around(Keyframe(0, level_poses(-7.3, 100.9), None), BEV)
    assert (roi.left, roi.top, roi.size) == (-15 - 40, 201 + 39, 80)
    lower_left = roi.world(np.array(79.0), np.array(0.0)) - 0.25
    assert lower_left.tolist() == [-27.5, 80.5]


def straight(count: int, step_m: float) -> Scans:
    generator = np.random.default_rng(0)
    scans: Scans = []
    for frame, T in enumerate(level_poses(step_m * np.arange(count))):
        scans.append((Keyframe(frame, T, None), generator.uniform(-29, 29, (500, 3)).astype(np.float32)))
    return scans


def test_memory_does_not_grow_with_the_drive() -> None:
    accumulator = RoadAccumulator(KeyframeConfig(window=5), BEV)
    sizes = [accumulator.tiles for _ in run(accumulator, straight(400, 25.0))]  # 10 km
    assert max(sizes) == sizes[10]


@pytest.mark.parametrize(
    ("step_m", "expected"),
    [
        (1.0, 5),  # a full window lies in the region: m as it is
        (8.0, 3),  # 5 of 9 keyframes, 20 m to both sides
        (12.0, 2),  # 3 of 9
        (25.0, 1),  # 1 of 9, and never less than one point
    ],
)
def test_sparse_keyframes_need_fewer_points_per_cell(step_m: float, expected: int) -> None:
    bev = BevConfig(size_m=40, resolution_m=0.5, min_points=5, adaptive=True, max_range_m=30)
    scans = straight(9, step_m)
    accumulator = RoadAccumulator(KeyframeConfig(window=4), bev)
    for k, (_, bev_image) in enumerate(run(accumulator, scans)):
        if k == 4:
            np.testing.assert_array_equal(bev_image.image.to_array(), literal_bev(scans, k, 4, 4, bev, expected))


def test_start_of_a_drive_needs_fewer_points_per_cell() -> None:
    bev = BevConfig(size_m=40, resolution_m=0.5, min_points=5, adaptive=True, max_range_m=30)
    scans = straight(9, 1.0)
    first = next(run(RoadAccumulator(KeyframeConfig(window=4, lookahead=0), bev), scans))
    np.testing.assert_array_equal(first[1].image.to_array(), literal_bev(scans, 0, 4, 0, bev, 1))


def test_points_of_other_ground_take_road_points_back() -> None:
    bev = BevConfig(size_m=20, resolution_m=0.2, min_points=2, adaptive=False)
    here, there = [0.1, 0.1, -1.7], [3.1, 0.1, -1.7]
    road = np.array([here] * 3 + [there] * 3, np.float32)
    other = np.array([there] * 2 + [[9.1, 9.1, -1.7]], np.float32)
    bev_image = bev_of_one_scan(bev, road, other)
    rows, cols = bev_image.image.pixels()
    np.testing.assert_allclose(bev_image.roi.world(rows, cols), [[0.1, 0.1]])


def test_votes_against_road_leave_with_their_keyframe() -> None:
    bev = BevConfig(size_m=20, resolution_m=0.2, min_points=1, adaptive=False)
    accumulator = RoadAccumulator(KeyframeConfig(window=0, lookahead=0), bev)
    point = np.array([[0.1, 0.1, -1.7]], np.float32)
    accumulator.add(Keyframe(0, np.eye(4), None), point, np.repeat(point, 5, axis=0))
    accumulator.add(Keyframe(1, np.eye(4), None), point)
    assert accumulator.bev().image.pixels()[0].size == 1


def test_other_ground_is_known_where_it_outvotes_road() -> None:
    bev = BevConfig(size_m=20, resolution_m=0.2, min_points=2, adaptive=False, vote=True)
    road_points = np.array([[0.1, 0.1, -1.7]] * 3 + [[3.1, 0.1, -1.7]] * 3, np.float32)
    other_points = np.array([[3.1, 0.1, -1.7]] * 3 + [[9.1, 9.1, -1.7]], np.float32)
    against = bev_of_one_scan(bev, road_points, other_points).against
    rows, cols = against.pixels()
    np.testing.assert_allclose(bev_of_one_scan(bev, road_points).roi.world(rows, cols), [[9.1, 9.1]])


def test_nothing_is_known_of_other_ground_where_nobody_votes() -> None:
    bev = BevConfig(size_m=20, resolution_m=0.2, min_points=1, adaptive=False, vote=True)
    point = np.array([[0.1, 0.1, -1.7]], np.float32)
    assert bev_of_one_scan(bev, point).against is None
    assert bev_of_one_scan(bev.model_copy(update={"vote": False}), point, point + 1).against is None


@pytest.mark.parametrize(
    ("step_m", "beside", "kept"),
    [(1.0, 1, 13), (25.0, 1, 1), (25.0, 58, 13)],
    ids=["dense", "sparse", "sparse, few errors"],
)
def test_lone_votes_do_not_count_where_keyframes_are_sparse_and_labels_err(
    step_m: float, beside: int, kept: int
) -> None:
    bev = BevConfig(size_m=40, resolution_m=0.5, min_points=1, vote=True)
    accumulator = RoadAccumulator(KeyframeConfig(window=4), bev)
    lone = np.array([[9.25, 0.25 + 0.5 * k, -1.7] for k in range(12)], np.float32)
    road = np.vstack([lone, lone, np.float32([[12.25, 0.25, -1.7]])])
    other = np.vstack([lone + np.float32([0.5 * k, 0, 0]) for k in range(-beside, 2) if k != 0])
    nothing = np.zeros((0, 3), np.float32)
    for k, (keyframe, _) in enumerate(straight(9, step_m)):
        accumulator.add(keyframe, road if k == 4 else nothing, other if k == 4 else nothing)
    assert accumulator.bev().image.pixels()[0].size == kept


def test_what_a_keyframe_needs_is_told_ahead_and_may_be_refused() -> None:
    scans = random_walk(3, 12, 2.0)
    config = KeyframeConfig(window=2, lookahead=0)
    told: list[int] = []

    def room(size: int) -> None:
        told.append(size)
        if len(told) % 3 == 0:
            raise DriveError("full")

    strict, free = RoadAccumulator(config, BEV, room), RoadAccumulator(config, BEV)
    for number, (keyframe, points) in enumerate(scans, start=1):
        if number % 3 == 0:
            with pytest.raises(DriveError, match="full"):
                strict.add(keyframe, points, points[::2])
            continue
        strict.add(keyframe, points, points[::2])
        free.add(keyframe, points, points[::2])
        assert strict.tiles * 256**2 * 4 < told[-1] < strict.tiles * 256**2 * 8 + 4 * 3 * 4500
    np.testing.assert_array_equal(strict.bev().image.to_array(), free.bev().image.to_array())


def test_columns_go_with_x_and_rows_against_y() -> None:
    roi = Roi(left=-10, top=9, size=20, resolution_m=0.5)
    corners = roi.world(np.array([0.0, 0.0, 19.0]), np.array([0.0, 19.0, 0.0]))
    assert corners.tolist() == [[-4.75, 4.75], [4.75, 4.75], [-4.75, -4.75]]


@pytest.mark.parametrize("turn_rad", [0.0, 0.7])
def test_image_undoes_world(turn_rad: float) -> None:
    roi = Roi(left=-4321, top=77, size=750, resolution_m=0.16, turn_rad=turn_rad)
    positions = np.random.default_rng(2).uniform(0, 749, (50, 2))
    np.testing.assert_allclose(roi.image(roi.world(positions[:, 0], positions[:, 1])), positions, atol=1e-9)
