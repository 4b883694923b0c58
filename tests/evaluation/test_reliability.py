"""Uncertainty and confidence against the truth, from literal arrays."""

import numpy as np
import pytest

from interloc.evaluation.map_level import (
    BOUND_95,
    MapLevel,
    bins_of,
    calibration_error,
    calibration_error_by_chance,
    map_std_m,
    share_within,
    squared_errors,
    squared_per_dimension,
    with_interval,
)
from interloc.geometry import lonlat_from_enu
from interloc.results import IntersectionTable


def test_an_error_counts_in_units_of_its_own_covariance() -> None:
    """An ellipse of 2 m to the east and 1 m to the north, a circle of 0.5 m, and an intersection without a node."""
    lonlat = lonlat_from_enu(49.0, 8.4, np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]]))
    nodes = lonlat_from_enu(49.0, 8.4, np.array([[100.0, 1.0], [2.0, 1.0]]))
    ids = np.arange(1, 4)
    zero = np.zeros((3, 2))
    covariance = np.array([[4.0, 0.0, 1.0], [0.25, 0.0, 0.25], [1.0, 0.0, 1.0]])
    table = IntersectionTable(ids, zero, lonlat, np.ones(3), ids, np.ones(3), [], ids, ids, [], covariance)
    node, counts = np.array([1, 0, -1]), np.ones(3, dtype=np.bool_)
    level = MapLevel(node, np.array([2.2, 1.0, np.inf]), counts, counts[:2], counts[:2], 10.0)
    assert squared_errors(table, level, nodes) == pytest.approx([2.0, 4.0, np.nan], rel=1e-4, nan_ok=True)


@pytest.mark.parametrize("drawn_m", [0.0, 1.5])
def test_what_the_map_is_off_is_a_term_of_its_own(drawn_m: float) -> None:
    """Junctions known to 0.3 m whose nodes were drawn somewhere near them."""
    rng, count = np.random.default_rng(3), 200
    places = np.column_stack([100.0 * np.arange(count), np.zeros(count)])
    found = lonlat_from_enu(49.0, 8.4, places + rng.normal(0, 0.3, (count, 2)))
    nodes = lonlat_from_enu(49.0, 8.4, places + rng.normal(0, drawn_m, (count, 2)))
    ids, ones = np.arange(count), np.ones(count)
    covariance = np.tile([0.09, 0.0, 0.09], (count, 1))
    table = IntersectionTable(ids, places, found, ones, ids, ones, [], ids, ids, [], covariance)
    level = MapLevel(ids, ones, ones > 0, ones > 0, ones > 0, 10.0)
    assert map_std_m(table, level, nodes) == pytest.approx(drawn_m, abs=0.15)
    assert 0.9 <= share_within(squared_errors(table, level, nodes)) <= 0.98
    few = MapLevel(np.where(ids < 4, ids, -1), ones, ones > 0, ones > 0, ones > 0, 10.0)
    assert map_std_m(table, few, nodes) is None


def test_normal_errors_are_true_to_their_uncertainty() -> None:
    squared = np.sum(np.random.default_rng(0).normal(size=(20_000, 2)) ** 2, axis=1)
    assert share_within(squared) == pytest.approx(0.95, abs=0.005)
    assert squared_per_dimension(squared) == pytest.approx(1.0, abs=0.02)
    assert share_within(np.array([BOUND_95, BOUND_95 + 1e-9])) == 0.5
    interval = with_interval(share_within, squared[:100])
    assert interval.low is not None
    assert interval.high is not None
    assert interval.low <= 0.95 <= interval.high
    assert with_interval(share_within, np.zeros(0)).value is None


def test_the_calibration_error_is_that_of_the_bins() -> None:
    confidence = np.array([0.92, 0.98, 0.91, 0.99, 0.2, 1.0])
    right = np.array([True, True, False, True, True, True])
    low, high = bins_of(confidence, right)
    assert (low.count, low.right, high.count, high.right) == (1, 1.0, 5, 0.8)
    assert high.confidence == pytest.approx(0.96)
    assert calibration_error(confidence, right) == pytest.approx((0.8 + 5 * 0.16) / 6)


def test_what_chance_alone_makes_of_the_calibration_error() -> None:
    few, many = np.full(10, 0.9), np.full(1000, 0.9)
    by_chance = calibration_error_by_chance(few)
    assert by_chance.count == 10
    assert by_chance.low == pytest.approx(0.0)  # nine of ten are right in many draws
    # Binomial: the mean of |k / 10 - 0.9| is 0.0697, and k <= 6 of 10, off by 0.3, has a chance of 1.3 %.
    assert by_chance.value == pytest.approx(0.0697, abs=0.005)
    assert by_chance.high == pytest.approx(0.2)
    assert calibration_error_by_chance(many).value == pytest.approx(np.sqrt(2 * 0.09 / (np.pi * 1000)), rel=0.1)
    assert calibration_error_by_chance(np.ones(5)).high == 0.0
    assert calibration_error_by_chance(np.zeros(0)).value is None
