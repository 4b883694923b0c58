"""Position, uncertainty and branches of one intersection from a few sightings."""

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from interloc.arrays import FloatArray
from interloc.config import CalibrationConfig
from interloc.mapping import estimation
from interloc.mapping.branches import FusedBranches, SeenBranches, fuse_branches


def test_the_bulk_wins_over_the_outlier() -> None:
    xy = np.array([[0.0, 0.0], [0.2, 0.0], [-0.2, 0.0], [9.0, 0.0], [5.0, 5.0]])
    labels = np.array([0, 0, 0, 0, -1])
    (centre,) = estimation.robust_centres(xy, np.ones(5), labels, np.array([[1.0, 0.0]]), scale_m=2.0)
    assert_allclose(centre, [0, 0], atol=1e-3)


def test_sightings_of_one_window_count_as_about_one() -> None:
    """A hundred equal sightings within a metre say no more than one; a hundred far apart say a hundred."""

    def std(travelled_m: FloatArray) -> float:
        n = len(travelled_m)
        return float(
            estimation.position_std(
                estimation.summarize_sightings(
                    np.zeros((n, 2)), np.ones(n), np.zeros(n, dtype=np.int64), travelled_m, np.zeros((1, 2)),
                    score=np.ones(n), fix_std_m=np.full(n, np.nan), correlation_m=80.0, clip_m=4.0,
                ),
                prior_std_m=0.7,
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


CALIBRATION = CalibrationConfig(
    fix_std_m=0.3,
    line_std_m=0.5,
    unclear_line_std_m=10,
    coarse_line_std_m=5,
    shape_limit_m=100,
    log_odds=1,
    log_odds_seen=2,
    log_odds_per_doubling=3,
)


def covariance_of(
    bearings_deg: list[float], *, scatter_m2: float = 0.0, score: float = 1.0, usual_score: float = 1.0
) -> FloatArray:
    sightings = estimation.SightingStats(
        np.array([2.0]), np.array([scatter_m2]), np.array([score]), np.array([np.nan]), usual_score
    )
    covariance: FloatArray = estimation.shape_covariance(sightings, [np.array(bearings_deg)], CALIBRATION)[0]
    return covariance + estimation.scatter_variance(sightings) * np.eye(2)


def test_a_right_angle_is_uncertain_in_all_directions_alike_an_acute_one_along_its_bisector() -> None:
    """Two lines across each bearing: north and south fix the east, a single branch to the east fixes the north."""
    assert_allclose(covariance_of([0, 90, 180]), [[0.125, 0], [0, 0.25]], atol=1e-4)
    assert_allclose(covariance_of([0, 90, 180], scatter_m2=0.5), [[0.375, 0], [0, 0.5]], atol=1e-4)
    variance, axes = np.linalg.eigh(covariance_of([20, 40]))
    assert_allclose(
        variance, [0.5**2 / 2 / np.cos(np.radians(10)) ** 2, 0.5**2 / 2 / np.sin(np.radians(10)) ** 2], rtol=1e-3
    )
    assert_allclose(np.abs(axes[:, 1]), [np.sin(np.radians(30)), np.cos(np.radians(30))], atol=1e-6)
    unclear = covariance_of([0, 90, 180], score=0.9)
    assert_allclose(unclear, [[(0.25 + 1) / 2, 0], [0, 0.25 + 1]], atol=1e-3)
    among_unclear_ones = covariance_of([0, 90, 180], usual_score=0.8)
    assert_allclose(among_unclear_ones, [[(0.25 + 1) / 2, 0], [0, 0.25 + 1]], atol=1e-3)
    assert np.all(np.linalg.eigvalsh(covariance_of([])) < 1.001e4)  # no branch at all: the limit


def test_the_fix_is_as_uncertain_as_it_states_and_else_as_the_calibration_has_it() -> None:
    sightings = estimation.SightingStats(np.ones(2), np.zeros(2), np.ones(2), np.array([0.04, np.nan]), 1.0)
    assert_allclose(estimation.fix_variance(sightings, CALIBRATION), [0.04, 0.09])


def test_more_sightings_and_lines_that_meet_in_a_point_make_a_junction_more_probable() -> None:
    """The lines leave a variance of 1/8 m2; a scatter makes it 1, 1 and 4."""
    crossing, bearings = np.array([0.0, 90.0, 180.0, 270.0]), 3
    sightings = estimation.SightingStats(
        np.ones(3), np.array([0.875, 0.875, 3.875]), np.ones(3), np.full(3, np.nan), 1.0
    )
    probability = estimation.junction_probability(
        np.array([1.0, 0.5, 1.0]), sightings, [crossing] * bearings, CALIBRATION
    )
    assert_allclose(probability, 1 / (1 + np.exp([-3.0, -2.0, 0.0])), atol=1e-4)
    parallel = estimation.junction_probability(np.ones(3), sightings, [crossing[::2]] * bearings, CALIBRATION)
    assert np.all(parallel < 1e-3)


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
    assert bearings_of(*[[0, 24, 180, 204]] * 3) == pytest.approx([0, 24, 180, 204], abs=3)  # an acute crossing


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
