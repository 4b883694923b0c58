"""Selection of points by label, against its plain twin."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import Float32Array, UInt8Array, UInt32Array
from interloc.kernels.ground import select_points


def groups(first: set[int], second: set[int]) -> UInt8Array:
    table = np.zeros(65536, np.uint8)
    table[sorted(second)] = 2
    table[sorted(first)] = 1
    return table


def plain_select(points: Float32Array, labels: UInt32Array, group_of: UInt8Array) -> tuple[Float32Array, int]:
    group = group_of[labels & 0xFFFF]
    first, second = points[group == 1, :3], points[group == 2, :3]
    return np.concatenate([first, second]), len(first)


def test_first_bad_point_among_the_kept_is_reported() -> None:
    points = np.ones((4, 4), np.float32)
    points[0, 0] = np.nan  # not kept
    points[2, 1] = np.inf
    points[3, 2] = np.nan
    labels = np.array([70, 40, 48, 40], np.uint32)
    assert select_points(points, labels, groups({40}, {48}))[2] == 2


def test_remission_may_be_anything() -> None:
    points = np.ones((1, 4), np.float32)
    points[0, 3] = np.nan
    assert select_points(points, np.array([40], np.uint32), groups({40}, set()))[2] == -1


@given(
    st.lists(st.integers(0, 2**32 - 1) | st.sampled_from([40, 48, 60, 65535]), max_size=50), st.integers(0, 2**32 - 1)
)
@settings(deadline=None)  # the first call compiles
def test_equals_the_plain_twin(ids: list[int], seed: int) -> None:
    labels = np.array(ids, np.uint32)
    points = np.random.default_rng(seed).normal(size=(len(ids), 4)).astype(np.float32)
    table = groups({40, 60, 65535}, {48})
    xyz, road, bad = select_points(points, labels, table)
    expected, expected_road = plain_select(points, labels, table)
    np.testing.assert_array_equal(xyz, expected)
    assert (road, bad) == (expected_road, -1)
