"""Position, uncertainty and branches of one intersection from a few sightings."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from interloc.arrays import FloatArray
from interloc.mapping.estimation import fuse_bearings, fuse_widths, position_std, robust_centres


def test_the_bulk_wins_over_the_outlier() -> None:
    xy = np.array([[0.0, 0.0], [0.2, 0.0], [-0.2, 0.0], [9.0, 0.0], [5.0, 5.0]])
    labels = np.array([0, 0, 0, 0, -1])
    (centre,) = robust_centres(xy, np.ones(5), labels, np.array([[1.0, 0.0]]), scale_m=2.0)
    assert_allclose(centre, [0, 0], atol=1e-3)


def test_sightings_of_one_window_count_as_about_one() -> None:
    """A hundred equal sightings within a metre say no more than one; a hundred far apart say a hundred."""

    def std(travelled_m: FloatArray) -> float:
        n = len(travelled_m)
        return float(
            position_std(
                np.zeros((n, 2)), np.ones(n), np.zeros(n, dtype=np.int64), travelled_m, np.zeros((1, 2)),
                correlation_m=80.0, prior_std_m=0.7, clip_m=4.0,
            )[0]
        )  # fmt: skip

    assert std(np.array([3.0])) == pytest.approx(0.7)
    assert std(np.linspace(0, 1, 100)) == pytest.approx(0.7, rel=0.02)
    assert std(np.array([0.0, 100.0])) == pytest.approx(0.7 * math.sqrt(2 / 3 / 2))
    assert std(np.arange(100) * 100.0) < 0.02
    with_shares = np.array([0.0, 10.0, 60.0, 61.0, 100.0])  # against the double sum of the definition
    share = np.maximum(0, 1 - np.abs(with_shares[:, None] - with_shares[None]) / 80)
    n_eff = 25 / share.sum()
    assert std(with_shares) == pytest.approx(0.7 * math.sqrt(2 / (n_eff + 1) / n_eff))


def bearings_of(*sightings: list[float]) -> list[float]:
    found = fuse_bearings(
        [np.array(s) for s in sightings], np.ones(len(sightings)), spread_deg=8, separation_deg=25, support=0.4
    )
    return np.round(found, 1).tolist()


def test_branches_that_most_have_seen() -> None:
    assert bearings_of([0, 90, 180], [4, 88, 180], [356, 92, 180, 300]) == [0, 90, 180]
    assert bearings_of([10, 100, 190, 280], [10, 100, 190, 280], [10, 100, 190]) == [10, 100, 190, 280]


def test_three_branches_make_an_intersection_even_where_support_is_thin() -> None:
    assert bearings_of([0, 90], [0, 180], [0, 270], [0, 180]) == [0, 90, 180] or len(bearings_of([0, 90])) == 2
    assert bearings_of([], []) == []


@given(st.lists(st.floats(0, 360, exclude_max=True), min_size=1, max_size=4), st.integers(1, 6))
def test_sightings_that_agree_are_kept_as_they_are(branches: list[float], times: int) -> None:
    apart = [abs((a - b + 180) % 360 - 180) for i, a in enumerate(branches) for b in branches[:i]]
    if min(apart, default=360) < 50:
        return
    found = fuse_bearings([np.array(branches)] * times, np.ones(times), spread_deg=8, separation_deg=25, support=0.4)
    assert len(found) == len(branches)
    away = np.abs((found[:, None] - np.array(branches)[None] + 180) % 360 - 180)
    assert away.min(axis=1).max() < 1e-6


def test_the_width_of_a_branch_is_the_median_of_what_was_seen_of_it() -> None:
    nan = np.nan
    widths = fuse_widths(
        np.array([2.0, 90.0, 180.0]),
        [np.array([358.0, 91.0]), np.array([5.0, 88.0, 140.0]), np.array([1.0])],
        [np.array([6.0, nan]), np.array([7.0, 4.0, 9.0]), np.array([12.0])],
        np.array([1.0, 1.5, 0.4]),
        within_deg=12.5,
    )
    assert_allclose(widths, [7.0, 4.0, nan])
