"""The branches that sightings of an intersection agree on, and their widths."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from interloc.arrays import FloatArray
from interloc.mapping.branches import FusedBranches, SeenBranches, fuse_branches

NAN = np.nan


def fused(
    bearings: Sequence[FloatArray], widths: Sequence[FloatArray] | None = None, place: Sequence[int] | None = None
) -> FusedBranches:
    """Fuse sightings that count the same, of one intersection unless said otherwise."""
    widths = [np.full(len(each), NAN) for each in bearings] if widths is None else widths
    of = np.zeros(len(bearings), dtype=np.int64) if place is None else np.array(place, dtype=np.int64)
    seen = SeenBranches.of(bearings, widths, of, np.ones(len(bearings)))
    return fuse_branches(seen, spread_deg=8, separation_deg=25, support=0.4)


def bearings_of(*sightings: list[float]) -> list[float]:
    (found,), _ = fused([np.array(each) for each in sightings]).lists()
    return [round(each, 1) for each in found.tolist()]


def test_branches_that_most_have_seen() -> None:
    assert bearings_of([0, 90, 180], [4, 88, 180], [356, 92, 180, 300]) == [0, 90, 180]
    assert bearings_of([10, 100, 190, 280], [10, 100, 190, 280], [10, 100, 190]) == [10, 100, 190, 280]


def test_three_branches_make_an_intersection_even_where_support_is_thin() -> None:
    assert bearings_of([0, 90], [0, 180], [0, 270], [0, 180])[:2] == [0, 90]
    assert bearings_of([], []) == []
    assert fused([]).lists() == [[], []]


@given(st.lists(st.floats(0, 360, exclude_max=True), min_size=1, max_size=4), st.integers(1, 6))
def test_sightings_that_agree_are_kept_as_they_are(branches: list[float], times: int) -> None:
    if any(abs((a - b + 180) % 360 - 180) < 50 for a, b in combinations(branches, 2)):
        return
    (found,), _ = fused([np.array(branches)] * times).lists()
    assert len(found) == len(branches)
    away = np.abs((found[:, None] - np.array(branches)[None] + 180) % 360 - 180)
    assert away.min(axis=1).max() < 1e-6


def test_the_width_of_a_branch_is_the_weighted_median_of_what_was_seen_of_it() -> None:
    bearings = [np.array([358.0, 91.0]), np.array([5.0, 88.0, 180.0]), np.array([1.0])]
    widths = [np.array([6.0, NAN]), np.array([7.0, 4.0, NAN]), np.array([12.0])]
    seen = SeenBranches.of(bearings, widths, np.zeros(3, dtype=np.int64), np.array([1.0, 1.5, 0.4]))
    _, (found,) = fuse_branches(seen, spread_deg=8, separation_deg=25, support=0.4).lists()
    assert_allclose(found, [7.0, 4.0, NAN])


def test_many_intersections_at_once_are_those_of_each_alone() -> None:
    rng = np.random.default_rng(5)
    place = np.repeat(np.arange(30), 6)
    true = [np.sort(rng.choice([0, 60, 120, 180, 240, 300], rng.integers(2, 5), replace=False)) for _ in range(30)]
    bearings = [(true[p][rng.random(len(true[p])) < 0.8] + rng.normal(0, 4)) % 360 for p in place.tolist()]
    widths = [np.where(rng.random(len(each)) < 0.8, rng.uniform(4, 9, len(each)), NAN) for each in bearings]
    many = fused(bearings, widths, place.tolist())
    for number, (angles, wide) in enumerate(zip(*many.lists(), strict=True)):
        rows = slice(6 * number, 6 * number + 6)
        alone = fused(bearings[rows], widths[rows])
        assert_array_equal(angles, alone.lists()[0][0])
        assert_array_equal(wide, alone.lists()[1][0])
    own = many.bearing_deg[np.repeat(place, [len(each) for each in bearings]), many.nearest]
    away = np.abs((np.concatenate(bearings) - own + 180) % 360 - 180)
    assert_allclose(away, many.apart_deg, atol=1e-9)
