"""Figures from literal rows, worked out by eye."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from interloc.benchmark import metrics
from interloc.benchmark.metrics import Estimate, estimate
from interloc.benchmark.row import Row

Rows = Callable[..., Row]


def test_drives_are_pooled_not_averaged(row: Rows) -> None:
    """The paper's column "Average" is no mean of its columns: long drives weigh more."""
    rows = [row("00", [1.0, 1.0, 1.0, 5.0], fn=1), row("02", [2.0, 8.0], fn=4)]
    assert metrics.ace_m(rows) == pytest.approx(18 / 6)
    assert metrics.precision(rows) == pytest.approx(4 / 6)  # 5.0 is not under 5
    assert metrics.recall(rows) == pytest.approx(4 / 9)
    assert metrics.f1(rows) == pytest.approx(2 * 4 / (4 + 6 + 5))


def test_a_detection_without_any_node_is_false_but_has_no_error(row: Rows) -> None:
    rows = [row(errors_m=[1.0, 3.0], unmatched=2)]
    assert metrics.ace_m(rows) == pytest.approx(2.0)
    assert metrics.precision(rows) == pytest.approx(0.5)


def test_pairs_far_apart_count_in_one_average_only(row: Rows) -> None:
    rows = [row(errors_m=[1.0, 3.0, 50.0])]
    assert metrics.ace_m(rows) == pytest.approx(18.0)
    assert metrics.ace_under_10_m(rows) == pytest.approx(2.0)


def test_thresholds_of_the_comparison(row: Rows) -> None:
    rows = [row(errors_m=[1.0, 6.0, 13.0, 20.0], fn=1)]
    assert metrics.METRICS["precision_at_6_9"](rows) == pytest.approx(2 / 4)
    assert metrics.METRICS["recall_at_13_3"](rows) == pytest.approx(3 / 4)


def test_map_level_is_pooled(row: Rows) -> None:
    rows = [row(fused=(3, 1, 0, 3), map_errors_m=[0.1, 0.2, 0.9]), row("02", fused=(0, 0, 2, 2), map_errors_m=[])]
    assert metrics.map_precision(rows) == pytest.approx(3 / 4)
    assert metrics.map_recall(rows) == pytest.approx(3 / 5)
    assert metrics.map_median_m(rows) == pytest.approx(0.2)


def test_uncertainty_and_confidence_are_counted_over_places(row: Rows) -> None:
    rows = [
        row(map_squared=[0.5, 5.9], outcomes=[(0.85, True), (0.85, False)]),
        row("02", map_squared=[6.1, 7.5], outcomes=[(0.35, True), (0.95, True)]),
    ]
    assert metrics.map_within_95(rows) == pytest.approx(2 / 4)
    assert metrics.map_nees(rows) == pytest.approx(20 / 4 / 2)
    assert metrics.map_calibration_error(rows) == pytest.approx((2 * 0.35 + 0.65 + 0.05) / 4)


def test_time_is_per_keyframe(row: Rows) -> None:
    rows = [row(keyframes=100, compute_s=0.5), row("02", keyframes=300, compute_s=0.7)]
    assert metrics.ms_per_keyframe(rows) == pytest.approx(3.0)


@pytest.mark.parametrize("name", metrics.METRICS)
def test_nothing_measured_is_undefined_or_none_found(name: str) -> None:
    assert metrics.METRICS[name]([]) == (0.0 if name.startswith("nodes") else None)


def test_seeds_give_mean_and_spread(row: Rows) -> None:
    rows = [row(errors_m=[value], seed=seed) for seed, value in enumerate((1.0, 2.0, 3.0))]
    assert estimate(rows, metrics.ace_m) == Estimate(pytest.approx(2.0), pytest.approx(1.0), 3)


def test_one_seed_has_no_spread(row: Rows) -> None:
    assert estimate([row()], metrics.ace_m) == Estimate(1.0, None, 1)


def test_a_drive_with_one_seed_takes_part_in_every_pool(row: Rows) -> None:
    rows = [row("00", [0.0]), row("02", [2.0], seed=0), row("02", [4.0], seed=1)]
    assert estimate(rows, metrics.ace_m).mean == pytest.approx((1.0 + 2.0) / 2)


def test_seeds_without_a_value_are_left_out(row: Rows) -> None:
    rows = [row(errors_m=[], seed=0), row(errors_m=[3.0], seed=1)]
    assert estimate(rows, metrics.ace_m) == Estimate(3.0, None, 1)
    assert estimate(rows[:1], metrics.ace_m).mean is None
