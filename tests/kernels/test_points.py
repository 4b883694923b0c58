"""Selection of points by label: the kernel, and its plain twin, which opens drives."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from interloc.arrays import UInt8Array
from interloc.drives.scans.raw import select_plainly
from interloc.kernels.ground import select_points

both = pytest.mark.parametrize("select", [select_points, select_plainly])


def groups(first: set[int], second: set[int]) -> UInt8Array:
    table = np.zeros(65536, np.uint8)
    table[sorted(second)] = 2
    table[sorted(first)] = 1
    return table


@both
def test_first_bad_point_among_the_kept_is_reported(select: Callable) -> None:
    points = np.ones((4, 4), np.float32)
    points[0, 0] = np.nan  # not kept
    points[2, 1] = np.inf
    points[3, 2] = np.nan
    labels = np.array([70, 40, 48, 40], np.uint32)
    assert select(points, labels, groups({40}, {48}))[2] == 2


@both
def test_remission_may_be_anything(select: Callable) -> None:
    points = np.ones((1, 4), np.float32)
    points[0, 3] = np.nan
    assert select(points, np.array([40], np.uint32), groups({40}, set()))[2] == -1


@given(
    st.lists(st.integers(0, 2**32 - 1) | st.sampled_from([40, 48, 60, 65535]), max_size=50), st.integers(0, 2**32 - 1)
)
@settings(deadline=None)  # the first call compiles
def test_equals_the_plain_twin(ids: list[int], seed: int) -> None:
    labels = np.array(ids, np.uint32)
    points = np.random.default_rng(seed).normal(size=(len(ids), 4)).astype(np.float32)
    table = groups({40, 60, 65535}, {48})
    xyz, road, bad = select_points(points, labels, table)
    expected, *counts = select_plainly(points, labels, table)
    np.testing.assert_array_equal(xyz, expected)
    assert [road, bad] == counts
